"""Render the scenes of `tests/helpers/polarized_scenes.py` with Mitsuba 3.9.1's integrator `stokes`.

They go into `tests/data/mitsuba_polarized.npz`. Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_polarized_references.py [scene ...]

Stored per scene: `NAME.mean` and `NAME.error`, means of the Stokes vectors over blocks, (H, W, 4), or (H, W, 3, 4) of
those with wavelengths, and their standard errors, from independent runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from polarized_scenes import BLOCK, SCENES, SPECTRAL  # noqa: E402

TARGET = ROOT / "tests" / "data" / "mitsuba_polarized.npz"
RUNS, SPP = 16, 2048
VARIANTS = {"llvm_ad_mono_polarized": SCENES, "llvm_ad_spectral_polarized": SPECTRAL}


def to_mitsuba(value, key: str = ""):
    if isinstance(value, dict):
        return {name: to_mitsuba(entry, name) for name, entry in value.items()}
    return mi.ScalarTransform4f(value) if key == "to_world" else value


def stokes(image: np.ndarray) -> np.ndarray:
    """Of an image's last channels, S0 to S3 in three colours each: means over blocks, (H, W, 3, 4)."""
    n = image.shape[0] // BLOCK
    blocks = image[..., -12:].reshape(n, BLOCK, n, BLOCK, 4, 3).mean((1, 3))
    return blocks.swapaxes(-1, -2)


def main() -> None:
    stored = dict(np.load(TARGET)) if TARGET.exists() else {}
    for variant, scenes in VARIANTS.items():
        mi.set_variant(variant)
        for name, describe in scenes.items():
            if sys.argv[1:] and name not in sys.argv[1:]:
                continue
            description = to_mitsuba(describe())
            description["integrator"] = {"type": "stokes", "nested": description["integrator"]}
            scene = mi.load_dict(description)
            runs = [stokes(np.array(mi.render(scene, spp=SPP, seed=run + 1), np.float64)) for run in range(RUNS)]
            means = np.array(runs)[..., 0, :] if scenes is SCENES else np.array(runs)
            stored[f"{name}.mean"] = means.mean(0).astype(np.float32)
            stored[f"{name}.error"] = (means.std(0, ddof=1) / RUNS**0.5).astype(np.float32)
            print(name, means.mean((0, 1, 2)), flush=True)
    np.savez_compressed(TARGET, **stored)


if __name__ == "__main__":
    main()
