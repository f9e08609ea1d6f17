"""Edges that move in spectral scenes: silhouettes, shadows, and what reflected light meets.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import warnings

import pytest
import torch
from moving_differences import agrees, compare
from shadow_scenes import room

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

pytestmark = pytest.mark.once

CASES = 12  # statistical tests in this file, at most
GREY = (0.5, 0.5, 0.5)


@pytest.mark.parametrize(
    ("light", "depth", "parameter"),
    [("rectangle", 2, "plate.to_world"), ("point", 3, "box.vertex_positions"), ("sky", 2, "box.vertex_positions"),
     ("rectangle", 3, "lamp.to_world")],
)  # fmt: skip
def test_differences(light, depth, parameter):
    scene = room(light, depth, variant="spectral")
    with warnings.catch_warnings():  # nothing is missing
        warnings.simplefilter("error", tr.MissingTermWarning)
        derivatives, differences = compare(scene.to(torch.float32), parameter, 6, 256, 5e-3)
    passed, text = agrees(derivatives, differences, 0.02, CASES)
    assert passed, text
    assert float(differences.abs().mean()) > 1e-4


@pytest.mark.parametrize("part", [(64, 0), (0, 64)], ids=["seen", "cast"])
def test_grey_scenes_are_those_of_rgb(part):
    """What outlines alone bring, by channel."""
    found = []
    for variant in ("rgb", "spectral"):
        scene = room("sky", 3, variant=variant, box_colour=GREY)
        (leaf,) = scene.train_only("plate.to_world")
        settings = {"spp": 1, "spp_visibility": part}
        runs = []
        for seed in range(8):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                image = tr.render(scene, seed=seed, **settings)
            weight = torch.linspace(0, 1, 12, dtype=torch.float64)[:, None]
            grads = [torch.autograd.grad((image[..., c] * weight).mean(), leaf, retain_graph=True)[0] for c in range(3)]
            plain = tr.render(scene, seed=seed, spp=1, visibility=False)
            without = [
                torch.autograd.grad((plain[..., c] * weight).mean(), leaf, retain_graph=True)[0] for c in range(3)
            ]
            runs.append(torch.stack([(a - b)[:3, 3] for a, b in zip(grads, without)]))
        found.append(torch.stack(runs))
    rgb, spectral = found
    gap = spectral.mean(0) - rgb.mean(0)
    error = (spectral.var(0) / 8 + rgb.var(0) / 8).sqrt()
    p = student_p_value((gap / error).abs().flatten(), 7)
    assert float(p.min()) >= sidak(0.01, CASES * p.numel()), (spectral.mean(0), rgb.mean(0), error)
    assert float((error / rgb.mean(0).abs().max()).max()) < 0.1  # it could fail


@pytest.mark.parametrize("light", ["rectangle", "sky"])
def test_forward_mode_is_reverse_mode(light):
    scene = room(light, 3, variant="spectral")
    names = ["box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world"]
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message


def test_bands():
    """More bands than a path has wavelengths: each group of them has its own samples."""
    scene = room("point", 2, variant="spectral")
    flat = {"type": "uniform", "value": 1e-2}
    scene.sensors[0].film = tr.Film(12, 12, bands=dict.fromkeys("abcd", flat))
    derivatives, differences = compare(scene, "plate.to_world", 6, 256, 5e-3, show=lambda image: image[..., 1:])
    passed, text = agrees(derivatives, differences, 0.02, CASES)
    assert passed, text
