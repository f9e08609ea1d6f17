"""Derivatives on the emulated device: those of the CPU, which walks the same tree, but for the order of sums."""

from __future__ import annotations

import bsdf_models
import light_scenes
import pytest
import reference_scenes
import small_scene
import torch
from emulated import (
    PATH,
    blobs,
    check_close,
    check_forward_mode,
    check_gradients,
    differentiable,
    gradients,
    hills,
    scene_of_materials,
)
from small_things import THING, small_things

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
REFERENCES = {**reference_scenes.SCENES, **reference_scenes.CAMERAS}


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_gradients_are_those_of_the_cpu(device, name):
    check_gradients(device, tr.load_dict(REFERENCES[name]().scene))


@pytest.mark.parametrize("interpolation", ["bspline", "bilinear"])
def test_height_fields(device, interpolation):
    scene = hills(interpolation)
    chosen = differentiable(scene)
    assert {"water.heights", "metal.heights", "metal.to_world"} <= set(chosen)
    check_gradients(device, scene, chosen, visibility=False, spp=8)


@pytest.mark.parametrize("normals", ["analytic", "smooth"])
def test_grids_of_distances(device, normals):
    scene = blobs(normals)
    chosen = differentiable(scene)
    assert {"glass.grid", "metal.grid", "metal.to_world"} <= set(chosen)
    check_gradients(device, scene, chosen, visibility=False, spp=8)


@pytest.mark.parametrize("depth", [2, 3, 4])
def test_rays_that_pass_small_things_by(device, depth):
    """Those to the last vertex that scatters, where no vertex before has a derivative."""
    scene = tr.load_dict(small_things(True))
    scene.train_only(THING)
    integrator = tr.PathTracer(max_depth=depth, rr_depth=100)
    check_gradients(device, scene, {THING: scene.get_parameter(THING)}, integrator=integrator)


@pytest.mark.parametrize("only", ["everything", "bsdfs"])
def test_every_bsdf(device, only):
    """Also where nothing but BSDFs is differentiated, so that paths count from the first of them on."""
    scene = scene_of_materials({kind: {"type": kind} for kind in sorted(bsdf_models.DECLARED)}, 24, "gaussian")
    chosen = differentiable(scene)
    if only == "bsdfs":
        for name in [n for n in chosen if ".bsdf." not in n]:
            chosen.pop(name).requires_grad_(False)
    assert len(chosen) > 30
    check_gradients(device, scene, chosen, integrator=tr.PathTracer(max_depth=6, rr_depth=2))


@pytest.mark.parametrize(
    "settings",
    [
        {"integrator": tr.PathTracer(max_depth=-1, rr_depth=3)},
        {"integrator": tr.PathTracer(max_depth=20, rr_depth=30)},
        {"integrator": tr.PathTracer(max_depth=1)},
        {"integrator": tr.PathTracer(max_depth=4, hide_emitters=True)},
        {"integrator": tr.DirectIllumination(emitter_samples=3, bsdf_samples=2)},
        {"crop": (3, 2, 5, 6)},
        {"pixels": torch.tensor([[7, 9], [0, 0], [7, 9], [3, 4], [3, 5]])},
        {"passes": 2, "sampler": "independent"},
        {"correlated": True, "spp": 70},
        {"spp": 3, "spp_grad": 5},
        {"adaptive_grad": True, "spp": 9},
        {"adaptive_grad": True, "spp": 70, "pixels": torch.tensor([[7, 9], [0, 0], [7, 9], [3, 4], [3, 5]])},
    ],
)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_settings(device, rfilter, settings):
    film = {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": rfilter}}
    objects = light_scenes.room(lamp=light_scenes.area(), ball=light_scenes.ball_light(), sky=light_scenes.envmap())
    camera = next(name for name, value in objects.items() if isinstance(value, dict) and "film" in value)
    objects = {**objects, camera: {**objects[camera], "film": film}}
    check_gradients(device, tr.load_dict(objects), **settings)


def test_mono(device):
    check_gradients(device, tr.load_dict(small_scene.ball_and_wall(), variant="mono"))


def test_forward_mode(device):
    check_forward_mode(device, tr.load_dict(REFERENCES["glossy"]().scene), integrator=PATH)


def test_an_optimisation(device):
    scene = tr.load_dict(small_scene.ball_and_wall())
    color = scene.train_only("*.reflectance.value")[0]
    with torch.no_grad():
        target = tr.render(scene, spp=16, seed=1)
        wanted = color.clone()
        color.mul_(0.5)
    optimizer = torch.optim.Adam([color], lr=0.05)
    for step in range(40):
        optimizer.zero_grad()
        ((tr.render(scene, spp=4, seed=2 + step) - target) ** 2).mean().backward()
        optimizer.step()
    assert float((color.detach() - wanted).abs().max()) < 0.05


def test_gradients_repeat(device):
    scene = tr.load_dict(REFERENCES["bitmaps"]().scene)
    chosen = differentiable(scene)
    first = gradients(scene, chosen)
    check_close(gradients(scene, chosen), first)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [*((name, torch.float32) for name in ("bitmaps", "mesh", "volume_texture")), ("bitmaps", torch.float64)],
)
def test_deterministic_algorithms(device, name, dtype, request):
    """Bits do not depend on orders, of which every launch has another one, nor on threads, which add at once then."""
    scene = tr.load_dict(REFERENCES[name]().scene, dtype=dtype)
    chosen = differentiable(scene)
    plain = gradients(scene, chosen)
    request.addfinalizer(lambda: torch.use_deterministic_algorithms(False))
    torch.use_deterministic_algorithms(True)
    first = gradients(scene, chosen)
    check_close(first, plain)
    torch.use_deterministic_algorithms(True, warn_only=True)
    again = gradients(scene, chosen)
    assert all(torch.equal(again[name], g) for name, g in first.items())
