"""Paths through media on the emulated device: images are the CPU's bit for bit, gradients but for the order of sums."""

from __future__ import annotations

import media_scenes
import pytest
import torch
from emulated import check_close, check_forward_mode, check_gradients, check_image, differentiable, gradients

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
SETTINGS = {"integrator": None, "visibility": False}  # the scenes' own integrators


def scene_of(name: str, **settings) -> tr.Scene:
    return tr.load_dict(media_scenes.SCENES[name]().scene, **settings)


def glowing() -> tr.Scene:
    """A cloud that emits, whose extinction has three colours, in one that does not."""
    place = media_scenes.TURNED @ media_scenes.UNIT_TO_CUBE
    fire = {
        "type": "heterogeneous",
        "sigma_t": media_scenes.grid(media_scenes.noise(1, (3, 4, 5, 3), 0.0, 2.0), place),
        "albedo": 0.6,
        "emission": media_scenes.grid(media_scenes.noise(2, (2, 3, 4, 3), 0.0, 1.0), place),
    }
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 6},
            "camera": media_scenes.view(),
            "haze": {"type": "homogeneous", "sigma_t": 0.2, "albedo": 0.8, "emission": 0.1},
            "all": media_scenes.boundary({"type": "ref", "id": "haze"}, media_scenes.scale(1.6), "sphere"),
            "fire": media_scenes.boundary(fire, media_scenes.TURNED, exterior={"type": "ref", "id": "haze"}),
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


@pytest.mark.parametrize("name", sorted(media_scenes.SCENES))
def test_images_are_those_of_the_cpu(device, name):
    check_image(device, scene_of(name), **SETTINGS)


@pytest.mark.parametrize("name", sorted(media_scenes.SCENES))
def test_gradients_are_those_of_the_cpu(device, name):
    check_gradients(device, scene_of(name), **SETTINGS)


@pytest.mark.parametrize("name", ["cloud", "coloured"])
def test_gradients_of_extinction_and_albedo_alone(device, name):
    scene = scene_of(name)
    chosen = {n: p for n, p in differentiable(scene).items() if "sigma_t" in n or "albedo" in n}
    scene.train_only(*chosen)
    assert len(chosen) >= 2
    check_gradients(device, scene, chosen, **SETTINGS)


def test_emission(device):
    check_image(device, glowing(), **SETTINGS)
    scene = glowing()
    assert any("emission" in name for name in differentiable(scene))
    check_gradients(device, scene, **SETTINGS)


@pytest.mark.parametrize(
    "settings",
    [
        {"pixels": torch.tensor([[7, 9], [0, 0], [7, 9], [23, 4]])},
        {"crop": (3, 2, 9, 16), "passes": 2, "sampler": "independent"},
        {"integrator": tr.VolumetricPathTracer(max_depth=3, hide_emitters=True)},
        {"integrator": tr.VolumetricPathTracer(max_depth=1)},
    ],
)
def test_settings(device, settings):
    scene = scene_of("smooth")
    check_image(device, scene, ("rgb", "alpha", "variance", "depth"), **{**SETTINGS, **settings})
    check_gradients(device, scene, **{**SETTINGS, **settings})


def test_no_vertices(device):
    assert not tr.render(scene_of("fog"), integrator=tr.VolumetricPathTracer(max_depth=0), spp=1).any()


def test_mono(device):
    check_image(device, scene_of("cloud", variant="mono"), **SETTINGS)
    check_gradients(device, scene_of("cloud", variant="mono"), **SETTINGS)


@pytest.mark.parametrize("name", ["cloud", "phases"])
def test_forward_mode(device, name):
    check_forward_mode(device, scene_of(name), **SETTINGS)


def test_collisions_are_counted(device):
    scene, counts = scene_of("cloud"), []
    for name in ("tree", "emulated"):
        device(name)
        tr.render(scene, spp=2, seed=1)
        counts.append(scene.statistics["render"]["collisions"])
    assert counts[0] == counts[1] > 1000


def test_deterministic_algorithms(device, request):
    scene = scene_of("smooth")
    chosen = differentiable(scene)
    plain = gradients(scene, chosen, **SETTINGS)
    request.addfinalizer(lambda: torch.use_deterministic_algorithms(False))
    torch.use_deterministic_algorithms(True)
    first = gradients(scene, chosen, **SETTINGS)
    check_close(first, plain)
    again = gradients(scene, chosen, **SETTINGS)
    assert all(torch.equal(again[name], value) for name, value in first.items())


def test_surfaces_after_media(device):
    """What a device keeps for paths through media is not in the way of others."""
    scene = scene_of("frosted")
    for integrator in (None, tr.PathTracer(max_depth=4), None):
        check_image(device, scene, **{**SETTINGS, "integrator": integrator})
