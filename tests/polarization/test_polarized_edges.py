"""Edges that move in Stokes vectors: silhouettes, shadows, and what reflected light meets.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import warnings

import pytest
import torch
from moving_differences import agrees, compare
from shadow_scenes import room

import torchrender as tr

pytestmark = pytest.mark.once

CASES = 12  # statistical tests in this file, at most
METAL = {"type": "roughconductor", "material": "Au", "alpha": 0.3}
PLASTIC = {"type": "roughplastic", "alpha": 0.3}
ROUGH_GLASS = {"type": "roughdielectric", "int_ior": 1.5, "alpha": 0.3}
WEIGHTS = torch.tensor([0.3, 1.0, -1.5, 2.0], dtype=torch.float64)  # of I, Q, U and V


def shown(out) -> torch.Tensor:
    return (out.stokes * WEIGHTS).sum(-1)


@pytest.mark.parametrize(
    ("light", "depth", "parameter", "floor"),
    [("polarised rectangle", 3, "plate.to_world", METAL), ("polarised point", 2, "box.vertex_positions", PLASTIC),
     ("sky", 3, "box.vertex_positions", METAL), ("sky", 2, "camera.to_world", ROUGH_GLASS)],
)  # fmt: skip
def test_differences(light, depth, parameter, floor):
    scene = room(light, depth, floor)
    with warnings.catch_warnings():  # nothing is missing
        warnings.simplefilter("error", tr.MissingTermWarning)
        derivatives, differences = compare(scene.to(torch.float32), parameter, 6, 256, 5e-3, shown, outputs=("stokes",))
    passed, text = agrees(derivatives, differences, 0.02, CASES)
    assert passed, text
    assert float(differences.abs().mean()) > 5e-5


@pytest.mark.parametrize("light", ["rectangle", "sky"])
@pytest.mark.parametrize("variant", ["rgb", "spectral"])
def test_unpolarised_light_has_the_derivative_of_the_image(light, variant, monkeypatch):
    """Of the same samples, traced as polarised light: intensity is radiance, and the rest is zero."""
    monkeypatch.setattr("torchrender.render_polarized.polarizes", lambda packed: True)
    scene = room(light, 3, variant=variant)
    leaves = scene.train_only("plate.to_world", "box.vertex_positions")
    stokes = tr.render(scene, spp=4, seed=3, outputs=("stokes",)).stokes
    weight = torch.rand(stokes.shape[:3], generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    expected = torch.autograd.grad((tr.render(scene, spp=4, seed=3) * weight).sum(), leaves)
    found = torch.autograd.grad((stokes[..., 0] * weight).sum(), leaves, retain_graph=True)
    for a, b in zip(found, expected):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9 * float(b.abs().max()))
    rest = torch.autograd.grad((stokes[..., 1:] * weight[..., None]).sum(), leaves)
    assert all(float(r.abs().max()) <= 1e-9 * float(b.abs().max()) for r, b in zip(rest, expected))


@pytest.mark.parametrize("variant", ["rgb", "spectral"])
def test_forward_mode_is_reverse_mode(variant):
    scene = room("rectangle", 3, METAL, variant=variant)
    names = ["box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world"]
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)), outputs=("stokes",)).stokes

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message
