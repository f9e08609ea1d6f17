"""Cameras and lamps in media that bend light: refused, or warned of, by name."""

from __future__ import annotations

import warnings

import pytest
import torch
from bent_scenes import DOUBLE
from gradientindex_scenes import T, seen, thrown

import torchrender as tr

ONE = {"sky": {"type": "constant", "radiance": 1.0}}
FILM = {"type": "hdrfilm", "width": 2, "height": 2}


@pytest.mark.parametrize("at", [[0.3, 0.2, -0.4], [0.0, 0.0, 0.95]])
def test_cameras_inside(at):
    """Also behind a thing that is inside, too."""
    thing = {"type": "sphere", "radius": 0.2, "center": [a + 0.36 * 0.5 for a in at], "bsdf": {"type": "diffuse"}}
    scene = seen(1.5, back={**ONE, "thing": thing})
    camera = tr.load_dict({"type": "perspective", "to_world": T.translate(at), "film": FILM})
    with pytest.raises(ValueError, match=r"render: camera: the camera is in the gradientindex medium of lens.*trace"):
        tr.render(scene, sensor=camera, spp=1, seed=0)


def test_cameras_outside():
    scene = seen(1.5, back=ONE)
    for at in ([1.1, 0, 0], [-0.9, -0.9, -0.9], [0, 0, -1.001]):
        camera = tr.load_dict({"type": "perspective", "to_world": T.translate(at), "film": FILM})
        assert tr.render(scene, sensor=camera, spp=1, seed=0).shape == (2, 2, 3)


LAMPS = {
    "ball": {"type": "sphere", "radius": 0.1, "emitter": {"type": "area"}},
    "plate": {"type": "rectangle", "to_world": T.scale(0.1), "emitter": {"type": "area"}},
    "box": {"type": "cube", "to_world": T.scale(0.1), "emitter": {"type": "area"}},
    "disk": {"type": "disk", "to_world": T.scale(0.1), "emitter": {"type": "area"}},
    "point": {"type": "point", "position": [0.1, 0.0, 0.2]},
    "spot": {"type": "spot", "to_world": T.translate([0.1, 0.1, 0.1])},
}


@pytest.mark.parametrize("name", LAMPS)
def test_lamps_inside_have_no_light_paths(name):
    scene = thrown(1.5)
    scene[name] = tr.load_dict(LAMPS[name], dtype=DOUBLE)
    with pytest.raises(ValueError, match=rf"render: {name}: a lamp in the gradientindex medium of lens.*PathTracer"):
        tr.render(scene, spp=1, seed=0)


def test_points_inside_are_not_found():
    """Of which a warning tells the path tracer's user, once; one outside is seen as always."""
    scene = seen(1.5, back={**ONE, "point": LAMPS["point"]}, size=2)
    with pytest.warns(UserWarning, match="point lights nothing: no path finds a point in .* of lens; a small sphere"):
        tr.render(scene, spp=1, seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tr.render(scene, spp=1, seed=0)
        tr.render(seen(1.5, back={**ONE, "point": {**LAMPS["point"], "position": [2, 0, 0]}}, size=2), spp=1, seed=0)


def test_a_camera_moves_in():
    """By the parameters of a call, which the scene's own do not say."""
    scene = seen(1.5, back=ONE)
    with pytest.raises(ValueError, match="the camera is in the gradientindex medium of lens"):
        tr.render(scene, spp=1, seed=0, params={"camera.to_world": torch.eye(4, dtype=DOUBLE)})
