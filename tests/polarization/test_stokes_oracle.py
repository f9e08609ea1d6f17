"""Stokes images against products of Mueller matrices in PyTorch (tests/oracle/polarized.py), with the same random
numbers: images, and gradients by autograd, are equal to rounding."""

from __future__ import annotations

import pytest
import torch
from in_torch import SPP, differentiable
from oracle.polarized import stokes_image
from oracle.scene_parts import small
from oracle.scenes import SCENES
from oracle.stokes_scenes import lamps, panes

import torchrender as tr

pytestmark = [
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
    pytest.mark.filterwarnings("ignore:.*what this scatters is unpolarised"),
]
SEED = 5


DESCRIPTIONS = {name: SCENES[name] for name in ("glass", "rough", "layers", "normals", "brushed")}
DESCRIPTIONS.update(panes=lambda: small(panes()), lamps=lambda: small(lamps()))


def scene_of(name: str) -> tr.Scene:
    return tr.load_dict(DESCRIPTIONS[name](), dtype=torch.float64)


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_image(name):
    scene = scene_of(name)
    with torch.no_grad():
        found = tr.render(scene, spp=SPP, seed=SEED, outputs=("stokes",)).stokes
        expected = stokes_image(scene, spp=SPP, seed=SEED)
    assert expected[..., 1:3].abs().amax((0, 1, 2)).min() > 1e-3 * expected.abs().max()
    assert (found - expected).abs().max() <= 1e-12 * expected.abs().max()


def assert_equal(scene: tr.Scene, values: dict[str, torch.Tensor], *pair: torch.Tensor) -> None:
    """The gradients of two numbers, but for what rounding makes of terms that cancel."""
    leaves = list(values.values())
    found, expected = (torch.autograd.grad(x, leaves, materialize_grads=True) for x in pair)
    assert sum(bool(b.any()) for b in expected) > len(leaves) / 4
    largest = max(float(b.abs().max()) for b in expected)
    for name, a, b in zip(values, found, expected, strict=True):
        assert (a - b).abs().max() <= 1e-8 * b.abs().max() + 1e-12 * largest, name


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_gradients(name):
    """Of a weighted mean of Q, U and V, by every parameter that has a derivative."""
    scene = scene_of(name)
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    native = {"spp": 1, "seed": 1, "spp_grad": SPP, "seed_grad": SEED, "params": values, "visibility": False}
    found = tr.render(scene, outputs=("stokes",), **native).stokes
    expected = stokes_image(scene, spp=SPP, seed=SEED, params=values, derivative=True)
    weight = torch.rand(found.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64) - 0.5
    weight[..., 0] = 0
    assert_equal(scene, values, (found * weight).mean(), (expected * weight).mean())


def test_gradients_of_the_degree_of_polarisation():
    scene = scene_of("panes")
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    settings = {"spp": SPP, "seed": SEED, "params": values}
    found = tr.render(scene, outputs=("dolp",), correlated=True, visibility=False, **settings).dolp
    expected = tr.polarization.dolp(stokes_image(scene, derivative=True, **settings))
    assert_equal(scene, values, found.square().mean(), expected.square().mean())
