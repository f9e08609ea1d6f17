"""Files: those of the refractiveindex.info database, and spectra that are written."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torchrender as tr

sp = tr.spectrum


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
    at, values = torch.tensor([400, 500.25, 700]), torch.tensor([0.1, 1 / 3, 0.9], dtype=torch.float64)
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
