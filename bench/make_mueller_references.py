"""Mueller matrices of the BSDFs of `tests/helpers/mueller_cases.py` by Mitsuba 3.9.1, into `tests/data`.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_mueller_references.py

Stored per case, in single precision and in Mitsuba's implicit frames of both directions: `NAME` (lobes, n, 4, 4), with
the cosine; of delta lobes, reflection and transmission, the weight times the probability, 0 where there is none.
"""

from __future__ import annotations

import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import mueller_cases as cases  # noqa: E402


def surface(wi: np.ndarray) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.t, si.wi, si.n = 1.0, mi.Vector3f(wi.T), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    return si


def entries(matrix: object, n: int) -> np.ndarray:
    """(n, 4, 4) of a matrix of one colour."""
    return np.stack(
        [np.stack([np.broadcast_to(np.array(matrix[i, j]).ravel(), n) for j in range(4)], -1) for i in range(4)], 1
    )


def delta_lobes(bsdf: mi.BSDF, wi: np.ndarray) -> np.ndarray:
    found = []
    for kind in (mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.Null):
        context = mi.BSDFContext()
        context.type_mask = int(kind)
        sample, weight = bsdf.sample(context, surface(wi), mi.Float(0.5), mi.Point2f(0.5, 0.5))
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
            value = bsdf.eval(mi.BSDFContext(), surface(wi), mi.Vector3f(wo.T))
            stored[name] = entries(value, len(wi))[None].astype(np.float32)
        else:
            stored[name] = delta_lobes(bsdf, wi).astype(np.float32)
        print(name, abs(stored[name]).max((0, 1)).round(3).tolist(), flush=True)
    np.savez_compressed(ROOT / "tests" / "data" / "mueller_references.npz", **stored)


if __name__ == "__main__":
    main()
