"""The motion of outlines and of shadows' edges on the emulated device: that of the CPU, which walks the same tree.

Both take the same samples and rays, so that derivatives differ by the order of sums alone.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch
from emulated import check_close, gradients, hills
from emulated_outlines import FLOOR, GREY, LIGHTS, POSITIONS, T, check, crumpled_ball, scene_of

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("light", LIGHTS)
def test_lights(device, light, smooth):
    check(device, scene_of(ball=crumpled_ball(torch.float32, smooth), light=LIGHTS[light]), POSITIONS)


@pytest.mark.parametrize("light", ["bulb", "sky"])
def test_double_precision(device, light):
    dtype = torch.float64
    check(device, scene_of(dtype, ball=crumpled_ball(dtype), light=LIGHTS[light]), POSITIONS, "camera.to_world")


@pytest.mark.parametrize("bsdf", ["roughconductor", "dielectric", "mask", "bumpmap"])
def test_materials(device, bsdf):
    """Of a floor in which they are seen; light passes some of them, and lobes of one are no smooth ones."""
    bumps = torch.rand(6, 5, 1, generator=torch.Generator().manual_seed(2))
    bump = {"type": "bitmap", "raw": True, "data": bumps, "filter_type": "bilinear"}
    given: dict[str, Any] = {
        "roughconductor": {"type": "roughconductor", "alpha": 0.15},
        "dielectric": {"type": "dielectric"},
        "mask": {"type": "mask", "opacity": 0.5, "bsdf": GREY},
        "bumpmap": {"type": "bumpmap", "texture": bump, "bsdf": GREY},
    }
    below = {**FLOOR, "to_world": T.translate([0, -1.5, 0]) @ FLOOR["to_world"], "bsdf": GREY}
    floor = {**FLOOR, "bsdf": given[bsdf]}
    scene = scene_of(ball=crumpled_ball(torch.float32), floor=floor, below=below, light=LIGHTS["sky"])
    check(device, scene, POSITIONS)


@pytest.mark.parametrize(
    "camera",
    [
        {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 4.0},
        {"type": "orthographic", "fov": None, "to_world": T.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]) @ T.scale(1.5)},
        {"type": "fisheye", "fov": 80},
        {"type": "panorama", "fov": None},
        {"type": "distant", "fov": None, "film": {"type": "hdrfilm", "width": 1, "height": 1}},
    ],
    ids=lambda camera: camera["type"],
)
def test_cameras(device, camera):
    camera = {name: value for name, value in camera.items() if value is not None}
    film = {"type": "hdrfilm", "width": 20, "height": 20}
    view = {"to_world": T.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]), "film": film, **camera}
    ball, bsdf = crumpled_ball(torch.float32), {**FLOOR, "bsdf": GREY}
    scene = tr.load_dict({"type": "scene", "camera": view, "floor": bsdf, "ball": ball, "light": LIGHTS["bulb"]})
    check(device, scene, POSITIONS, "camera.to_world")


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "disk"])
def test_curved_shapes(device, shape):
    thing = {"type": shape, "to_world": T.scale(0.6), "bsdf": GREY}
    check(device, scene_of(thing=thing, light=LIGHTS["lamp"], bulb=LIGHTS["bulb"]), "thing.to_world", "bulb.to_world")


@pytest.mark.parametrize("interpolation", ["bspline", "bilinear"])
def test_height_fields(device, interpolation):
    scene = hills(interpolation)
    check(device, scene, "water.heights", "metal.heights", "metal.to_world", "camera.to_world")


@pytest.mark.parametrize("subdivisions", [5, 6])
def test_fine_meshes(device, subdivisions):
    """Whose edges rays can hardly tell apart; there are so many of the finer one that they are kept rounded."""
    ball = crumpled_ball(torch.float32, subdivisions == 6, subdivisions)
    integrator = tr.PathTracer(max_depth=3)
    check(device, scene_of(ball=ball, light=LIGHTS["lamp"]), POSITIONS, integrator=integrator)


@pytest.mark.parametrize(
    "settings",
    [
        {"crop": (4, 3, 9, 11)},
        {"pixels": torch.tensor([[3, 4], [9, 9], [10, 9], [3, 4]])},
        {"passes": 2},
        {"spp_visibility": (3, 1)},
        {"integrator": tr.PathTracer(max_depth=4, hide_emitters=True)},
        {"integrator": tr.PathTracer(max_depth=2)},
        {"integrator": tr.PathTracer(rr_depth=3)},
        {"integrator": tr.DirectIllumination(emitter_samples=2, bsdf_samples=3)},
    ],
    ids=["crop", "pixels", "passes", "samples", "hidden lights", "depth 2", "any depth", "direct"],
)
def test_settings(device, settings):
    scene = scene_of(ball=crumpled_ball(torch.float32), lamp=LIGHTS["lamp"], bulb=LIGHTS["bulb"])
    check(device, scene, POSITIONS, "bulb.to_world", **settings)


def test_what_is_seen_alone(device):
    """With one vertex, or where normals alone change, nobody asks what lights and vertices see."""
    scene = scene_of(ball=crumpled_ball(torch.float32, True), light=LIGHTS["sky"])
    check(device, scene, POSITIONS, parts=1, integrator=tr.PathTracer(max_depth=1))
    check(device, scene, "ball.vertex_normals", parts=1)


def test_lights_that_move(device):
    scene = scene_of(ball=crumpled_ball(torch.float32), point=LIGHTS["point"], spot=LIGHTS["spot"], sun=LIGHTS["sun"])
    check(device, scene, "point.position", "spot.to_world", "sun.to_world", parts=1)


@pytest.mark.parametrize("objects", [{}, {"light": LIGHTS["sky"]}, {"ball": crumpled_ball(torch.float32)}])
def test_scenes_in_which_little_is_seen(device, objects):
    """Without lights, without edges but those of a floor: the camera's derivative is zero, or that of the floor's."""
    scene = scene_of(**objects)
    scene.train_only("camera.to_world")
    parameters = {"camera.to_world": scene.get_parameter("camera.to_world")}
    found = []
    for place in ("tree", "emulated"):
        device(place)
        found.append(gradients(scene, parameters)["camera.to_world"])
    torch.testing.assert_close(found[1], found[0], rtol=1e-5, atol=0)
    assert bool(found[0].any()) == ("light" in objects)


def test_outlines_that_change_are_seen(device):
    """The tables of the device are those of the scene as it is."""
    scene = scene_of(ball=crumpled_ball(torch.float32), light=LIGHTS["bulb"])
    scene.train_only(POSITIONS)
    vertices = scene.get_parameter(POSITIONS)
    device("emulated")
    first = gradients(scene, {POSITIONS: vertices})[POSITIONS]
    with torch.no_grad():
        vertices.mul_(torch.tensor([1.2, 0.8, 1.0])).add_(0.1)
    found = gradients(scene, {POSITIONS: vertices})
    again = scene_of(ball=tr.Mesh(vertices.detach().clone(), scene.ball.faces, bsdf=GREY), light=LIGHTS["bulb"])
    again.train_only(POSITIONS)
    check_close(found, gradients(again, {POSITIONS: again.get_parameter(POSITIONS)}))
    assert not torch.allclose(found[POSITIONS], first, atol=0.1 * float(first.abs().max()))
