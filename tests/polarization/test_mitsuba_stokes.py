"""Stokes images against those of Mitsuba 3.9.1 (`data/mitsuba_polarized.npz`, see bench/make_polarized_references.py).

z of the means over 8 x 8 pixels; noise floors of 2e-5 are added where both have none. The 64 of a scene are at most 5
(chance 4e-5 a scene if all were independent) and 1.6 in the mean of their squares; seeds are fixed.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from polarized_scenes import BLOCK, SCENES
from reference_parts import DATA

import torchrender as tr

pytestmark = pytest.mark.core
RUNS, SPP = 16, 128


@pytest.mark.parametrize("name", SCENES)
def test_stokes_images(name):
    references = np.load(DATA / "mitsuba_polarized.npz")
    scene = tr.load_dict(SCENES[name](), variant="mono")
    with torch.no_grad():
        runs = [tr.render(scene, spp=SPP, seed=run, outputs=("stokes",)).stokes[..., 0, :] for run in range(RUNS)]
    found = torch.stack(runs).double().numpy()
    n = found.shape[1] // BLOCK
    found = found.reshape(RUNS, n, BLOCK, n, BLOCK, 4).mean((2, 4))
    mean, variance = found.mean(0), found.var(0, ddof=1) / RUNS
    error = np.sqrt(variance + references[f"{name}.error"] ** 2 + 2e-5**2)
    z = (mean - references[f"{name}.mean"]) / error
    assert np.abs(z).max() < 5, (np.abs(z).max((0, 1)), mean.mean((0, 1)))
    assert (z**2).mean() < 1.6
    assert np.abs(references[f"{name}.mean"][..., 1:]).max() > 1e-3
