"""Stokes images against products of Mueller matrices in PyTorch (tests/oracle/polarized.py), with the same random
numbers: images, and gradients by autograd, are equal to rounding."""

from __future__ import annotations

import pytest
import reference_scenes as r
import torch
from in_torch import SPP, differentiable
from oracle.polarized import stokes_image
from oracle.scene_parts import small, tube
from oracle.scenes import SCENES

import torchrender as tr

pytestmark = [
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
    pytest.mark.filterwarnings("ignore:.*what this scatters is unpolarised"),
]
SEED = 5


def panes() -> dict:
    """Tilted plates one behind the other, panes of glass and films of air, some of which reflect all, before metals."""

    def plate(x: float, y: float, z: float, angle: float, bsdf: dict) -> dict:
        place = r.translate(x, y, z) @ r.rotate("y", angle) @ r.rotate("x", 10) @ r.scale(0.5)
        return {"type": "rectangle", "to_world": place, "bsdf": bsdf}

    gold, aluminium = ({"type": "conductor", "eta": eta, "k": k} for eta, k in ((0.18, 3.4), (1.4, 7.6)))
    glass = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    air = {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.5}
    return r._scene(
        {"type": "path", "max_depth": 9, "rr_depth": 100},
        r._camera(fov=45),
        ball={"type": "sphere", "center": [0.1, 0.2, -0.3], "radius": 0.8, "bsdf": gold},
        tube=tube(to_world=r.translate(1.3, -0.4, 0.4) @ r.scale(0.5), bsdf={"type": "twosided", "bsdf": aluminium}),
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": {**aluminium, "type": "roughconductor", "alpha": 0.3}},
        filter=plate(-0.6, 0.5, 1.6, 25, {"type": "polarizer", "theta": 20.0}),
        wave=plate(-0.4, 0.4, 1.9, -40, {"type": "retarder", "theta": 35.0, "delta": 70.0}),
        second=plate(-0.5, 0.5, 2.2, 190, {"type": "retarder", "theta": -10.0, "delta": 120.0}),
        circle=plate(-0.1, 0.3, 2.5, 10, {"type": "circular", "left_handed": True}),
        pane=plate(0.5, 0.4, 1.9, 50, glass),
        before=plate(0.4, 0.3, 2.3, 35, glass),
        film=plate(0.3, 0.2, 1.4, -30, air),
        mirror=plate(0.9, 0.7, 1.2, 60, air),
        sky={"type": "envmap", "data": r._noise(38, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40)},
    )


DESCRIPTIONS = {name: SCENES[name] for name in ("glass", "rough", "layers", "normals", "brushed")}
DESCRIPTIONS["panes"] = lambda: small(panes())


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
