"""Outlines of height fields: their contours, borders and creases, against differences.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from moving_differences import agrees, compare

import torchrender as tr

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

DOUBLE = torch.float64
CASES = 10  # statistical tests in this file, at most
SEEDS = 6
FILM = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
FLOOR = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, -0.6]) @ tr.Transform.scale(4)}
BACK = tr.Transform.translate([0, 2, 0]) @ tr.Transform.rotate([1, 0, 0], 90) @ tr.Transform.scale(3)
AROUND_HILLS = {
    # what has no shading, before a bright wall, shows nothing but its contours and its border
    "seen": {"sky": {"type": "constant", "radiance": 0.2},
             "back": {"type": "rectangle", "to_world": BACK, "emitter": {"type": "area", "radiance": 0.5}}},
    "point": {"floor": FLOOR, "lamp": {"type": "point", "position": [2, 1, 0.8], "intensity": 6.0}},
    "sun": {"floor": FLOOR, "lamp": {"type": "directional", "direction": [-1, -0.4, -0.25], "irradiance": 3.0}},
    "sky": {"sky": {"type": "envmap", "data": np.random.default_rng(3).uniform(0.2, 2, (8, 16, 3))}},
}  # fmt: skip


def hills(interpolation: str, around: str) -> tr.Scene:
    """A steep height field that hides parts of itself, seen from the side."""
    heights = 0.5 * np.random.default_rng(0).random((12, 12))
    place = tr.Transform.look_at([0.4, -3.2, 1.3], [0, 0, 0.15], [0, 0, 1])
    field = {
        "type": "heightfield",
        "heights": heights,
        "interpolation": interpolation,
        "to_world": tr.Transform.rotate([0, 0, 1], 20),
        "bsdf": {"type": "diffuse", "reflectance": 0.0 if around == "seen" else 0.5},
    }
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "camera": {"type": "perspective", "fov": 40, "to_world": place, "film": FILM},
        "field": field,
        **AROUND_HILLS[around],
    }
    return tr.load_dict(scene, dtype=DOUBLE)


@pytest.mark.parametrize(
    ("interpolation", "around", "parameter"),
    [
        ("bspline", "seen", "field.heights"),
        ("bspline", "seen", "camera.to_world"),
        ("bspline", "point", "field.to_world"),
        ("bspline", "sun", "field.to_world"),
        ("bspline", "sky", "field.heights"),
        ("bilinear", "seen", "field.to_world"),
        ("bilinear", "point", "field.heights"),
    ],
)
def test_height_fields(interpolation, around, parameter):
    """Contours, borders and, of bilinear patches, creases, seen and as edges of shadows."""
    derivatives, differences = compare(hills(interpolation, around), parameter, SEEDS, 300, 3e-3)
    passed, text = agrees(derivatives, differences, 0.02, CASES)
    assert passed, f"{parameter}: {text}"
    assert float(differences.abs().mean()) > 1e-4


def test_height_fields_lack_nothing():
    scene = hills("bspline", "point")
    scene.train_only("field.heights")
    with warnings.catch_warnings():
        warnings.simplefilter("error", tr.MissingTermWarning)
        image = tr.render(scene, spp=1)
    forward = torch.func.jvp(
        lambda h: tr.render(scene, spp=1, spp_grad=16, seed=3, params={"field.heights": h}),
        (scene["field"].heights.detach(),),
        (torch.ones_like(scene["field"].heights),),
    )[1]
    heights = scene["field"].heights.detach().requires_grad_()
    weight = torch.rand(image.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    image = tr.render(scene, spp=1, spp_grad=16, seed=3, params={"field.heights": heights})
    (reverse,) = torch.autograd.grad((image * weight).sum(), heights)
    torch.testing.assert_close(reverse.sum(), (forward * weight).sum(), rtol=1e-9, atol=1e-12)


def test_gentle_height_fields_have_no_contours():
    """From above nothing of a gentle slope is an outline, and no ray is spent on it."""
    heights = torch.linspace(0, 0.1, 8, dtype=DOUBLE).expand(8, 8).clone()
    field = {"type": "heightfield", "heights": heights, "to_world": tr.Transform.scale(5)}
    above = tr.Transform.look_at([0.1, 0.2, 4], [0, 0.05, 0], [0, 1, 0])
    view = {"type": "perspective", "fov": 40, "to_world": above, "film": FILM}
    scene = {"type": "scene", "camera": view, "field": field, "sky": {"type": "constant"}}
    scene = tr.load_dict(scene, dtype=DOUBLE)
    scene.train_only("field.heights")
    tr.render(scene, spp=1).sum().backward()
    assert scene.statistics["visibility"]["silhouettes"]["rays"] == 0
