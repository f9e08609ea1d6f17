"""Indices of refraction by wavelength, by the formulas that data sheets use; wavelengths in micrometres."""

from __future__ import annotations

import torch

from . import checks
from .observer import NANOMETRES

# The Fraunhofer lines d, F and C of data sheets, in nm.
YELLOW, BLUE, RED = 587.56, 486.13, 656.27


def cauchy(a: torch.Tensor | float, b: torch.Tensor | float) -> torch.Tensor:
    """Cauchy's formula n = A + B / wavelength^2; differentiable.

    Args:
        a: (...).
        b: (...) in square micrometres.

    Returns:
        (..., 471).

    Raises:
        TypeError: naming the argument, what was expected and what came.
    """
    a, b = checks.numbers("a", a), checks.numbers("b", b)
    return a[..., None] + b[..., None] / _squares(b)


def sellmeier(b: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """Sellmeier's formula n^2 = 1 + sum of B wavelength^2 / (wavelength^2 - C); differentiable.

    Args:
        b: (..., N), of three terms in data sheets of glass.
        c: (..., N) in square micrometres: squares of the wavelengths of resonances, outside of 360 to 830 nm.

    Returns:
        (..., 471).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    b, c = checks.numbers("b", b, 1), checks.numbers("c", c, 1)
    if b.shape[-1] != c.shape[-1]:
        raise ValueError(f"c: expected {b.shape[-1]} numbers, as many as b, got shape {tuple(c.shape)}")
    squares = _squares(c)
    outside = (c < squares[0]) | (c > squares[-1])
    checks.require(outside, "c", "squares of wavelengths outside of 0.36 to 0.83 micrometres", c)
    square = 1 + (b[..., None] * squares / (squares - c[..., None])).sum(-2)
    checks.require(square > 0, "b, c", "coefficients that make n^2 positive from 360 to 830 nm", square)
    return torch.sqrt(square)


def abbe(n_d: torch.Tensor | float, V_d: torch.Tensor | float) -> torch.Tensor:
    """The index, by Cauchy's formula, of what has the index n_d and Abbe's number V_d; differentiable.

    V_d = (n_d - 1) / (n_F - n_C) with the lines d 587.56, F 486.13 and C 656.27 nm.

    Args:
        n_d: (...), the index at 587.56 nm, above 1.
        V_d: (...), positive.

    Returns:
        (..., 471).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    index, number = checks.numbers("n_d", n_d), checks.numbers("V_d", V_d)
    checks.require((index > 1) & (index < torch.inf), "n_d", "an index above 1", index)
    checks.require(number > 0, "V_d", "a positive number", number)
    yellow, blue, red = (1e6 / line**2 for line in (YELLOW, BLUE, RED))
    b = (index - 1) / (number * (blue - red))
    return cauchy(index - b * yellow, b)


def abbe_number(table: torch.Tensor) -> torch.Tensor:
    """Abbe's number V_d (...) of indices by wavelength (..., 471); differentiable.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    checks.table("table", table)
    yellow, blue, red = (_at(table, line) for line in (YELLOW, BLUE, RED))
    return (yellow - 1) / (blue - red)


def _at(table: torch.Tensor, nanometres: float) -> torch.Tensor:
    above = nanometres - float(NANOMETRES[0])
    return torch.lerp(table[..., int(above)], table[..., int(above) + 1], above % 1)


def _squares(like: torch.Tensor) -> torch.Tensor:
    return torch.from_numpy((NANOMETRES / 1000) ** 2).to(like.device, like.dtype)
