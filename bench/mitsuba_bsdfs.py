"""BSDFs that Mitsuba 3.9.1 evaluates and samples at given directions: what the scripts `make_*_references.py` share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"
sys.path.insert(0, str(ROOT / "tests" / "helpers"))  # where the scripts find their cases


def surface(wi: np.ndarray) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.t, si.wi, si.n = 1.0, mi.Vector3f(wi.T), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.wavelengths = []
    return si


def evaluated(bsdf: mi.BSDF, wi: np.ndarray, wo: np.ndarray) -> object:
    return bsdf.eval(mi.BSDFContext(), surface(wi), mi.Vector3f(wo.T))


def delta_samples(bsdf: mi.BSDF, wi: np.ndarray) -> Iterator[tuple[mi.BSDFFlags, mi.BSDFSample3f, object]]:
    """The lobe, the sample and its weight of reflection, then of what passes."""
    for kind in (mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.Null):
        context = mi.BSDFContext()
        context.type_mask = int(kind)
        yield kind, *bsdf.sample(context, surface(wi), mi.Float(0.5), mi.Point2f(0.5, 0.5))
