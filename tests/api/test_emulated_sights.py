"""The motion of edges on the emulated device, in media, of light paths and of outputs besides radiance: the CPU's."""

from __future__ import annotations

import copy
from typing import Any

import media_scenes
import pytest
import torch
from emulated import gradients
from emulated_outlines import FLOOR, GREY, LIGHTS, POSITIONS, T, check, crumpled_ball, scene_of

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
OUTPUTS = ("depth", "position", "shading_normal", "uv", "albedo", "roughness")
SINGLE, DOUBLE = torch.float32, torch.float64


# ------------------------------------------------------------------------------------------- outputs besides radiance
@pytest.mark.parametrize("names", [("depth",), OUTPUTS, ("distance", "normal_camera", "dp_du", "barycentric")])
def test_outputs(device, names):
    scene = scene_of(ball=crumpled_ball(SINGLE, True), light=LIGHTS["sky"])
    check(device, scene, POSITIONS, "camera.to_world", parts=1, outputs=names)


def test_outputs_in_double_precision(device):
    scene = scene_of(DOUBLE, ball=crumpled_ball(DOUBLE), light=LIGHTS["sky"])
    check(device, scene, POSITIONS, parts=1, outputs=OUTPUTS)


@pytest.mark.parametrize(
    "camera",
    [
        {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 4.0},
        {"type": "distant", "fov": None, "film": {"type": "hdrfilm", "width": 1, "height": 1}},
    ],
    ids=lambda camera: camera["type"],
)
def test_outputs_of_cameras(device, camera):
    camera = {name: value for name, value in camera.items() if value is not None}
    film = {"type": "hdrfilm", "width": 20, "height": 20}
    view = {"to_world": T.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]), "film": film, **camera}
    ball, floor = crumpled_ball(SINGLE), {**FLOOR, "bsdf": GREY}
    scene = tr.load_dict({"type": "scene", "camera": view, "floor": floor, "ball": ball, "light": LIGHTS["bulb"]})
    samples = 64 if camera["type"] == "distant" else 4
    check(device, scene, POSITIONS, "camera.to_world", parts=1, outputs=OUTPUTS, spp=samples, spp_grad=samples)


@pytest.mark.parametrize(
    "settings",
    [
        {"crop": (4, 3, 9, 11), "passes": 2},
        {"pixels": torch.tensor([[3, 4], [9, 9], [10, 9], [3, 4]])},
        {"integrator": tr.PathTracer(max_depth=4, hide_emitters=True)},
    ],
    ids=["crop", "pixels", "hidden lights"],
)
def test_settings_of_outputs(device, settings):
    thing = {"type": "cylinder", "to_world": T.scale(0.6), "bsdf": GREY}
    scene = scene_of(ball=crumpled_ball(SINGLE), thing=thing, bulb=LIGHTS["bulb"])
    check(device, scene, POSITIONS, "thing.to_world", parts=1, counted=False, outputs=OUTPUTS, **settings)


# ------------------------------------------------------------------------------------------------------------ media
def in_media(name: str) -> tr.Scene:
    scene: dict[str, Any] = media_scenes.SCENES[name]().scene
    sensor = next(key for key, value in scene.items() if isinstance(value, dict) and value.get("type") == "perspective")
    return tr.load_dict({**scene, "ball": crumpled_ball(SINGLE), "view": scene.pop(sensor)})


@pytest.mark.parametrize("name", sorted(media_scenes.SCENES))
def test_media(device, name):
    """Before, in and behind them, also of their boundaries; rays pass those that light goes through unchanged."""
    integrator = tr.VolumetricPathTracer(max_depth=4)
    check(device, in_media(name), POSITIONS, "view.to_world", parts=1, counted=False, integrator=integrator)


@pytest.mark.parametrize("name", ["nested", "frosted"])
def test_media_with_hidden_lights(device, name):
    integrator = tr.VolumetricPathTracer(max_depth=4, hide_emitters=True)
    check(device, in_media(name), POSITIONS, "view.to_world", parts=1, counted=False, integrator=integrator)


def test_outputs_beside_media(device):
    scene, integrator = in_media("cloud"), tr.VolumetricPathTracer(max_depth=4)
    given = {"parts": 1, "counted": False, "outputs": ("depth", "albedo"), "integrator": integrator}
    check(device, scene, POSITIONS, "view.to_world", **given)


