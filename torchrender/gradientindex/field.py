"""The field of a gradient index: squared indices as a tensor product of B-splines over a grid, in plain PyTorch.

Control values n_i of voxels (Z, Y, X) give n^2 = sum n_i^2 B_i(q), q in voxels, the splines B_i being centred in the
voxels; beyond the border they go on as they end. The squares are what is linear in the splines, since rays follow the
gradient of n^2 / 2. n therefore lies between the least and the largest control value.
"""

from __future__ import annotations

import torch

from ..errors import describe
from ..optim.resample import resample

INTERPOLATIONS = ("cubic", "quadratic")


def evaluate(
    index: torch.Tensor, points: torch.Tensor, interpolation: str = "cubic"
) -> tuple[torch.Tensor, torch.Tensor]:
    """The index of refraction and its gradient at points, by operations that autograd differentiates again.

    Args:
        index: control values (Z, Y, X), positive.
        points: (..., 3), x, y, z in the unit cube that the grid fills; voxel (k, j, i) is centred at
            ((i + 0.5) / X, (j + 0.5) / Y, (k + 0.5) / Z). Points outside of it are as good as the nearest one inside,
            but for half a voxel at the border.
        interpolation: ``"cubic"`` or ``"quadratic"``.

    Returns:
        n (...) and its gradient (..., 3) by the coordinates of the cube. They take 64 (quadratic: 27) numbers a point.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    _check(index, interpolation)
    if not isinstance(points, torch.Tensor) or points.ndim < 1 or points.shape[-1] != 3:
        raise ValueError(f"points: expected a tensor of shape (..., 3), got {describe(points)}")
    square, slope = spline(index * index, points, interpolation)
    n = torch.sqrt(square)
    return n, slope / (2 * n[..., None])


def fit(samples: torch.Tensor, interpolation: str = "cubic") -> torch.Tensor:
    """Control values of the field that has the index `samples` in the centres of its voxels, differentiable.

    Args:
        samples: (Z, Y, X), positive.
        interpolation: ``"cubic"`` or ``"quadratic"``.

    Returns:
        (Z, Y, X).

    Raises:
        TypeError, ValueError: as `evaluate`; where `samples` are so rough that no real control values give them.
    """
    _check(samples, interpolation, "samples")
    values = samples * samples
    side, middle = (1 / 6, 2 / 3) if interpolation == "cubic" else (1 / 8, 3 / 4)
    for axis in range(3):
        n = values.shape[axis]
        matrix = torch.zeros(n, n, dtype=values.dtype, device=values.device)
        matrix.diagonal().fill_(middle)
        if n > 1:
            matrix.diagonal(1).fill_(side)
            matrix.diagonal(-1).fill_(side)
        matrix[0, 0] += side  # beyond the border they go on as they end
        matrix[-1, -1] += side
        moved = values.movedim(axis, 0)
        values = torch.linalg.solve(matrix, moved.reshape(n, -1)).reshape(moved.shape).movedim(0, axis)
    if not bool((values.detach() > 0).all()):
        raise ValueError("samples: they change so fast from voxel to voxel that no field of positive indices has them")
    return torch.sqrt(values).contiguous()


def refine(index: torch.Tensor, interpolation: str = "cubic") -> torch.Tensor:
    """Control values of a grid of twice as many voxels a side, differentiable.

    Quadratic fields stay the same (Chaikin's subdivision). Cubic ones, which have no finer grid of this kind, keep
    their values in the centres of the new voxels; `tr.optim.upsample` is for optimisers with a state, and near to it.

    Args:
        index: (Z, Y, X), positive.
        interpolation: ``"cubic"`` or ``"quadratic"``.

    Returns:
        (2 Z, 2 Y, 2 X).
    """
    _check(index, interpolation)
    size = [2 * n for n in index.shape]
    if interpolation == "quadratic":
        return torch.sqrt(resample(index * index, size, "clamp"))  # linear at quarters: Chaikin's weights
    square = index * index
    for axis in range(3):
        n = index.shape[axis]
        at = (torch.arange(2 * n, dtype=index.dtype, device=index.device) + 0.5) / (2 * n)
        taps, weights, _ = axis_weights(at, n, interpolation)
        rows = square.index_select(axis, taps.reshape(-1)).unflatten(axis, taps.shape)
        shape = [1] * rows.ndim
        shape[axis], shape[axis + 1] = weights.shape
        square = (rows * weights.reshape(shape)).sum(axis + 1)
    return fit(torch.sqrt(square), interpolation)


def spline(values: torch.Tensor, points: torch.Tensor, interpolation: str) -> tuple[torch.Tensor, torch.Tensor]:
    """A spline with control values (Z, Y, X) at points (..., 3) of the cube: its value, and its gradient."""
    axes = [axis_weights(points[..., k], values.shape[2 - k], interpolation) for k in range(3)]
    (ix, wx, dx), (iy, wy, dy), (iz, wz, dz) = axes
    rows, columns = values.shape[1:]
    at = (iz[..., :, None, None] * rows + iy[..., None, :, None]) * columns + ix[..., None, None, :]
    # (PyTorch adds up the derivative of values[iz, iy, ix] in an order that differs from call to call)
    taps = values.reshape(-1).index_select(0, at.reshape(-1)).view(at.shape)
    along_x, slope_x = (taps * wx[..., None, None, :]).sum(-1), (taps * dx[..., None, None, :]).sum(-1)
    along_y = (along_x * wy[..., None, :]).sum(-1)
    slope = [((slope_x * wy[..., None, :]).sum(-1) * wz).sum(-1), ((along_x * dy[..., None, :]).sum(-1) * wz).sum(-1)]
    return (along_y * wz).sum(-1), torch.stack([*slope, (along_y * dz).sum(-1)], -1)


def axis_weights(x: torch.Tensor, n: int, interpolation: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Of points x in [0, 1] on an axis of n voxels: which ones count, with which weights, and their slopes by x."""
    q = (x * n).clamp(-0.5, n + 0.5)
    if interpolation == "quadratic":
        cell = q.detach().floor()
        f, t = q - cell, q - cell - 0.5
        w = [(1 - f) ** 2 / 2, 0.75 - t * t, f * f / 2]
        d = [f - 1, -2 * t, f]
    else:
        cell = (q.detach() - 0.5).floor()
        f = q - 0.5 - cell
        g = 1 - f
        w = [g**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - g * g * (1 - g / 2), f**3 / 6]
        d = [-g * g / 2, f * (1.5 * f - 2), g * (2 - 1.5 * g), f * f / 2]
    taps = torch.stack([cell.long() + k - 1 for k in range(len(w))], -1).clamp(0, n - 1)
    return taps, torch.stack(w, -1), torch.stack(d, -1) * n


def _check(index: torch.Tensor, interpolation: str, name: str = "index") -> None:
    if interpolation not in INTERPOLATIONS:
        raise ValueError(f"interpolation: expected one of {INTERPOLATIONS}, got {interpolation!r}")
    if not isinstance(index, torch.Tensor) or not index.is_floating_point():
        raise TypeError(f"{name}: expected a floating-point tensor of shape (Z, Y, X), got {describe(index)}")
    if index.ndim != 3 or 0 in index.shape:
        raise ValueError(f"{name}: expected shape (Z, Y, X), none of them 0, got {describe(index)}")
    known = index.detach()
    if not bool(((known > 0) & torch.isfinite(known)).all()):
        raise ValueError(f"{name}: expected positive numbers that are finite")
