"""The wavelengths of paths, as renderings show them: how they are distributed, and what each counts.

A film of two bands, one flat and one that grows with the wavelength, shows by their ratio where a single wavelength is.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from spectral_objects import DOUBLE, camera, load

import torchrender as tr

pytestmark = pytest.mark.core
SIZE = 256  # pixels along a side, each with one sample: they are independent
NM = np.arange(471.0)  # above 360
FINE = np.linspace(0, 470, 40 * 470 + 1)
RADIANCE = 0.2 + 0.1 * np.sin(NM / 60) + 4 * np.exp(-(((NM - 186) / 5) ** 2))  # a lamp with a line
BANDS = {"flat": np.ones(471), "slope": 1 + NM / 470}


def spectrum(values: np.ndarray) -> dict:
    return {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": values.tolist()}


def image(bsdf: dict) -> np.ndarray:
    """(pixels, 2): both bands of a lamp behind a pane."""
    film = {"type": "specfilm", **{name: spectrum(band) for name, band in BANDS.items()}}
    objects = {
        "camera": camera(SIZE, 0.1, film=film),
        "pane": {"type": "rectangle", "bsdf": bsdf},
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 0, -1]),
            "emitter": {"type": "area", "radiance": spectrum(RADIANCE)},
        },
    }
    with torch.no_grad():
        return tr.render(load(objects), spp=1, seed=3).flatten(0, 1).numpy()


def daylight() -> np.ndarray:
    return tr.spectrum.d65(torch.zeros((), dtype=DOUBLE)).numpy()


def places(seen: np.ndarray) -> np.ndarray:
    """nm above 360 of single wavelengths that were seen."""
    slope, flat = (np.interp(FINE, NM, BANDS[name] * daylight()) for name in ("slope", "flat"))
    return np.interp(seen[:, 1] / seen[:, 0], slope / flat, FINE)


def density() -> np.ndarray:
    """On the nm, 1 / nm: half of it what the bands respond to, half of it what they see of the lamp; 2 % everywhere."""
    response = sum(band * daylight() / (band * daylight()).sum() for band in BANDS.values())
    lit = response * RADIANCE / daylight()
    shares = 0.02 / 471 + 0.98 * (response / response.sum() + lit / lit.sum()) / 2
    return shares / (shares.sum() - (shares[0] + shares[-1]) / 2)  # straight in between


def number(place: np.ndarray) -> np.ndarray:
    """The cumulative distribution."""
    fine = np.interp(FINE, NM, density())
    cumulative = np.concatenate([[0], np.cumsum((fine[1:] + fine[:-1]) / 2)]) / 40
    return np.interp(place, FINE, cumulative)


def assert_uniform(u: np.ndarray) -> None:
    points = torch.from_numpy(np.stack([u, np.full_like(u, 0.5)], 1))
    found = tr.testing.chi2_test(
        points, lambda p: torch.ones(len(p)).double(), domain="square", bins=(1, 96), significance=1e-4
    )
    assert found, found.message


def assert_weights(seen: np.ndarray, place: np.ndarray, factor: float) -> None:
    """The flat band has radiance over density; the core's is constant in 1536 equal shares of the wavelengths."""
    expected = factor * np.interp(place, NM, RADIANCE) / np.interp(place, NM, density())
    error = seen[:, 0] / expected - 1
    assert np.abs(error).max() < 0.05 and np.abs(error.mean()) < 1e-3, (np.abs(error).max(), error.mean())


def test_wavelengths_of_paths():
    """Three, a third of the distribution apart, and of those that a prism leaves but one; 1e-4 a test."""
    quarters = np.interp([0, 0.25, 0.5, 0.75, 1], number(FINE), FINE)
    places_of_pixels: list[list[float]] = [[] for _ in range(SIZE * SIZE)]
    for low, high in pairwise(quarters):
        # within a quarter there is at most one of the three, also with its margin
        window = ((low - 1 < NM) & (high + 1 > NM)).astype(float)
        seen = image({"type": "retarder", "transmittance": spectrum(window)})
        lit = seen[:, 0].nonzero()[0]
        place = places(seen[lit])
        inside = (low <= place) & (place < high)
        for pixel, at in zip(lit[inside].tolist(), place[inside].tolist(), strict=True):
            places_of_pixels[pixel].append(at)
        whole = window[np.floor(place).astype(int)] * window[np.ceil(place).astype(int)] > 0
        assert_weights(seen[lit[whole]], place[whole], 1 / 3)
    assert {len(found) for found in places_of_pixels} == {3}
    found = np.sort(places_of_pixels, 1)
    u = number(found)
    assert_uniform(3 * u[:, 0])
    assert np.abs(u - u[:, :1] - [0, 1 / 3, 2 / 3]).max() < 1e-3

    index = {"type": "irregular", "wavelengths": [360, 830], "values": [1.5, 1.4999]}
    seen = image({"type": "dielectric", "int_ior": index, "ext_ior": 1.0})
    lit = seen[:, 0].nonzero()[0]  # the others are reflected
    place = places(seen[lit])
    assert abs(len(lit) / len(seen) - 0.96) < 0.01
    assert_uniform(number(place))
    assert np.abs(found[lit] - place[:, None]).min(1).max() < 1e-6
    assert_weights(seen[lit], place, 1 / 1.5**2)
