"""The emulated device in double precision: images are the CPU's bit for bit, sums of gradients to its rounding.

Outputs of first hits and deterministic gradients are tested in both precisions in their own files.
"""

from __future__ import annotations

import light_scenes
import media_scenes
import pytest
import reference_scenes
import small_scene
import torch
from emulated import (
    PATH,
    blobs,
    check_forward_mode,
    check_gradients,
    check_image,
    differentiable,
    hills,
    materials,
    scene_of_materials,
)

import torchrender as tr
from torchrender.cuda import check as check_of_cards

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
DOUBLE = torch.float64
LIGHT = {"integrator": tr.ParticleTracer(max_depth=5), "visibility": False}
MEDIA = {"integrator": None, "visibility": False}  # the scene's own integrator


def reference(name: str) -> tr.Scene:
    return tr.load_dict(reference_scenes.SCENES[name]().scene, dtype=DOUBLE)


def lit(**objects) -> tr.Scene:
    return tr.load_dict(light_scenes.room(light_scenes.camera(), **objects), dtype=DOUBLE)


@pytest.mark.parametrize("name", ["bitmaps", "mesh", "cylinders", "volume_texture"])
def test_images_and_gradients_are_those_of_the_cpu(device, name):
    scene = reference(name)
    image = check_image(device, scene, ("rgb", "alpha", "variance"))
    assert image.dtype == DOUBLE
    check_gradients(device, scene)


def test_every_bsdf(device):
    scene = scene_of_materials(materials(), 24, "gaussian", dtype=DOUBLE)
    check_image(device, scene, integrator=tr.PathTracer(max_depth=6, rr_depth=2), spp=2)
    check_gradients(device, scene, integrator=tr.PathTracer(max_depth=6, rr_depth=2))


def test_grids_of_distances(device):
    scene = blobs(dtype=DOUBLE)
    check_image(device, scene, ("rgb", "alpha", "depth"))
    check_gradients(device, scene, visibility=False)


def test_height_fields(device):
    scene = hills("bspline", dtype=DOUBLE)
    check_image(device, scene, ("rgb", "depth", "shading_normal"))
    check_gradients(device, scene, differentiable(scene), visibility=False)


def test_forward_mode(device):
    check_forward_mode(device, reference("glossy"), integrator=PATH)


def test_settings(device):
    for settings in (
        {"crop": (3, 2, 4, 5), "passes": 2, "sampler": "independent"},
        {"pixels": torch.tensor([[7, 5], [0, 0], [7, 5], [2, 4]])},
        {"adaptive_grad": True, "spp": 9},
        {"integrator": tr.DirectIllumination(emitter_samples=3, bsdf_samples=2)},
    ):
        check_gradients(device, lit(lamp=light_scenes.area(), sky=light_scenes.envmap()), **settings)


def test_media(device):
    scene = tr.load_dict(media_scenes.SCENES["coloured"]().scene, dtype=DOUBLE)
    check_image(device, scene, **MEDIA)
    check_gradients(device, scene, **MEDIA)


def test_light_tracing(device):
    scene = lit(lamp=light_scenes.area(), sun=light_scenes.sun(), slab=light_scenes.slab({"type": "dielectric"}))
    check_image(device, scene, ("rgb",), close=True, **LIGHT)
    check_gradients(device, scene, **LIGHT)
    check_forward_mode(device, scene, close=True, **LIGHT)


def test_gradcheck(device):
    """What PyTorch's own check takes for a correct gradient, which single precision is too coarse for."""
    scene = tr.load_dict(small_scene.ball_and_wall(), dtype=DOUBLE)
    scene.train_only()
    names = [n for n, _ in scene.named_parameters() if n.endswith("reflectance.value")]
    values = [scene.get_parameter(n).detach().clone().requires_grad_(True) for n in names]
    assert names

    def image(*given: torch.Tensor) -> torch.Tensor:
        params = dict(zip(names, given, strict=True))
        return tr.render(scene, params=params, integrator=PATH, spp=2, seed=1, size=(3, 4), correlated=True)

    assert torch.autograd.gradcheck(image, values, check_forward_ad=True)


def test_the_check_of_cards(device, tmp_path, monkeypatch):
    """Its step of double precision, with the emulated device for a card, which takes long for as large pictures."""
    rooms = check_of_cards.rooms()
    for room in rooms.values():
        room["sensor"]["film"] |= {"width": 24, "height": 24}
    monkeypatch.setattr(check_of_cards, "rooms", lambda: rooms)
    check = check_of_cards.Check("emulated", tmp_path / "found.json", "", ("double",))
    check.step("double", check.double)
    assert check.good and 0 < max(check.report["double"]["off by"].values()) < 1e-10
