"""Indices of refraction, as numbers and by the names of materials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from ..errors import describe, nearest
from . import values
from .context import SAMPLES, Context

# Indices of refraction at 589.29 nm, from the usual tables.
REFRACTIVE_INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.470,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "diamond": 2.419,
}


def refractive_index(value: Any, ctx: Context) -> torch.Tensor:
    """An index of refraction, in float64, given as a number or as the name of a material; keeps its gradient."""
    if is_index_spectrum(value):
        ctx.error(f"expected a number or the name of a material, got {describe(value)}; `dielectric` alone disperses")
    if isinstance(value, str):
        name = value.strip().lower().replace("_", " ")
        if name not in REFRACTIVE_INDICES:
            ctx.error(f"unknown material {value!r}; {nearest(name, REFRACTIVE_INDICES)}")
        value = REFRACTIVE_INDICES[name]
    index = values.double(value, ctx)
    if not 0 < float(index.detach()) < float("inf"):
        ctx.error(f"an index of refraction is positive, got {float(index.detach()):g}")
    return index


def is_index_spectrum(value: Any) -> bool:
    """Whether an index of refraction is given by wavelength, by a dict or a table (471,)."""
    return isinstance(value, Mapping) or getattr(value, "shape", None) == (SAMPLES,)
