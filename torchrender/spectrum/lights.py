"""Spectra of light: daylight, the CIE's incandescent lamp, and black bodies."""

from __future__ import annotations

import functools

import numpy as np
import torch

from . import checks, cie
from .observer import NANOMETRES, matching


def d65(like: torch.Tensor | None = None) -> torch.Tensor:
    """The table (471,) of daylight, CIE illuminant D65 (ISO/CIE 11664-2), with Y = 1.

    Args:
        like: a tensor whose dtype and device it has; None: float64.
    """
    return _like(_d65(), like)


def illuminant_a(like: torch.Tensor | None = None) -> torch.Tensor:
    """The table (471,) of an incandescent lamp, CIE standard illuminant A by its formula (ISO/CIE 11664-2), with Y = 1.

    Args:
        like: a tensor whose dtype and device it has; None: float64.
    """
    return _like(_illuminant_a(), like)


def blackbody(temperature: torch.Tensor | float) -> torch.Tensor:
    """The radiance of black bodies, W / (m^2 sr nm), by Planck's law; differentiable.

    Args:
        temperature: (...) in kelvin, positive.

    Returns:
        (..., 471).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    kelvin = checks.numbers("temperature", temperature)
    checks.require((kelvin > 0) & (kelvin < torch.inf), "temperature", "a positive temperature in kelvin", kelvin)
    metres = torch.from_numpy(NANOMETRES * 1e-9).to(kelvin.device)
    # below 60 K, where nothing is left to see, the exponent stays finite, and so does the derivative
    exponent = (cie.PLANCK * cie.LIGHT / (metres * cie.BOLTZMANN) / kelvin.double()[..., None]).clamp(max=600)
    return (2e-9 * cie.PLANCK * cie.LIGHT**2 / metres**5 / torch.expm1(exponent)).to(kelvin.dtype)


def _like(table: np.ndarray, like: torch.Tensor | None) -> torch.Tensor:
    result = torch.from_numpy(table)
    if like is None:
        return result.clone()
    return result.to(like.device, like.dtype if like.is_floating_point() else torch.float64, copy=True)


@functools.lru_cache(maxsize=1)
def _d65() -> np.ndarray:
    known = np.arange(cie.FIRST, cie.LAST + 1, cie.STEP)
    table = np.interp(NANOMETRES, known, cie.numbers(cie.D65))
    return table / (matching()[:, 1] @ table)


@functools.lru_cache(maxsize=1)
def _illuminant_a() -> np.ndarray:
    # its second radiation constant, 1.435e7 nm K, and temperature, 2848 K, are those of 1931 by definition
    table = NANOMETRES**-5.0 / np.expm1(1.435e7 / 2848 / NANOMETRES)
    return table / (matching()[:, 1] @ table)
