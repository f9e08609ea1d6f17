"""Render the scenes of `tests/helpers/spectral_scenes.py` in Mitsuba 3.9.1's spectral mode.

They go into `tests/data/mitsuba_spectral.npz`. Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_spectral_references.py [scene ...]

Stored per scene: `NAME.mean` and `NAME.error`, means of the image over blocks (H, W, C) and their standard errors, from
independent runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from spectral_scenes import BANDS, BLOCK, SCENES  # noqa: E402

TARGET = ROOT / "tests" / "data" / "mitsuba_spectral.npz"
RUNS, SPP = 16, 4096


def to_mitsuba(value, key: str = ""):
    """The dictionary with NumPy arrays replaced by Mitsuba's types."""
    if isinstance(value, dict):
        value = {name: to_mitsuba(entry, name) for name, entry in value.items()}
        if value.get("type") in ("envmap", "bitmap"):
            # an image, not a tensor, which would not become spectra
            value["bitmap"] = mi.Bitmap(np.ascontiguousarray(value.pop("data")))
        return value
    return mi.ScalarTransform4f(value) if key == "to_world" else value


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over BLOCK x BLOCK pixels of (H, W, C)."""
    height, width, channels = image.shape
    return image.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, channels).mean((1, 3))


def main() -> None:
    mi.set_variant("llvm_ad_spectral")
    stored = dict(np.load(TARGET)) if TARGET.exists() else {}
    for name, (describe, _) in {**SCENES, **BANDS}.items():
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        scene = mi.load_dict(to_mitsuba(describe()))
        runs = [blocks(np.array(mi.render(scene, spp=SPP, seed=run + 1), np.float64)[..., :3]) for run in range(RUNS)]
        mean, error = np.mean(runs, 0), np.std(runs, 0, ddof=1) / RUNS**0.5
        stored[f"{name}.mean"], stored[f"{name}.error"] = mean.astype(np.float32), error.astype(np.float32)
        print(f"{name}: mean {mean.mean((0, 1))}, mean relative error {error.mean() / mean.mean():.2e}", flush=True)
        np.savez_compressed(TARGET, **stored)


if __name__ == "__main__":
    main()
