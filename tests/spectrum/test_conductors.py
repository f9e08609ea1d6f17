"""Indices of refraction of metals by wavelength, against Mitsuba's (`bench/make_conductor_spectra.py`)."""

from __future__ import annotations

import numpy as np
import pytest
from reference_parts import DATA

from torchrender.scene.conductors import CONDUCTORS, conductor_range, conductor_spectra
from torchrender.spectrum import cie

GRID = np.arange(360.0, 831.0)
HOLE = (387.438, 393.587, 435.018, 442.786)  # nm: last eta of AlAs before the hole, zeros from here to here, next eta


@pytest.fixture(scope="module")
def stored() -> dict[str, np.ndarray]:
    with np.load(DATA / "conductor_spectra.npz") as file:
        return dict(file)


def measured(name: str) -> np.ndarray:
    """Where there are measurements, of every nm."""
    low, high = conductor_range(name)
    return (low <= GRID) & (high >= GRID)


@pytest.mark.parametrize("name", CONDUCTORS)
@pytest.mark.parametrize("part", ["eta", "k"])
def test_mitsubas_values(stored, name, part):
    row = list(stored["names"]).index(name)
    ours, theirs = conductor_spectra(name)[part == "k"][::5], stored[part][row].astype(np.float64)
    known = measured(name)[::5]
    assert (theirs[~known] == 0).all()
    if (name, part) == ("AlAs", "eta"):
        known &= (GRID[::5] < HOLE[0]) | (GRID[::5] > HOLE[3])
    np.testing.assert_allclose(ours[known], theirs[known], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", CONDUCTORS)
@pytest.mark.parametrize("part", [0, 1])
def test_the_colours_are_those_of_the_spectra(name, part):
    # as Mitsuba makes them: of light as it is, where nothing was measured 0, and no channel negative
    spectrum = conductor_spectra(name)[part] * measured(name)
    if (name, part) == ("AlAs", 0):
        spectrum = spectrum * np.interp(GRID, HOLE, [1, 0, 0, 1])
    color = cie.rgb_of_spectrum(GRID, spectrum, emission=True).clip(0)
    given = CONDUCTORS[name][part]
    # Mitsuba's constant of the luminance and its steps; more where the measurements break off in the visible
    breaks_off = {"AlSb": 0.04, "d-C": 5e-3}
    np.testing.assert_allclose(color, given, rtol=0, atol=breaks_off.get(name, 1e-3 * max(given) + 6e-4))


def test_beyond_the_measurements_the_last_is_held():
    assert conductor_range("AlSb") == (360.0, pytest.approx(590.381, abs=1e-3))
    eta, k = conductor_spectra("AlSb")
    held = GRID > 595
    assert (eta[held] == np.float32(4.01)).all() and (k[held] == np.float32(0.006)).all()
    assert conductor_range("Au") == (360.0, 830.0)


def test_the_hole_of_alas_is_a_straight_line():
    eta, k = conductor_spectra("AlAs")
    inside = (GRID > 390) & (GRID < 440)
    line = np.interp(GRID, [HOLE[0], HOLE[3]], [3.93, 3.703])
    np.testing.assert_allclose(eta[inside], line[inside], rtol=1e-6)
    assert k[GRID == 400][0] == pytest.approx(0.113, abs=1e-4)  # k is known there


def test_values_of_handbooks():
    # at the sodium line: rutile's extraordinary ray, diamond, periclase
    assert np.interp(589.3, GRID, conductor_spectra("TiO2")[0]) == pytest.approx(2.909, abs=5e-3)
    assert np.interp(589.3, GRID, conductor_spectra("d-C")[0]) == pytest.approx(2.417, abs=2e-3)
    assert np.interp(589.3, GRID, conductor_spectra("MgO")[0]) == pytest.approx(1.7374, abs=2e-3)


def test_shapes_and_signs():
    for name in CONDUCTORS:
        eta, k = conductor_spectra(name)
        assert eta.shape == k.shape == (471,) and eta.dtype == k.dtype == np.float64
        assert (eta > 0).all() and (k >= 0).all() and np.isfinite(eta).all() and np.isfinite(k).all()


@pytest.mark.parametrize("look_up", [conductor_spectra, conductor_range])
@pytest.mark.parametrize(("name", "hint"), [("TiO", "TiO2"), ("au", "Au"), ("gold", "known here"), ("none", "known")])
def test_unknown_names(look_up, name, hint):
    with pytest.raises(KeyError, match=f"unknown metal '{name}'.*{hint}"):
        look_up(name)


def test_a_change_of_what_is_returned_changes_nothing():
    conductor_spectra("Cu")[0][:] = 0
    assert conductor_spectra("Cu")[0].min() > 0
