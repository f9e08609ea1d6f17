"""From colours to the spectra that they stand for."""

from __future__ import annotations

from typing import Any

import torch

from . import checks
from .coefficient_table import COARSE, FINE, lookup
from .sigmoids import nodes
from .solving import inverse, levenberg, reachable

_PART = 1024  # colours at a time


def rgb_to_coefficients(rgb: torch.Tensor) -> torch.Tensor:
    """Coefficients (..., 3) of the sigmoids that have linear sRGB colours (..., 3) in daylight; differentiable.

    To 1e-7 by Newton's method, with the derivative of the implicit function, in float64 whatever the dtype is. Colours
    are moved to between 5e-7 and 1 - 5e-7, and away from white by 3e-4, where spectra end; derivatives know nothing of
    that, but are 0 for channels outside of 0 to 1. Some 1 ms for a colour, 0.1 s for a thousand; see `upsample`.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    checks.row("rgb", rgb, 3, "red, green and blue")
    return _Solve.apply(rgb.clamp(0, 1))


def upsample(rgb: torch.Tensor, *, light: bool = False, exact: bool = True) -> torch.Tensor:
    """Colours as spectra: scale times `sigmoid`, in daylight; differentiable.

    Args:
        rgb: (..., 3), linear sRGB; negative channels are taken as 0.
        light: the scale is twice the largest channel, so that spectra keep their shape at any brightness; black is
            grey with the scale 0. Else it is 1, or the largest channel above that.
        exact: find each colour's coefficients as `rgb_to_coefficients` does. Else by a table of 64^3 for each largest
            channel, made in about a second when it is first used: some 10 ms for 1024 x 1024 texels; back again,
            colours are as they were to 1e-3, and the derivative, of which there is the first, is that of the table.

    Returns:
        (..., 4): three coefficients, and the scale.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    checks.row("rgb", rgb, 3, "red, green and blue")
    if not exact:
        return lookup(rgb, FINE, light)
    top = rgb.amax(-1, keepdim=True)
    if light:
        scale = 2 * top.clamp(min=0)
        lit = scale > 0
        factor = torch.where(lit, rgb / torch.where(lit, scale, 1.0), 0.5)
    else:
        scale = top.clamp(min=1)
        factor = rgb / scale
    return torch.cat([_Solve.apply(factor.clamp(0, 1)), scale], -1)


class _Solve(torch.autograd.Function):
    """The coefficients of colours, with the derivatives of the implicit function: inverse slopes of the colours."""

    @staticmethod
    def forward(rgb: torch.Tensor) -> torch.Tensor:
        wanted = reachable(rgb.detach().double().nan_to_num(0.5).cpu()).reshape(-1, 3)
        rule = nodes(1, torch.float64)
        found = [levenberg(lookup(part, COARSE)[:, :3], part, rule) for part in wanted.split(_PART)]
        result = torch.cat(found) if found else wanted
        return result.reshape(rgb.shape).to(rgb.device, rgb.dtype)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[torch.Tensor], output: torch.Tensor) -> None:
        ctx.save_for_backward(output)
        ctx.save_for_forward(output)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:
        return (grad.double()[..., None, :] @ _inverse_slopes(*ctx.saved_tensors))[..., 0, :].to(grad.dtype)

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor) -> torch.Tensor:
        return (_inverse_slopes(*ctx.saved_tensors) @ tangent.double()[..., None])[..., 0].to(tangent.dtype)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int], rgb: torch.Tensor) -> tuple[torch.Tensor, int]:
        return _Solve.apply(rgb.movedim(in_dims[0], 0)), 0


def _inverse_slopes(coefficients: torch.Tensor) -> torch.Tensor:
    rule = nodes(1, torch.float64)
    if coefficients.device.type != "cpu":
        rule = type(rule)(*(t.to(coefficients.device) for t in rule))
    return inverse(rule.colours(coefficients.double())[1])
