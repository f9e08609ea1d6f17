"""Indices of refraction: catalogues, prisms, and files of the refractiveindex.info database."""

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


HEAD = """# this file is part of refractiveindex.info database
REFERENCES: |
    Someone. <a href="https://example.org">Title: with a colon</a>
COMMENTS: "20 °C"
DATA:
"""
TAIL = """CONDITIONS:
    temperature: 293
PROPERTIES:
    thermal_dispersion:
      - type: formula A
        coefficients: 1.86e-06 1.31e-08
    nd: 1.5168
"""


def written(tmp_path, *entries: str) -> tuple[torch.Tensor, torch.Tensor]:
    path = tmp_path / "material.yml"
    path.write_text(HEAD + "".join(entries) + TAIL, encoding="utf-8")
    return sp.from_refractiveindex(path)


def formula(number: int, coefficients: str, limits: str = "0.3 2.5") -> str:
    return f"  - type: formula {number}\n    wavelength_range: {limits}\n    coefficients: {coefficients}\n"


def table(kind: str, *rows: str) -> str:
    return f"  - type: tabulated {kind}\n    data: |\n" + "".join(f"        {row}\n" for row in rows)


@pytest.mark.parametrize(
    ("number", "coefficients", "expected"),
    [
        # at 0.5 micrometres, whose square is 0.25
        (1, "0.1 0.8 0.2 0.5 10", math.sqrt(1.1 + 0.8 * 0.25 / 0.21 + 0.5 * 0.25 / (0.25 - 100))),
        (2, "0.1 0.8 0.04 0.5 100", math.sqrt(1.1 + 0.8 * 0.25 / 0.21 + 0.5 * 0.25 / (0.25 - 100))),
        (3, "2.2 -0.01 2 0.02 -2 0.001 -4", math.sqrt(2.2 - 0.0025 + 0.08 + 0.016)),
        (4, "2 0.3 2 0.2 2 0 0 0 1 -0.01 2", math.sqrt(2 + 0.3 * 0.25 / 0.21 - 0.0025)),
        (4, "2 0.3 0 0.1 1 0.2 2 5 2", math.sqrt(2 + 0.3 / 0.15 + 0.2 * 0.25 / (0.25 - 25))),
        (5, "1.4 0.01 -2 0.001 -4", 1.4 + 0.04 + 0.016),
        (6, "0.0001 0.05 238 0.001 57", 1.0001 + 0.05 / 234 + 0.001 / 53),
        (7, "1.5 0.01 0.002 -0.001 0.0003 -0.0001", 1.5 + 0.01 / 0.222 + 0.002 / 0.222**2 - 0.00025 + 0.0003 / 16
         - 0.0001 / 64),
        (8, "0.4 0.1 0.05 -0.01", math.sqrt((1 + 2 * 0.5225) / (1 - 0.5225))),
        (9, "2.2 0.02 0.03 0.01 0.3 0.5", math.sqrt(2.2 + 0.02 / 0.22 + 0.01 * 0.2 / 0.54)),
    ],
)  # fmt: skip
def test_formulas_of_files(tmp_path, number, coefficients, expected):
    n, k = written(tmp_path, formula(number, coefficients))
    assert n.shape == k.shape == (471,) and not k.any()
    assert float(n[140]) == pytest.approx(expected, abs=1e-12)


