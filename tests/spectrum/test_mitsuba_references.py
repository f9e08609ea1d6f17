"""Images of the spectral variant against those of Mitsuba 3.9.1's spectral mode.

`data/mitsuba_spectral.npz` has means over 8 x 8 pixels of `spectral_scenes` and their standard errors.

What may differ: Mitsuba turns rgb into spectra by a table of 64 x 64 x 64 colours, whose spectra have colours that
deviate by up to 6e-4 (of 1000 random ones; 2e-4 half of them), where ours are exact. TABLE allows for that, of the
largest channel of a block, where light, a reflectance or two are from there.

The statistic of each mean is z = (|ours - theirs| - TABLE) / sqrt(our variance + their variance), where our variance
comes from independent runs; beyond TABLE it is Student distributed with at least RUNS - 1 degrees of freedom. The 48 of
a scene pass by chance but for a probability of less than 1e-3 (largest z) and 1e-4 (mean of its square, even if the
three channels were one), and seeds are fixed. The channels' means over the image, whose noise is 5e-4 at most,
agree to 1.5e-3.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch
from reference_checks import blocks
from reference_parts import DATA
from spectral_scenes import BANDS, BLOCK, SCENES

import torchrender as tr
from torchrender import spectrum
from torchrender.scene.registry import ADVICE

pytestmark = pytest.mark.core
RUNS, SPP = 24, 256
GRID = np.arange(360.0, 831.0)  # nm
TABLE, MAX_Z, MAX_MEAN_SQUARE, MAX_DEVIATION = 1e-3, 5.5, 3.0, 1.5e-3


@pytest.fixture(scope="module")
def references() -> dict[str, np.ndarray]:
    with np.load(DATA / "mitsuba_spectral.npz") as file:
        return {name: content.astype(np.float64) for name, content in file.items()}


def rendered(description: dict, variant="spectral") -> np.ndarray:
    """Block means (RUNS, H, W, C) of independent runs."""
    scene = tr.load_dict(description, variant=variant)
    with torch.no_grad():
        return np.stack([blocks(tr.render(scene, spp=SPP, seed=run), BLOCK) for run in range(RUNS)])


@functools.cache
def as_described(name: str) -> np.ndarray:
    return rendered(SCENES[name][0]())


def check(runs: np.ndarray, mean: np.ndarray, error: np.ndarray) -> None:
    ours = runs.mean(0)
    beyond = (np.abs(ours - mean) - TABLE * mean.max(-1, keepdims=True)).clip(0)
    z = beyond / np.sqrt(runs.var(0, ddof=1) / RUNS + error**2)
    worst = np.unravel_index(z.argmax(), z.shape)
    deviation = ours.mean((0, 1)) / mean.mean((0, 1)) - 1
    assert np.abs(deviation).max() < MAX_DEVIATION, f"means of the channels deviate by {deviation}"
    assert z.max() < MAX_Z, f"block {worst}: ours {ours[worst]:.6g}, theirs {mean[worst]:.6g}, z {z[worst]:.1f}"
    assert (z**2).mean() < MAX_MEAN_SQUARE, f"mean z² {(z**2).mean():.2f}"


@pytest.mark.parametrize("name", SCENES)
def test_image(name, references):
    brightness = SCENES[name][1]
    check(as_described(name), references[f"{name}.mean"] / brightness, references[f"{name}.error"])


@pytest.mark.skipif("specfilm" in ADVICE, reason="specfilm is not read yet")
@pytest.mark.parametrize("name", BANDS)
def test_bands(name, references):
    describe, brightness = BANDS[name]
    check(rendered(describe()), references[f"{name}.mean"] / brightness, references[f"{name}.error"])


def test_bands_of_the_sky(references):
    """The top left block sees the sky alone: the integral of its light times each band."""
    describe, brightness = BANDS["bands"]
    description = describe()
    light = description["sky"]["radiance"]
    sigmoid = spectrum.upsample(torch.tensor(light["color"]["value"], dtype=torch.float64), light=True)
    seen = light["scale"] * spectrum.d65(sigmoid) * sigmoid[3] * spectrum.sigmoid(sigmoid[:3])
    bands = []
    for content in description["sensor"]["film"].values():
        if isinstance(content, dict) and "values" in content:
            values = np.array(content["values"].split(), float)
            given = content.get("wavelengths")
            ends = content.get("wavelength_min"), content.get("wavelength_max")
            wavelengths = np.array(given.split(), float) if given else np.linspace(*ends, len(values))
            response = torch.from_numpy(np.interp(GRID, wavelengths, values, left=0, right=0))
            bands.append(float(torch.trapezoid(seen * response)))
    assert bands == pytest.approx(references["bands.mean"][0, 0] / brightness, rel=TABLE)


@pytest.mark.parametrize("change", ["brighter", "upside down", "copper for gold", "in rgb"])
def test_the_test_notices_small_errors(change, references):
    mean, error = references["metals.mean"] / SCENES["metals"][1], references["metals.error"]
    description = SCENES["metals"][0]()
    if change == "copper for gold":
        description["gold"]["bsdf"]["material"] = "Cu"
        runs = rendered(description)
    else:
        runs = rendered(description, "rgb") if change == "in rgb" else as_described("metals")
    changed = {"brighter": 1.003 * runs, "upside down": runs[:, ::-1]}.get(change, runs)
    with pytest.raises(AssertionError):
        check(changed, mean, error)
