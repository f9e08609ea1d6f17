"""Where media begin and end: next to each other, behind surfaces, at infinity. Closed forms; probabilities of chance
failures are below 1e-6 each (five standard errors)."""

from __future__ import annotations

import math

import pytest
import torch
from media_truth import pencil, scene, seen
from slab_truth import h_function

import torchrender as tr

NULL = {"type": "null"}
COLOURS = [0.2, 0.5, 1.0]


def check(runs: torch.Tensor, expected: list[float]) -> None:
    """Means of independent runs (n, channels) are within five standard errors, and 0.2 % of what rounding does."""
    mean, error = runs.mean(0), runs.std(0) / math.sqrt(len(runs))
    for c, value in enumerate(expected):
        assert abs(float(mean[c]) - value) < 5 * float(error[c]) + 2e-3 * abs(value) + 1e-9, (c, mean, error, expected)


def touching(albedo: float) -> dict:
    """A glowing grey cube in a coloured ball, without a gap."""
    return {
        "camera": pencil([0, 0, 8], [0, 0, 0]),
        "fog": {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": COLOURS}, "albedo": albedo},
        "ball": {"type": "sphere", "radius": 2, "bsdf": NULL, "interior": {"type": "ref", "id": "fog"}},
        "cube": {
            "type": "cube",
            "bsdf": NULL,
            "interior": {"type": "homogeneous", "sigma_t": 1.0, "albedo": albedo, "emission": 1.0},
            "exterior": {"type": "ref", "id": "fog"},
        },
    }


def test_a_grey_medium_seen_through_a_coloured_one():
    view = scene(touching(0.0))
    check(seen(view, spp=256)[:, 0], [math.exp(-s) * (1 - math.exp(-2)) for s in COLOURS])


def test_gradient_of_a_grey_medium_in_a_coloured_one():
    """Of absorption and emission: I = e (1 - exp(-2 s)) / s exp(-c), by s at s = 1."""
    view = scene(touching(0.0))
    (name,) = [n for n, _ in view.named_parameters() if n.startswith("cube") and "sigma_t" in n]
    (sigma,) = view.train_only(name)
    runs = []
    for seed in range(16):
        image, row = tr.render(view, spp=64, seed=seed).mean((0, 1)), []
        for c in range(3):
            sigma.grad = None
            image[c].backward(retain_graph=True)
            row.append(float(sigma.grad))
        runs.append(row)
    slope = 2 * math.exp(-2) - (1 - math.exp(-2))
    check(torch.tensor(runs, dtype=torch.float64), [math.exp(-s) * slope for s in COLOURS])


@pytest.mark.parametrize("sigma", [1e2, 1e4])
@pytest.mark.parametrize("half", [1.0, 100.0])
def test_a_dense_medium_begins_at_its_boundary(sigma, half):
    """A half space of albedo 1/2 returns 1 - sqrt(1/2) H(1) of a uniform sky (Chandrasekhar), however dense it is."""
    view = scene(
        {
            "camera": pencil([0.2 * half, 0.1 * half, 4 * half], [0.2 * half, 0.1 * half, 0]),
            "block": {
                "type": "cube",
                "to_world": tr.Transform().scale([half] * 3),
                "bsdf": NULL,
                "interior": {"type": "homogeneous", "sigma_t": sigma / half, "albedo": 0.5},
            },
            "sky": {"type": "constant", "radiance": 1.0},
        },
        max_depth=-1,
        rr_depth=20,
    )
    check(seen(view, spp=64)[:, 0, :1], [1 - math.sqrt(0.5) * h_function(0.5)])


def test_an_endless_medium_without_extinction_in_a_channel():
    """Light from infinitely far away arrives where nothing is in its way, and nowhere else."""
    fog = {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": [0.0, 1.0, 2.0]}, "albedo": 0.0}
    view = scene(
        {
            "fog": fog,
            "camera": {**pencil([0, 0, 1], [0, 0, 0]), "medium": {"type": "ref", "id": "fog"}},
            "floor": {
                "type": "rectangle",
                "to_world": tr.Transform().scale([1e3, 1e3, 1]),
                "bsdf": {"type": "diffuse", "reflectance": 1.0},
                "exterior": {"type": "ref", "id": "fog"},
            },
            "sky": {"type": "constant", "radiance": 1.0},
        },
        max_depth=4,
    )
    check(seen(view)[:, 0], [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("medium", "message"),
    [
        ({"sigma_t": 1e30, "scale": 1e30}, "sigma_t"),
        ({"sigma_t": {"type": "gridvolume", "data": torch.full((4, 4, 4), 1e9)}}, "sigma_t"),
    ],
)
def test_extinctions_that_nothing_can_be_traced_through_are_refused(medium, message):
    view = scene(
        {
            "camera": pencil([0, 0, 4], [0, 0, 0]),
            "ball": {"type": "sphere", "bsdf": NULL, "interior": {"type": "heterogeneous", **medium}},
        }
    )
    with pytest.raises(ValueError, match=message):
        tr.render(view, spp=1)