def test_a_file_of_a_catalogue(tmp_path):
    coefficients = "0 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653"
    rows = ("0.350 9.2894E-08", "0.500 9.5781E-09", "0.600 2E-08", "0.700 8.9305E-09")
    n, k = written(tmp_path, formula(2, coefficients), table("k", *rows))
    assert torch.allclose(n, sp.glass("N-BK7"), rtol=0, atol=1e-14)
    assert float(k[140]) == 9.5781e-9 and float(k[190]) == pytest.approx((9.5781e-9 + 2e-8) / 2, rel=1e-12)
    assert float(k[-1]) == 8.9305e-9  # beyond the data its last value
    n, k = written(tmp_path, table("nk", "0.4 1.5 0.1", "0.8 1.3 0.3"))
    assert float(n[240]) == pytest.approx(1.4, abs=1e-12) and float(k[240]) == pytest.approx(0.2, abs=1e-12)
    assert float(n[0]) == 1.5 and float(k[470]) == 0.3
    n, k = written(tmp_path, table("n", "0.4 1.5", "0.8 1.3"), table("k", "0.4 1", "0.8 3"))
    assert float(n[240]) == pytest.approx(1.4, abs=1e-12) and float(k[240]) == pytest.approx(2, abs=1e-12)
    n, _ = written(tmp_path, formula(5, "1.5 0.01 -2", "0.5 0.6"))
    assert float(n[0]) == float(n[140]) == 1.54 and float(n[470]) == pytest.approx(1.5 + 0.01 / 0.36, abs=1e-14)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([table("k", "0.4 1", "0.8 3")], "expected an index of refraction n, got k alone"),
        ([], "expected an index of refraction n, got no data alone"),
        ([formula(10, "1 2")], "formula 1 to 9, or tabulated n, k or nk, got 'formula 10'"),
        ([formula(2, "1 two")], "expected numbers, got '1 two'"),
        ([formula(8, "1 2 3 4 5")], "1 to 4 coefficients"),
        ([formula(2, "0 1 0.01", "0.3")], "two limits"),
        ([formula(2, "0 1 0.01", "1.5 2.5")], "between 0.36 and 0.83 micrometres, got 1.5 to 2.5"),
        ([formula(2, "0 -9 0.01")], "expected n finite and not negative"),
        ([table("nk", "0.4 1.5")], "a wavelength and n and k"),
        ([table("n", "0.4 1.5", "oops")], "expected numbers, got 'oops'"),
        ([formula(5, "1.5"), table("n", "0.4 1.5", "0.8 1.5")], "expected one n, got two"),
        (["    stray\n"], "line 6: expected a key"),
    ],
)
def test_bad_files_are_named(tmp_path, entries, message):
    with pytest.raises(ValueError, match=rf"material\.yml.*{message}"):
        written(tmp_path, *entries)


def test_files_that_are_none(tmp_path):
    (tmp_path / "other.yml").write_text("a: 1\n")
    with pytest.raises(ValueError, match=r"other\.yml: .*DATA"):
        sp.from_refractiveindex(tmp_path / "other.yml")
    with pytest.raises(FileNotFoundError, match="path: no such file"):
        sp.from_refractiveindex(tmp_path / "none.yml")
    with pytest.raises(TypeError, match="path"):
        sp.from_refractiveindex(3)


def test_spectra_are_written(tmp_path):
    at, values = double(400, 500.25, 700), double(0.1, 1 / 3, 0.9)
    tr.io.write_spectrum(tmp_path / "a.spd", at, values)
    read = tr.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "filename": str(tmp_path / "a.spd")}})
    pairs = [*zip(at.tolist(), values.tolist())]
    same = tr.load_dict({"type": "diffuse", "reflectance": {"type": "spectrum", "value": pairs}})
    assert torch.equal(read.reflectance.value, same.reflectance.value)
    assert np.array_equal(np.loadtxt(tmp_path / "a.spd"), np.array(pairs))
    for bad, kind, message in (
        (("a.txt", at, values), ValueError, r"a\.txt: unknown format of spectra '\.txt'"),
        (("b.spd", at.flip(0), values), ValueError, "wavelengths: .*increasing"),
        (("b.spd", at, values[:2]), ValueError, "values: expected 3 numbers"),
        (("b.spd", at, [1.0, float("nan"), 2.0]), ValueError, "values: expected finite"),
        (("b.spd", "x", values), TypeError, "wavelengths: expected numbers"),
        (("none/b.spd", at, values), FileNotFoundError, "no such folder"),
    ):
        with pytest.raises(kind, match=message):
            tr.io.write_spectrum(tmp_path / bad[0], *bad[1:])
    assert not (tmp_path / "b.spd").exists()
