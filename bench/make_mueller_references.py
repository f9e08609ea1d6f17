"""Mueller matrices of the BSDFs of `tests/helpers/mueller_cases.py` by Mitsuba 3.9.1, into `tests/data`.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_mueller_references.py

Stored per case, in single precision and in Mitsuba's implicit frames of both directions: `NAME` (lobes, n, 4, 4), with
the cosine; of delta lobes, reflection and transmission, the weight times the probability, 0 where there is none.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from mitsuba_bsdfs import DATA, delta_samples, evaluated

import mueller_cases as cases  # isort: skip


def entries(matrix: object, n: int) -> np.ndarray:
    """(n, 4, 4) of a matrix of one colour."""
    return np.stack(
        [np.stack([np.broadcast_to(np.array(matrix[i, j]).ravel(), n) for j in range(4)], -1) for i in range(4)], 1
    )


def delta_lobes(bsdf: mi.BSDF, wi: np.ndarray) -> np.ndarray:
    found = []
    for kind, sample, weight in delta_samples(bsdf, wi):
        pdf, z = (np.broadcast_to(np.array(x), len(wi)) for x in (sample.pdf, sample.wo.z))
        # (plates do not look at the mask)
        meant = (pdf > 0) & ((z * wi[:, 2] > 0) == (kind == mi.BSDFFlags.DeltaReflection))
        found.append(np.where(meant[:, None, None], entries(weight, len(wi)) * pdf[:, None, None], 0.0))
    return np.stack(found)


def main() -> None:
    mi.set_variant("llvm_ad_mono_polarized")
    stored = {}
    for name, description in {**cases.SMOOTH, **cases.DELTA, **cases.PERPENDICULAR}.items():
        wi, wo = cases.directions(name)
        bsdf = mi.load_dict(description)
        if name in cases.SMOOTH:
            stored[name] = entries(evaluated(bsdf, wi, wo), len(wi))[None].astype(np.float32)
        else:
            stored[name] = delta_lobes(bsdf, wi).astype(np.float32)
        print(name, abs(stored[name]).max((0, 1)).round(3).tolist(), flush=True)
    np.savez_compressed(DATA / "mueller_references.npz", **stored)


if __name__ == "__main__":
    main()
