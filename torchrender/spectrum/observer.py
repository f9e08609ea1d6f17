"""What the standard observer sees of spectra: the weights of red, green and blue, and colours by them."""

from __future__ import annotations

import functools

import numpy as np
import torch

from . import checks, cie

NANOMETRES = np.arange(cie.FIRST, cie.LAST + 1)


def wavelengths(dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """The wavelengths (471,) of all tables, 360 to 830 nm, in nanometres."""
    return torch.from_numpy(NANOMETRES).to(dtype, copy=True)


def responses(dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Weights (471, 3) whose sums with a table of light are its linear sRGB; D65 and a table of ones have Y = 1.

    CIE 1931 2-degree observer, sRGB of IEC 61966-2-1. The sum is a trapezoid's: it is exact for tables that are linear
    in between, but for products with the steps of 5 nm of the observer's tables.
    """
    return torch.from_numpy(_responses()).to(dtype, copy=True)


def to_rgb(table: torch.Tensor, illuminant: torch.Tensor | None = None) -> torch.Tensor:
    """The linear sRGB (..., 3) of tables (..., 471), differentiable; negative where a colour is out of the gamut.

    Args:
        table: light, or with an `illuminant` a factor such as a reflectance.
        illuminant: (..., 471), the light that a factor is seen in, such as `d65()`, in which ones are white:
            (1.0001, 1.0000, 0.9999). Without one, ones as light are (1.2049, 0.9482, 0.9092).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    checks.table("table", table)
    weights = torch.from_numpy(_responses()).to(table.device, table.dtype)
    if illuminant is not None:
        table = table * checks.table("illuminant", illuminant)
    return table @ weights


@functools.lru_cache(maxsize=1)
def matching() -> np.ndarray:
    """X, Y and Z (471, 3) of each nanometre's light: the colour-matching functions, with Y = 1 for ones."""
    known = np.arange(cie.FIRST, cie.LAST + 1, cie.STEP)
    weights = np.stack([np.interp(NANOMETRES, known, cie.numbers(t)) for t in (cie.X, cie.Y, cie.Z)], axis=1)
    weights[[0, -1]] /= 2  # trapezoids
    return weights / weights[:, 1].sum()


@functools.lru_cache(maxsize=1)
def _responses() -> np.ndarray:
    return matching() @ cie.XYZ_TO_RGB.T
