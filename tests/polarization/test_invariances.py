"""What holds of all Stokes images: turning the world changes nothing, and no light is polarised by more than 1."""

from __future__ import annotations

import math

import pytest
import torch
from optical_bench import T, bench, stokes, surface
from polarized_scenes import SCENES

import torchrender as tr

pytestmark = pytest.mark.core


def test_a_scene_that_is_turned():
    """Where all is smooth directions do not depend on frames: images are equal, up to where rays begin.

    That is off the surface by 9e-5 of the largest coordinate and 1, which curved mirrors and glass magnify.
    """
    gold, glass = {"type": "conductor", "eta": 0.183, "k": 3.43}, {"type": "dielectric", "int_ior": 1.5}
    place = T.look_at([0.3, -1.5, 1.6], [0.5, -1, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "box"}}
    pose = T.look_at([0.5, -3, 2], [0.4, 0, 0], [0.2, 0, 1])
    objects = {
        "sensor": {"type": "perspective", "fov": 45, "to_world": pose, "film": film},
        "ball": {"type": "sphere", "to_world": T.scale(0.8), "bsdf": gold},
        "drop": {"type": "sphere", "to_world": T.translate([1.3, 0, 0]) @ T.scale(0.5), "bsdf": glass},
        "floor": {"type": "rectangle", "to_world": T.translate([0, 0, -0.9]) @ T.scale(9), "bsdf": gold},
        "filter": {"type": "rectangle", "to_world": place @ T.scale(0.4), "bsdf": {"type": "polarizer", "theta": 30.0}},
        "lamp": {
            "type": "sphere",
            "to_world": T.translate([-2, 2, 3]) @ T.scale(1.5),
            "emitter": {"type": "area", "radiance": 3.0},
        },
    }
    images = []
    for turn in (T.rotate([0, 0, 1], 0), T.rotate([1, -2, 3], 110)):
        turned = {name: {**o, "to_world": turn @ o["to_world"]} for name, o in objects.items()}
        rest = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 7, "rr_depth": 100},
            "sky": {"type": "constant"},
        }
        scene = tr.load_dict({**rest, **turned}, dtype=torch.float64)
        images.append(tr.render(scene, spp=4, seed=2, outputs=("stokes",)).stokes)
    assert images[0][..., 1:].abs().amax((0, 1, 2)).min() > 0.01
    assert (images[0] - images[1]).abs().max() < 1e-3


@pytest.mark.parametrize("name", ["metals", "glass", "tilted_polariser", "circular"])
def test_no_light_is_polarised_beyond_one(name):
    scene = tr.load_dict(SCENES[name](), variant="mono", dtype=torch.float64)
    light = tr.render(scene, spp=1, seed=1, outputs=("stokes",)).stokes[..., 0, :]
    assert (light[..., 1:].norm(dim=-1) <= light[..., 0] * (1 + 1e-12)).all()
    assert (light[..., 1:].norm(dim=-1) > 0.05 * light[..., 0]).any()


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0])
def test_a_polariser_between_crossed_ones(angle):
    """It lets sin^2(2 theta) / 8 pass, whose derivative is sin(4 theta) / 4: where no light passes it is 0."""
    theta = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    plates = {
        f"filter{i}": surface({"type": "polarizer", "theta": t}, to_world=T.translate([0, 0, -0.1 * i]))
        for i, t in enumerate((0.0, angle, 90.0))
    }
    light = stokes(bench("unpolarised", 180, 0, **plates), params={"filter1.bsdf.theta.value": theta})[0]
    light.backward()
    assert abs(float(light.detach()) - math.sin(math.radians(2 * angle)) ** 2 / 8) < 1e-9
    assert abs(float(theta.grad) - math.sin(math.radians(4 * angle)) / 4 * math.pi / 180) < 1e-9
