"""Render the scenes of `tests/helpers/polarized_scenes.py` with Mitsuba 3.9.1's integrator `stokes`.

They go into `tests/data/mitsuba_polarized.npz`. Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_polarized_references.py [scene ...]

Stored per scene: `NAME.mean` and `NAME.error`, means of the Stokes vectors over blocks (H, W, 4) and their standard
errors, from independent runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from polarized_scenes import BLOCK, SCENES  # noqa: E402

TARGET = ROOT / "tests" / "data" / "mitsuba_polarized.npz"
RUNS, SPP = 16, 2048
STOKES = [1, 4, 7, 10]  # of a film with one colour, shown as three: Y, then S0, S1, S2 and S3


def to_mitsuba(value, key: str = ""):
    if isinstance(value, dict):
        return {name: to_mitsuba(entry, name) for name, entry in value.items()}
    return mi.ScalarTransform4f(value) if key == "to_world" else value


def main() -> None:
    mi.set_variant("llvm_ad_mono_polarized")
    stored = dict(np.load(TARGET)) if TARGET.exists() else {}
    for name, describe in SCENES.items():
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        description = to_mitsuba(describe())
        description["integrator"] = {"type": "stokes", "nested": description["integrator"]}
        scene = mi.load_dict(description)
        runs = [np.array(mi.render(scene, spp=SPP, seed=run + 1), np.float64)[..., STOKES] for run in range(RUNS)]
        n = runs[0].shape[0] // BLOCK
        means = np.array(runs).reshape(RUNS, n, BLOCK, n, BLOCK, 4).mean((2, 4))
        stored[f"{name}.mean"] = means.mean(0).astype(np.float32)
        stored[f"{name}.error"] = (means.std(0, ddof=1) / RUNS**0.5).astype(np.float32)
        print(name, means.mean((0, 1, 2)), flush=True)
    np.savez_compressed(TARGET, **stored)


if __name__ == "__main__":
    main()
