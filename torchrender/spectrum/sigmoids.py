"""Smooth spectra between 0 and 1 by three numbers, and the colours that they have in daylight.

W. Jakob and J. Hanika, "A Low-Dimensional Function Space for Efficient Spectral Upsampling", 2019: the spectrum is
S(c0 x^2 + c1 x + c2) with S(q) = 1/2 + q / (2 sqrt(1 + q^2)) and x from 0 at 360 nm to 1 at 830 nm.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from . import checks
from .cached import made_once
from .lights import d65
from .observer import responses


def sigmoid(coefficients: torch.Tensor) -> torch.Tensor:
    """The tables (..., 471) of coefficients (..., 3), between 0 and 1.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    checks.row("coefficients", coefficients, 3, "those of x^2, x and 1")
    x = torch.linspace(0, 1, checks.SAMPLES, dtype=coefficients.dtype, device=coefficients.device)
    q = (coefficients[..., 0:1] * x + coefficients[..., 1:2]) * x + coefficients[..., 2:3]
    return 0.5 + q / (2 * torch.sqrt(1 + q * q))


class Nodes(NamedTuple):
    """Wavelengths at which sigmoids are summed up to their colour."""

    powers: torch.Tensor  # (3, N): x^2, x and 1
    weights: torch.Tensor  # (N, 3), of linear sRGB in daylight
    products: torch.Tensor  # (N, 9): weight j times power k at 3 j + k

    def colours(self, coefficients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The linear sRGB (..., 3) of sigmoids in daylight and its derivative (..., 3, 3) by their coefficients."""
        q = coefficients @ self.powers
        inverse = torch.rsqrt(1 + q * q)
        rgb = (q * inverse) @ self.weights * 0.5 + self.weights.sum(0) * 0.5
        slopes = (inverse * inverse * inverse) @ self.products * 0.5
        return rgb, slopes.unflatten(-1, (3, 3))


@made_once
def nodes(step: int, dtype: torch.dtype) -> Nodes:
    """Every `step`-th of the 471 wavelengths, a divisor of 470; sums are those of the cubics through neighbours."""
    weights = responses() * d65()[:, None]
    x = torch.arange(0, checks.SAMPLES, step, dtype=torch.float64)
    if step > 1:
        weights = _cubics(step).T @ weights
    x = x / (checks.SAMPLES - 1)
    powers = torch.stack([x * x, x, torch.ones_like(x)])
    products = (weights[:, :, None] * powers.T[:, None, :]).flatten(1)
    return Nodes(powers.to(dtype), weights.to(dtype), products.to(dtype))


def _cubics(step: int) -> torch.Tensor:
    """(471, N): Lagrange's cubics through the four nearest of N nodes, at all wavelengths."""
    at = torch.arange(checks.SAMPLES, dtype=torch.float64) / step
    count = (checks.SAMPLES - 1) // step + 1
    first = (at.floor().long() - 1).clamp(0, count - 4)
    t = at - first
    result = torch.zeros(checks.SAMPLES, count, dtype=torch.float64)
    for i in range(4):
        share = torch.ones_like(t)
        for j in range(4):
            if j != i:
                share = share * (t - j) / (i - j)
        result[torch.arange(checks.SAMPLES), first + i] = share
    return result
