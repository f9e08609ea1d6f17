"""Evaluate the BSDFs of `tests/helpers/bsdf_cases.py` with Mitsuba 3.9.1 into the files of `tests/data` that it names.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_bsdf_references.py [file ...]

Stored per case, in single precision: `NAME.eval` (n, 3), with the cosine; of delta lobes `NAME.delta` (2, n, 3), the
weights, times the probability with which each was chosen, of reflection and transmission, 0 where there is none.
"""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np
from mitsuba_bsdfs import DATA, delta_samples, evaluated

import bsdf_cases as cases  # isort: skip


def delta_lobes(bsdf: mi.BSDF, wi: np.ndarray) -> np.ndarray:
    found = []
    for _, sample, weight in delta_samples(bsdf, wi):
        value = np.array(weight * sample.pdf).T
        found.append(np.broadcast_to(np.where(np.array(sample.pdf)[:, None] > 0, value, 0.0), (len(wi), 3)))
    return np.stack(found)


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    wi, wo = cases.directions()
    for file, (smooth, delta) in cases.FILES.items():
        if sys.argv[1:] and file not in sys.argv[1:]:
            continue
        stored = {}
        for name, description in smooth.items():
            stored[f"{name}.eval"] = np.array(evaluated(mi.load_dict(description), wi, wo)).T.astype(np.float32)
        for name, description in delta.items():
            stored[f"{name}.delta"] = delta_lobes(mi.load_dict(description), wi).astype(np.float32)
        np.savez_compressed(DATA / file, **stored)


if __name__ == "__main__":
    main()
