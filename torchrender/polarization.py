"""Polarised light: functions of Stokes vectors, which `render(..., outputs=("stokes",))` has as its last axis.

A Stokes vector (I, Q, U, V) is as the camera sees the light: Q is what is polarised horizontally less what is so
vertically, U at 45 less at 135 degrees, counter-clockwise from the horizontal, V circularly to the right less to the
left. All of this is plain PyTorch: differentiable, batched, of any dtype.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from .errors import describe


def dolp(stokes: torch.Tensor) -> torch.Tensor:
    """Degree of linear polarisation sqrt(Q^2 + U^2) / I, 0 where there is no light.

    Args:
        stokes: (..., 4).

    Returns:
        (...), from 0 to 1; its derivative is 0 where Q = U = 0.
    """
    _check(stokes)
    return _share(_norm(stokes[..., 1:3]), stokes[..., 0])


def docp(stokes: torch.Tensor) -> torch.Tensor:
    """Degree of circular polarisation V / I of `stokes` (..., 4), from -1 to 1; 0 where there is no light."""
    _check(stokes)
    return _share(stokes[..., 3], stokes[..., 0])


def aolp(stokes: torch.Tensor) -> torch.Tensor:
    """Angle of linear polarisation atan2(U, Q) / 2 of `stokes` (..., 4), in radians from 0 to pi, modulo pi.

    0 where nothing is polarised; there is no derivative there, which counts as 0.
    """
    _check(stokes)
    q, u = stokes[..., 1], stokes[..., 2]
    some = (q != 0) | (u != 0)
    angle = torch.atan2(torch.where(some, u, 0.0), torch.where(some, q, 1.0)) / 2
    return torch.where(angle < 0, angle + math.pi, angle)


def analyser(stokes: torch.Tensor, angle: float | torch.Tensor, retardance: float | torch.Tensor = 0.0) -> torch.Tensor:
    """The intensity behind a linear polariser, and a retarder in front of it, in front of the camera.

    A Stokes image is all that is needed: what an analyser lets through is linear in it.

    Args:
        stokes: (..., 4).
        angle: of the polariser, in radians counter-clockwise from the horizontal; a number or a tensor that broadcasts
            with (...).
        retardance: of a retarder whose fast axis is horizontal, in radians.

    Returns:
        (...).
    """
    _check(stokes)
    at, delay = (torch.as_tensor(x, dtype=stokes.dtype) for x in (angle, retardance))
    i, q, u, v = stokes.unbind(-1)
    turned = u * torch.cos(delay) + v * torch.sin(delay)
    return (i + q * torch.cos(2 * at) + turned * torch.sin(2 * at)) / 2


def channel_names(colours: Sequence[str] = ("R", "G", "B")) -> list[str]:
    """Names of the channels that an EXR file has of Stokes vectors: ``"S0.R"``, ``"S1.R"``, ..., ``"S3.B"``.

    Args:
        colours: those of an image (H, W, C, 4): R, G, B; Y of one channel; or names of a film's bands
            (`Film.channels`).

    Returns:
        4 C names, in the order of the image's last two axes, so that ``read_image(path, channels=names)`` is the image
        that `write_image` wrote, ``.unflatten(-1, (C, 4))``.
    """
    return [f"S{i}.{colour}" for colour in colours for i in range(4)]


# ------------------------------------------------------------------------------------------------- Mueller matrices
def rotation(angle: float | torch.Tensor) -> torch.Tensor:
    """(..., 4, 4): Stokes vectors on an axis that is turned counter-clockwise by `angle` (...), in radians."""
    angle = torch.as_tensor(angle)
    c, s, zero, one = torch.cos(2 * angle), torch.sin(2 * angle), torch.zeros_like(angle), torch.ones_like(angle)
    return _matrix([[one, zero, zero, zero], [zero, c, s, zero], [zero, -s, c, zero], [zero, zero, zero, one]])


def linear_polariser(angle: float | torch.Tensor = 0.0) -> torch.Tensor:
    """(..., 4, 4) of an ideal linear polariser at `angle` (...), in radians counter-clockwise from the horizontal."""
    angle = torch.as_tensor(angle)
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    plain = _matrix([[one, one, zero, zero], [one, one, zero, zero], [zero] * 4, [zero] * 4]) / 2
    return _turned(plain, angle)


def retarder(retardance: float | torch.Tensor, angle: float | torch.Tensor = 0.0) -> torch.Tensor:
    """(..., 4, 4) of a linear retarder, a quarter-wave plate with pi / 2: `angle` is that of its fast axis.

    Light at +45 degrees becomes circular to the left (V = -1) behind a horizontal quarter-wave plate.
    """
    delay = torch.as_tensor(retardance)
    delay, at = torch.broadcast_tensors(delay, torch.as_tensor(angle, dtype=delay.dtype))
    c, s = torch.cos(delay), torch.sin(delay)
    zero, one = torch.zeros_like(c), torch.ones_like(c)
    plain = _matrix([[one, zero, zero, zero], [zero, one, zero, zero], [zero, zero, c, s], [zero, zero, -s, c]])
    return _turned(plain, at)


def false_color(stokes: torch.Tensor, component: int = 1) -> torch.Tensor:
    """A picture (..., 3) of Q, U or V over I: green where it is positive, red where it is negative.

    Args:
        stokes: (..., 4), or of colours (..., C, 4), whose mean is shown where C is 1 or 3 and there is one more axis.
        component: 1, 2 or 3.
    """
    _check(stokes)
    if component not in (1, 2, 3):
        raise ValueError(f"false_color: component: expected 1, 2 or 3, got {component!r}")
    if stokes.ndim >= 4:
        stokes = stokes.mean(-2)
    share = _share(stokes[..., component], stokes[..., 0]).clamp(-1, 1)
    return torch.stack([(-share).clamp(min=0), share.clamp(min=0), torch.zeros_like(share)], -1)


# ------------------------------------------------------------------------------------------------------------ parts
def _check(stokes: torch.Tensor) -> None:
    if (
        not isinstance(stokes, torch.Tensor)
        or stokes.ndim < 1
        or stokes.shape[-1] != 4
        or not stokes.is_floating_point()
    ):
        raise ValueError(f"stokes: expected a tensor of floating-point numbers (..., 4), got {describe(stokes)}")


def _share(part: torch.Tensor, whole: torch.Tensor) -> torch.Tensor:
    some = whole > 0
    return torch.where(some, part / torch.where(some, whole, 1.0), 0.0)


def _norm(vector: torch.Tensor) -> torch.Tensor:
    squared = (vector * vector).sum(-1)
    some = squared > 0
    return torch.where(some, torch.where(some, squared, 1.0).sqrt(), 0.0)


def _matrix(rows: list[list[torch.Tensor]]) -> torch.Tensor:
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _turned(matrix: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    return rotation(-angle) @ matrix @ rotation(angle)
