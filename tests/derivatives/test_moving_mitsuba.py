"""Things that move by theta, as in Mitsuba's tests of its integrators, and two motions that these lack.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases. The limits are a tenth
of those that Mitsuba 3 has for reverse mode (src/integrators/tests/test_ad_integrators.py), and each test asserts that
the standard error is below its own.

Films have fewer pixels than theirs, and where an edge is the same everywhere a number of them for which it lies in the
middle of pixels: weights are steps, and differences across one are not derivatives. Balls are flat triangles, since
where interpolated normals turn away from the viewer there is no outline; the last case has what is known to be wrong.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import pytest
import torch
from moving_suites import (
    Weight,
    at_the_border,
    ball,
    both_modes,
    by_theta,
    check,
    diffuse,
    everywhere,
    glowing,
    in_the_middle,
    moved,
    rectangle,
    weighted,
)

import torchrender as tr

# Renders only; how the native code is compiled does not matter to motions.
pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

T = tr.Transform
GREY = {"type": "diffuse"}
SKY = {"type": "constant", "radiance": 1.0}
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@dataclass
class Case:
    objects: dict
    moves: dict[str, tuple[float, float, float] | None]  # by so much for theta 1; None: grows by it
    rtol: float
    step: float = 0.02
    spp: int = 64
    differences_spp: int = 256
    depth: int = 2
    size: int = 32
    spp_visibility: int | tuple[int, int] | None = None
    weight: Weight = everywhere
    camera: dict | None = None
    film: dict | None = None

    def scene(self, size: int | None = None) -> tr.Scene:
        size = size or self.size
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "sample_border": True}
        film |= self.film or {}
        from_z = T.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
        camera = {"type": "perspective", "to_world": from_z, **(self.camera or {})}  # of 50 mm
        return tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": self.depth},
                "camera": {**camera, "film": film},
                **copy.deepcopy(self.objects),
            },
        )

    def directions(self, scene: tr.Scene) -> dict[str, torch.Tensor]:
        found = {}
        for name, velocity in self.moves.items():
            value = scene.get_parameter(name).detach()
            if velocity is None:
                found[name] = value.clone()
            elif value.shape == (4, 4):
                found[name] = torch.zeros_like(value)
                found[name][:3, 3] = torch.tensor(velocity)
            else:
                found[name] = torch.tensor(velocity).to(value).expand_as(value)
        return found


def from_here(z: float, **more) -> dict:
    return {"to_world": T.look_at([0, 0, z], [0, 0, z - 1], [0, 1, 0]), **more}


def shadow(receiver: tr.Transform | None = None) -> dict:
    """A ball between a lamp and a wall, both out of view."""
    return {
        "plane": rectangle(receiver or T(), bsdf=GREY),
        "occluder": {"type": "sphere", "center": [2, 0, 2], "radius": 0.25},
        "lamp": {"type": "sphere", "center": [4, 0, 4], "radius": 0.05, "emitter": glowing(1000.0)},
    }


def right_angle() -> dict:
    """A wall in front of the lamp throws its shadow on the floor before it."""
    floor = T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -90)
    lamp = T.look_at([0, 8, -4], [0, 0, 0], [0, 1, 0]) @ T.scale([2, 0.5, 1])
    return {
        "wall": rectangle(T.translate([0, 0, -1]), bsdf=diffuse(0.5)),
        "floor": rectangle(floor, bsdf=diffuse(0.5)),
        "lamp": rectangle(lamp, emitter=glowing(40.0)),
    }


DISK = T.translate([0.2, 0, -1]) @ T.rotate([0, 1, 0], 60) @ T.scale(1.5)
SUN = {"type": "directional", "direction": [0.4, 0.1, -1], "irradiance": 3.0}
CASES = {
    "diffuse rectangle under the sky": Case(
        {"rectangle": rectangle(T(), bsdf=GREY), "sky": SKY}, {"rectangle.vertex_positions": X}, 0.025, size=38
    ),
    "glowing rectangle": Case(
        {"light": rectangle(T.translate([1.25, 0, 0]), emitter=glowing(1.0))}, {"light.vertex_positions": X}, 0.02
    ),
    "glowing disk, its matrix": Case(
        {
            "light": {"type": "disk", "to_world": DISK, "emitter": glowing(2.0)},
            "sky": {"type": "constant", "radiance": 0.2},
        },
        {"light.to_world": X},
        0.02,
        depth=1,
        camera=from_here(1, fov=120),
    ),
    "glowing ball": Case(
        {"light": ball(T.translate([1.25, 0, 0]), emitter=glowing(1.0))}, {"light.vertex_positions": X}, 0.015
    ),
    "glowing ball that grows": Case({"light": ball(T(), emitter=glowing(1.0))}, {"light.vertex_positions": None}, 0.01),
    "occluder": Case(
        shadow(), {"occluder.center": X}, 0.025, spp_visibility=32, differences_spp=128, weight=in_the_middle
    ),
    "receiver in its plane": Case(shadow(), {"plane.vertex_positions": X}, 0.025, size=38, differences_spp=64),
    "plane and lamp": Case(
        {
            "plane": rectangle(T.translate([0, 0, -2]) @ T.scale(0.25), bsdf=GREY),
            "lamp": rectangle(T.translate([0, 0, -3]) @ T.scale(0.75), emitter=glowing(1.0)),
        },
        {"plane.vertex_positions": Z, "lamp.vertex_positions": Z},
        0.025,
        camera=from_here(0),
    ),
    "right angle that shadows itself": Case(
        right_angle(),
        {"wall.vertex_positions": Z, "floor.vertex_positions": Z},
        0.025,
        camera=from_here(1, fov=87),
        spp_visibility=48,
    ),
    "receiver along its normal": Case(
        shadow(),
        {"plane.vertex_positions": Z},
        0.02,
        step=0.04,
        spp=128,
        spp_visibility=96,
        differences_spp=192,
        weight=in_the_middle,
    ),
    "camera": Case({"ball": ball(T(), bsdf=GREY), "sky": SKY}, {"camera.to_world": X}, 0.02, spp_visibility=(8, 4)),
    "glowing rectangle beyond the border": Case(
        {"light": rectangle(T.translate([0.1, 0, 0]) @ T.scale([0.4, 3, 1]), emitter=glowing(1.0))},
        {"light.vertex_positions": X},
        0.02,
        depth=1,
        weight=at_the_border,
        film={"rfilter": {"type": "gaussian"}, "sample_border": False},
    ),
    "rectangle in the sun": Case(
        {"rectangle": rectangle(T(), bsdf=GREY), "sun": SUN},
        {"rectangle.vertex_positions": X},
        0.025,
        size=38,
        differences_spp=64,
    ),
    "glowing ball of interpolated normals": Case(
        {"light": ball(T.translate([1.25, 0, 0]), smooth=True, emitter=glowing(1.0))},
        {"light.vertex_positions": X},
        0.015,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_against_differences(name):
    case = CASES[name]
    scene = case.scene()
    settings = {"spp": case.spp, "differences_spp": case.differences_spp, "step": case.step, "seeds": 6}
    settings |= {"weight": case.weight, "spp_visibility": case.spp_visibility}
    check(*by_theta(scene, case.directions(scene), **settings), case.rtol, len(CASES))


@pytest.mark.parametrize("name", ["occluder", "right angle that shadows itself", "camera"])
def test_forward_mode_is_reverse_mode(name):
    case = CASES[name]
    scene = case.scene(16).to(torch.float64)
    moves = case.directions(scene)

    def f(theta):
        image = tr.render(scene, spp=8, seed=3, params=moved(scene, moves, theta))
        return weighted(image, case.weight)

    forward, reverse = both_modes(f)
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert abs(reverse) > 1e-3
