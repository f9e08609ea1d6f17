"""The sigmoids that have given colours, by Newton's method."""

from __future__ import annotations

import torch

from .sigmoids import Nodes

# Colours are moved into these limits, at which coefficients stay below a thousand: no channel is nearer to 0 or 1, and
# no colour nearer to white, of which spectra below 1 fall short by 1e-4.
DARKEST, WHITEST = 5e-7, 5e-4


def reachable(rgb: torch.Tensor) -> torch.Tensor:
    """Colours (..., 3) from 0 to 1 within the limits above."""
    excess = (rgb.amin(-1, keepdim=True) - (1 - WHITEST)).clamp(min=0)
    return (rgb - excess).clamp(DARKEST, 1 - DARKEST)


def newton(coefficients: torch.Tensor, rgb: torch.Tensor, nodes: Nodes, steps: int) -> torch.Tensor:
    """A fixed number of steps from coefficients (N, 3) near to those of colours (N, 3), limited in their length."""
    for _ in range(steps):
        found, slopes = nodes.colours(coefficients)
        missing, (first, second, third) = found - rgb, slopes.unbind(-2)
        # by cross products, which are much faster than a solver for many systems of three
        a, b, c = (torch.linalg.cross(*pair) for pair in ((second, third), (third, first), (first, second)))
        det = (first * a).sum(-1, keepdim=True)
        size = sum((row * row).sum(-1, keepdim=True) for row in (first, second, third)) ** 1.5
        det = det + torch.where(det < 0, -1e-7, 1e-7) * size
        step = (a * missing[:, :1] + b * missing[:, 1:2] + c * missing[:, 2:]) / det
        coefficients = coefficients - _limited(step, coefficients, 0.3)
    return coefficients


def levenberg(
    coefficients: torch.Tensor, rgb: torch.Tensor, nodes: Nodes, steps: int = 60, tolerance: float = 1e-9
) -> torch.Tensor:
    """Damped steps (Levenberg and Marquardt) until colours (N, 3) are met, or come no nearer; N small, float64."""
    found, slopes = nodes.colours(coefficients)
    error = (found - rgb).square().sum(-1)
    damping = torch.full_like(error, 1e-12)
    for _ in range(steps):
        if not bool(((error > tolerance**2) & (damping < 1e2)).any()):
            break
        step = (slopes.mT @ torch.linalg.solve(_gram(slopes, damping), (found - rgb)[..., None]))[..., 0]
        tried = coefficients - _limited(step, coefficients, 0.5)
        tried_rgb, tried_slopes = nodes.colours(tried)
        tried_error = (tried_rgb - rgb).square().sum(-1)
        better = (tried_error < error) & (error > tolerance**2)
        coefficients = torch.where(better[:, None], tried, coefficients)
        found = torch.where(better[:, None], tried_rgb, found)
        slopes = torch.where(better[:, None, None], tried_slopes, slopes)
        error = torch.where(better, tried_error, error)
        damping = torch.where(better, damping / 10, damping * 10).clamp(1e-14, 1e4)
    return coefficients


def inverse(slopes: torch.Tensor) -> torch.Tensor:
    """The inverses (..., 3, 3) of slopes of colours, damped where these are nearly singular, as at white."""
    damping = torch.full_like(slopes[..., 0, 0], 1e-13)
    return slopes.mT @ torch.linalg.inv(_gram(slopes, damping))


def _gram(slopes: torch.Tensor, damping: torch.Tensor) -> torch.Tensor:
    gram = slopes @ slopes.mT
    size = gram.diagonal(dim1=-2, dim2=-1).sum(-1) * damping
    return gram + size[..., None, None] * torch.eye(3, dtype=slopes.dtype, device=slopes.device)


def _limited(step: torch.Tensor, coefficients: torch.Tensor, share: float) -> torch.Tensor:
    limit = 2 + share * coefficients.abs().amax(-1, keepdim=True)
    return step * (limit / step.abs().amax(-1, keepdim=True).clamp(min=1e-30)).clamp(max=1)
