"""Indices of refraction: catalogues, prisms, formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.spectrum.glasses import GLASSES

sp = tr.spectrum
DOUBLE = torch.float64
YELLOW, BLUE, RED = 587.56, 486.13, 656.27

# n_d and V_d: of Schott's catalogue; of the others those that go with these measurements in other catalogues.
CATALOGUE = {
    "N-BK7": (1.51680, 64.17),
    "N-K5": (1.52249, 59.48),
    "N-BAK4": (1.56883, 55.98),
    "N-BAF10": (1.67003, 47.11),
    "N-SK16": (1.62041, 60.32),
    "N-FK51A": (1.48656, 84.47),
    "F2": (1.62004, 36.37),
    "N-F2": (1.62005, 36.43),
    "N-SF5": (1.67271, 32.25),
    "N-SF6": (1.80518, 25.36),
    "SF10": (1.72825, 28.41),
    "N-SF11": (1.78472, 25.68),
    "N-LASF9": (1.85025, 32.17),
    "fused silica": (1.45846, 67.82),
    "water": (1.33341, 55.76),
    "diamond": (2.41749, 55.3),
    "sapphire": (1.76817, 72.31),
    "CaF2": (1.43385, 95.0),
    "BaF2": (1.47448, 81.61),
    "MgF2": (1.37774, 106.2),
}


def double(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=DOUBLE)


def at(table: torch.Tensor, nanometres: float) -> float:
    return float(np.interp(nanometres, sp.wavelengths(), table))


def test_every_glass_is_in_the_catalogue():
    assert set(CATALOGUE) == set(GLASSES) and all(origin for _, _, origin in GLASSES.values())


@pytest.mark.parametrize("name", CATALOGUE)
def test_glasses(name):
    n_d, V_d = CATALOGUE[name]
    table = sp.glass(name)
    assert table.shape == (471,) and bool((table.diff() < 0).all())
    assert at(table, YELLOW) == pytest.approx(n_d, abs=1.1e-5)
    assert float(sp.abbe_number(table)) == pytest.approx(V_d, abs=0.02 if V_d < 90 else 0.05)
    assert torch.equal(sp.glass(name.lower().replace("-", " ")), table)


@pytest.mark.parametrize(
    ("name", "angles"),
    [
        ("N-BK7", (39.138, 38.647, 38.429)),
        ("SF10", (61.675, 59.566, 58.728)),
        ("F2", (49.381, 48.196, 47.708)),
    ],
)
def test_prisms_of_60_degrees_at_minimum_deviation(name, angles):
    for line, expected in zip((BLUE, YELLOW, RED), angles):
        found = 2 * math.degrees(math.asin(at(sp.glass(name), line) * 0.5)) - 60
        assert found == pytest.approx(expected, abs=6e-4)


def test_abbe_s_numbers_lead_to_a_glass_that_has_them():
    table = sp.abbe(double(1.5168, 1.72825), double(64.17, 28.41))
    assert table.shape == (2, 471)
    assert [at(row, YELLOW) for row in table] == pytest.approx([1.5168, 1.72825], abs=1e-6)
    assert sp.abbe_number(table).tolist() == pytest.approx([64.17, 28.41], rel=1e-4)
    # which are near to the glass itself
    assert float((table[0] - sp.glass("N-BK7")).abs().max()) < 3e-3


def test_formulas():
    assert at(sp.cauchy(1.5, 0.004), 500) == pytest.approx(1.5 + 0.004 / 0.25, abs=1e-14)
    one = sp.sellmeier(double(1.25), double(0.01))
    assert at(one, 500) == pytest.approx(math.sqrt(1 + 1.25 * 0.25 / 0.24), abs=1e-14)
    assert sp.cauchy(torch.ones(3), torch.zeros(2, 1)).shape == (2, 3, 471)
    assert sp.cauchy(torch.ones(3), torch.zeros(3)).dtype == torch.float32


def test_derivatives():
    def check(function, *inputs):
        return torch.autograd.gradcheck(function, [i.requires_grad_() for i in inputs], check_forward_ad=True)

    assert check(sp.cauchy, double(1.5), double(0.004))
    assert check(sp.abbe, double(1.5, 1.7), double(60, 30))
    b, c, _ = GLASSES["SF10"]
    assert check(sp.sellmeier, double(b), double(c))
    assert torch.autograd.gradcheck(sp.abbe_number, sp.glass("F2").requires_grad_(), fast_mode=True)
    slopes = torch.vmap(torch.func.grad(lambda n: sp.abbe(n, 50.0)[200]))(double(1.5, 1.6))
    assert slopes.shape == (2,) and bool(slopes.isfinite().all())


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: sp.glass("N-BK8"), ValueError, "name: expected a material, got 'N-BK8'.*did you mean 'N-BK7'"),
        (lambda: sp.glass("cheese"), ValueError, "known here: .*fused silica.*water"),
        (lambda: sp.glass(7), ValueError, "name: expected a material, got 7"),
        (lambda: sp.abbe(1.5, 0.0), ValueError, "V_d: expected a positive number, got 0"),
        (lambda: sp.abbe(0.9, 60.0), ValueError, "n_d: expected an index above 1, got 0.9"),
        (lambda: sp.cauchy("a", 1.0), TypeError, "a: expected numbers"),
        (lambda: sp.sellmeier(torch.ones(3), torch.ones(2)), ValueError, "c: expected 3 numbers"),
        (lambda: sp.sellmeier(torch.ones(1), torch.full((1,), 0.25)), ValueError, "c: expected squares.*got 0.25"),
        (lambda: sp.sellmeier(torch.full((1,), -9.0), torch.zeros(1)), ValueError, "b, c: .*positive"),
        (lambda: sp.abbe_number(torch.ones(3)), ValueError, "table: expected shape"),
    ],
)
def test_mistakes_are_named(call, kind, message):
    with pytest.raises(kind, match=message):
        call()
