"""Stokes images against those of Mitsuba 3.9.1 (`data/mitsuba_polarized.npz`, see bench/make_polarized_references.py).

z of the means over 8 x 8 pixels; noise floors of 2e-5 are added where both have none. The 64 of a scene are at most 5
(chance 4e-5 a scene if all were independent) and 1.6 in the mean of their squares; seeds are fixed. Of scenes with
wavelengths there are 192, and what is known to differ counts as an error, too: 1.5e-3 of the intensity, since Mitsuba's
spectra of colours are those of a table, and light given as a spectrum is 0.1 % brighter there.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from polarized_scenes import BLOCK, SCENES, SPECTRAL
from reference_parts import DATA

import torchrender as tr

pytestmark = pytest.mark.core
RUNS, SPP = 16, 128


def check(name: str, variant: str, describe, known: float) -> None:
    references = np.load(DATA / "mitsuba_polarized.npz")
    expected, error = (references[f"{name}.{what}"].reshape(4, 4, -1, 4) for what in ("mean", "error"))
    scene = tr.load_dict(describe(), variant=variant)
    with torch.no_grad():
        runs = [tr.render(scene, spp=SPP, seed=run, outputs=("stokes",)).stokes for run in range(RUNS)]
    found = torch.stack(runs).double().numpy()
    n = found.shape[1] // BLOCK
    found = found.reshape(RUNS, n, BLOCK, n, BLOCK, -1, 4).mean((2, 4))
    mean, variance = found.mean(0), found.var(0, ddof=1) / RUNS
    floor = 2e-5**2 + (known * expected[..., :1]) ** 2
    z = (mean - expected) / np.sqrt(variance + error**2 + floor)
    assert np.abs(z).max() < 5, (np.abs(z).max((0, 1)), mean.mean((0, 1)))
    assert (z**2).mean() < 1.6
    assert np.abs(expected[..., 1:]).max() > 1e-3


@pytest.mark.parametrize("name", SCENES)
def test_stokes_images(name):
    check(name, "mono", SCENES[name], 0.0)


@pytest.mark.parametrize("name", SPECTRAL)
def test_stokes_images_of_wavelengths(name):
    check(name, "spectral", SPECTRAL[name], 1.5e-3)
