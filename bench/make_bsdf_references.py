"""Evaluate the BSDFs of `tests/helpers/bsdf_cases.py` with Mitsuba 3.9.1 into the files of `tests/data` that it names.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_bsdf_references.py [file ...]

Stored per case, in single precision: `NAME.eval` (n, 3), with the cosine; of delta lobes `NAME.delta` (2, n, 3), the
weights, times the probability with which each was chosen, of reflection and transmission, 0 where there is none.
"""

from __future__ import annotations

import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import bsdf_cases as cases  # noqa: E402


def surface(wi: np.ndarray) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.t, si.wi, si.n = 1.0, mi.Vector3f(wi.T), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.wavelengths = []
    return si


def evaluate(bsdf: mi.BSDF, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return np.array(bsdf.eval(mi.BSDFContext(), surface(wi), mi.Vector3f(wo.T))).T


def delta_lobes(bsdf: mi.BSDF, wi: np.ndarray) -> np.ndarray:
    found = []
    for kind in (mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.Null):
        context = mi.BSDFContext()
        context.type_mask = int(kind)
        sample, weight = bsdf.sample(context, surface(wi), mi.Float(0.5), mi.Point2f(0.5, 0.5))
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
            stored[f"{name}.eval"] = evaluate(mi.load_dict(description), wi, wo).astype(np.float32)
        for name, description in delta.items():
            stored[f"{name}.delta"] = delta_lobes(mi.load_dict(description), wi).astype(np.float32)
        np.savez_compressed(ROOT / "tests" / "data" / file, **stored)


if __name__ == "__main__":
    main()
