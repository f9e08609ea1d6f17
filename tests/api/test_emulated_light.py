"""Light tracing on the emulated device: images and gradients are the CPU's but for the order of sums."""

from __future__ import annotations

import light_scenes
import pytest
import torch
from emulated import check_close, check_forward_mode, check_gradients, check_image, differentiable, gradients

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
LIGHT = {"integrator": tr.ParticleTracer(max_depth=5), "visibility": False}
GLASS = {"type": "dielectric"}
ROUGH = {"type": "roughconductor", "alpha": 0.2}
WRAPPED = {
    "type": "bumpmap",
    "texture": light_scenes.texels(5, 4),
    "bsdf": {
        "type": "blendbsdf",
        "weight": light_scenes.texels(3, 4),
        "first": {"type": "roughplastic"},
        "second": {"type": "mask", "opacity": 0.7, "bsdf": ROUGH},
    },
}
LAMPS = {
    "area": light_scenes.area,
    "beam": light_scenes.beam,
    "ball": light_scenes.ball_light,
    "mesh": light_scenes.mesh_light,
    "point": light_scenes.point_light,
    "spot": light_scenes.spot,
    "projector": light_scenes.projector,
    "sun": light_scenes.sun,
    "sky": light_scenes.envmap,
}


def scene_with(lamp: str, sensor=None, **settings) -> tr.Scene:
    """A glass slab above a room, and a blob in it whose material is wrapped."""
    objects = {"lamp": LAMPS[lamp](), "slab": light_scenes.slab(GLASS), "blob": light_scenes.blob(WRAPPED)}
    return tr.load_dict(light_scenes.room(sensor, **objects), **settings)


def metered() -> tr.Scene:
    sheet = light_scenes.wavy_sheet(n=12)
    meter = light_scenes.metered(lamp=light_scenes.beam(), slab=sheet, sun=light_scenes.sun())
    return tr.load_dict(meter)


@pytest.mark.parametrize("lamp", LAMPS)
def test_images_and_gradients_are_those_of_the_cpu(device, lamp):
    scene = scene_with(lamp)
    check_image(device, scene, ("rgb",), close=True, **LIGHT)
    check_gradients(device, scene, **LIGHT)


def test_values_alone(device):
    """Nothing moves: other kernels."""
    scene = scene_with("area")
    chosen = {n: p for n, p in differentiable(scene).items() if "reflectance" in n or "radiance" in n}
    scene.train_only(*chosen)
    assert len(chosen) >= 3
    check_gradients(device, scene, chosen, **LIGHT)
    check_forward_mode(device, scene, chosen, close=True, **LIGHT)


@pytest.mark.parametrize(
    "settings",
    [
        {"pixels": torch.tensor([[7, 5], [0, 0], [7, 5], [2, 4]])},
        {"crop": (3, 2, 4, 5), "passes": 2, "sampler": "independent"},
        {"integrator": tr.ParticleTracer(max_depth=4, hide_emitters=True)},
        {"integrator": tr.ParticleTracer(max_depth=2, rr_depth=1)},
        {"integrator": tr.ParticleTracer(rr_depth=2, emitter_sampling="power")},
    ],
)
def test_settings(device, settings):
    scene = scene_with("ball", light_scenes.camera(size=12, rfilter="mitchell"))
    check_image(device, scene, ("rgb",), close=True, **{**LIGHT, **settings})
    check_gradients(device, scene, **{**LIGHT, **settings})


def test_the_lamp_alone(device):
    scene = tr.load_dict(light_scenes.room(lamp=light_scenes.ball_light()))
    check_image(device, scene, ("rgb",), close=True, integrator=tr.ParticleTracer(max_depth=1))
    assert not tr.render(scene, integrator=tr.ParticleTracer(max_depth=0), spp=1).any()


def test_a_surface_that_measures(device):
    check_image(device, metered(), ("rgb",), close=True, **LIGHT)
    check_gradients(device, metered(), **LIGHT)
    check_forward_mode(device, metered(), close=True, **LIGHT)


def test_mono(device):
    scene = scene_with("area", variant="mono")
    check_image(device, scene, ("rgb",), close=True, **LIGHT)
    check_gradients(device, scene, **LIGHT)


def test_forward_mode(device):
    check_forward_mode(device, scene_with("ball"), close=True, **LIGHT)


def test_a_part_of_the_film_has_the_bits_of_the_whole(device):
    device("emulated")
    scene = scene_with("area")
    whole, again = (tr.render(scene, spp=4, seed=1, **LIGHT) for _ in range(2))
    assert torch.equal(whole, again)
    assert torch.equal(tr.render(scene, spp=4, seed=1, crop=(2, 3, 4, 5), **LIGHT), whole[2:6, 3:8])


def test_deterministic_algorithms(device, request):
    scene = scene_with("ball")
    chosen = differentiable(scene)
    device("emulated")
    plain = gradients(scene, chosen, **LIGHT)
    request.addfinalizer(lambda: torch.use_deterministic_algorithms(False))
    torch.use_deterministic_algorithms(True)
    first, again = (gradients(scene, chosen, **LIGHT) for _ in range(2))
    check_close(first, plain)
    assert all(torch.equal(again[name], value) for name, value in first.items())


def test_light_after_paths(device):
    """What a device keeps for light paths is not in the way of others."""
    scene = scene_with("area")
    for integrator in (tr.ParticleTracer(max_depth=4), tr.PathTracer(max_depth=4), tr.ParticleTracer(max_depth=3)):
        close = isinstance(integrator, tr.ParticleTracer)
        check_image(device, scene, ("rgb",), close=close, integrator=integrator)