# ------------------------------------------------------------------------------------------------------ light paths
LIGHT_PATHS = {"integrator": tr.ParticleTracer(max_depth=4), "spp": 4}


@pytest.mark.parametrize("light", LIGHTS)
def test_light_paths(device, light):
    scene = scene_of(ball=crumpled_ball(SINGLE, light == "sky"), light=LIGHTS[light])
    check(device, scene, POSITIONS, "camera.to_world", **LIGHT_PATHS)


@pytest.mark.parametrize(
    "settings",
    [
        {"crop": (4, 3, 9, 11), "passes": 2},
        {"spp_visibility": (3, 1)},
        {"integrator": tr.ParticleTracer(max_depth=4, hide_emitters=True)},
        {"integrator": tr.ParticleTracer(rr_depth=3)},
        {"integrator": tr.ParticleTracer(max_depth=2)},
    ],
    ids=["crop", "samples", "hidden lights", "any depth", "depth 2"],
)
def test_settings_of_light_paths(device, settings):
    scene = scene_of(ball=crumpled_ball(SINGLE), lamp=LIGHTS["lamp"], bulb=LIGHTS["bulb"])
    check(device, scene, POSITIONS, "bulb.to_world", **{**LIGHT_PATHS, "counted": False, **settings})


@pytest.mark.parametrize("what", ["media", "light paths", "outputs"])
def test_deterministic_algorithms(device, what, request):
    """Sums are the same bits twice, and the CPU's but for their order."""
    ball = crumpled_ball(SINGLE)
    scene = in_media("cloud") if what == "media" else scene_of(ball=ball, lamp=LIGHTS["lamp"])
    given: dict[str, Any] = {
        "media": {"integrator": tr.VolumetricPathTracer(max_depth=4), "parts": 1, "counted": False},
        "light paths": LIGHT_PATHS,
        "outputs": {"outputs": OUTPUTS, "parts": 1},
    }[what]
    request.addfinalizer(lambda: torch.use_deterministic_algorithms(False))
    torch.use_deterministic_algorithms(True)
    check(device, scene, POSITIONS, **given)
    settings = {name: value for name, value in given.items() if name not in ("parts", "counted")}
    found = []
    for _ in range(2):
        (seen, *_rest) = tr.render(scene, **{"spp": 2, "seed": 3, "outputs": ("rgb",), **settings})
        found.append(torch.autograd.grad(seen[seen.isfinite()].square().sum(), scene.get_parameter(POSITIONS))[0])
    assert torch.equal(*found) and bool(found[0].any())


def test_light_paths_in_double_precision(device):
    scene = scene_of(DOUBLE, ball=crumpled_ball(DOUBLE), light=LIGHTS["lamp"])
    check(device, scene, POSITIONS, **LIGHT_PATHS)


@pytest.mark.parametrize("bsdf", ["dielectric", "roughconductor"])
def test_light_paths_past_other_materials(device, bsdf):
    """Of delta lobes, which the paths do not go on by behind the first vertex."""
    floor = {**FLOOR, "bsdf": {"type": bsdf}}
    below = {**FLOOR, "to_world": T.translate([0, -1.5, 0]) @ FLOOR["to_world"], "bsdf": GREY}
    scene = scene_of(ball=crumpled_ball(SINGLE), floor=floor, below=below, light=LIGHTS["sky"])
    check(device, scene, POSITIONS, **LIGHT_PATHS)


@pytest.mark.parametrize("dark", ["lamp", "sky"])
def test_lights_that_no_light_path_begins_at(device, dark):
    """Samples do not see them either, whether they are on shapes or around all."""
    given: dict[str, dict[str, Any]] = copy.deepcopy({"lamp": LIGHTS["lamp"], "sky": LIGHTS["sky"]})
    found = []
    for weight in (1.0, 0.0):
        given[dark].get("emitter", given[dark])["sampling_weight"] = weight
        scene = scene_of(ball=crumpled_ball(SINGLE), **given)
        check(device, scene, POSITIONS, **LIGHT_PATHS)
        found.append(gradients(scene, {POSITIONS: scene.get_parameter(POSITIONS)}, **LIGHT_PATHS)[POSITIONS])
    assert not torch.allclose(*found, atol=0.01 * float(found[0].abs().max()))
