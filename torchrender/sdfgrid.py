"""Grids of signed distances in plain PyTorch: the shape `sdfgrid` as functions that autograd differentiates.

A grid (D, H, W, 1) has its samples at the corners of (D - 1) (H - 1) (W - 1) cells that fill the unit cube: number
(k, j, i) lies at x = i / (W - 1), y = j / (H - 1), z = k / (D - 1). Between them the function is trilinear, and the
surface is where it is zero; it is negative inside.
"""

from __future__ import annotations

from typing import Any

import torch

from .errors import describe

NORMALS = ("smooth", "analytic")
_AXIS_BITS = 2  # of a primitive: csrc/core/shape/sdfgrid.h


def evaluate(grid: torch.Tensor, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The function and its gradient at points of the unit cube, differentiable in both arguments.

    Args:
        grid: (D, H, W, 1), floating point, D, H, W > 1.
        points: (..., 3), x, y, z; outside the unit cube the outermost cells go on.

    Returns:
        Values of shape (...), gradients (..., 3).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    check(grid)
    if not isinstance(points, torch.Tensor) or points.ndim < 1 or points.shape[-1] != 3:
        raise ValueError(f"points: expected a floating-point tensor of shape (..., 3), got {describe(points)}")
    n = cell_counts(grid)
    place = (points * n).reshape(-1, 3)
    cell = torch.minimum(torch.floor(place.detach()).clamp_min(0), n - 1).long()
    value, slope = interpolate(corners(grid, cell), place - cell)
    return value.reshape(points.shape[:-1]), (slope * n).reshape(points.shape)


def check(grid: Any) -> None:
    """ValueError or TypeError for what is no grid."""
    if not isinstance(grid, torch.Tensor) or not grid.is_floating_point():
        raise TypeError(f"grid: expected a floating-point tensor of shape (D, H, W, 1), got {describe(grid)}")
    if grid.ndim != 4 or grid.shape[3] != 1 or min(grid.shape[:3]) < 2:
        raise ValueError(f"grid: expected a tensor of shape (D, H, W, 1) with D, H, W > 1, got {describe(grid)}")


def cell_counts(grid: torch.Tensor) -> torch.Tensor:
    """Numbers of cells along x, y, z (3,), in the grid's dtype."""
    return grid.new_tensor([grid.shape[2] - 1, grid.shape[1] - 1, grid.shape[0] - 1])


def decode(grid: torch.Tensor, primitive: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of the core's primitives (N,): cells (N, 3), x, y, z, and the numbers (N,) of the axes that are solved for."""
    x_bits, y_bits = (grid.shape[2] - 2).bit_length(), (grid.shape[1] - 2).bit_length()
    code = primitive.long() >> _AXIS_BITS
    x, y = code & ((1 << x_bits) - 1), (code >> x_bits) & ((1 << y_bits) - 1)
    return torch.stack([x, y, code >> (x_bits + y_bits)], 1), primitive.long() & ((1 << _AXIS_BITS) - 1)


def corners(grid: torch.Tensor, cell: torch.Tensor) -> torch.Tensor:
    """The numbers at the corners of cells (N, 3): (N, 2, 2, 2), z, y, x."""
    x, y, z = cell.unbind(1)
    step = torch.arange(2, device=grid.device)
    x, y, z = (i[:, None, None, None] for i in (x, y, z))
    return grid[z + step[:, None, None], y + step[:, None], x + step, 0]


def interpolate(corner: torch.Tensor, at: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The function (N,) and its slopes (N, 3) by the place `at` (N, 3) in cells with these corners (N, 2, 2, 2)."""
    x, y, z = (torch.stack([1 - a, a], 1) for a in at.unbind(1))
    along_x, by_x = (corner * x[:, None, None]).sum(3), corner.diff(dim=3)[..., 0]
    along_y, by_y = (along_x * y[:, None]).sum(2), along_x.diff(dim=2)[..., 0]
    slopes = [((by_x * y[:, None]).sum(2) * z).sum(1), (by_y * z).sum(1), along_y.diff(dim=1)[..., 0]]
    return (along_y * z).sum(1), torch.stack(slopes, 1)


def place(grid: torch.Tensor, primitive: torch.Tensor, barycentric: torch.Tensor) -> torch.Tensor:
    """The points (N, 3) of the unit cube that the core stores as these primitives (N,) and coordinates (N, 2)."""
    cell, axis = decode(grid, primitive)
    corner = corners(grid, cell)
    order = (axis[:, None] + torch.tensor([0, 1, 2])) % 3  # the axis that is solved for first
    back = torch.argsort(order, 1)
    at = torch.cat([torch.zeros_like(barycentric[:, :1]), barycentric], 1).gather(1, back)
    value, slope = interpolate(corner, at)
    steep = slope.gather(1, axis[:, None])[:, 0]
    usable = steep != 0
    third = torch.where(usable, -value / torch.where(usable, steep, 1.0), 0.5)
    at = torch.cat([third[:, None], barycentric], 1).gather(1, back)
    return (cell + at) / cell_counts(grid)


def smooth_gradient(grid: torch.Tensor, cell: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
    """The sum of unit vectors (N, 3) that smooth normals are along, at places (N, 3) in cells (N, 3).

    Along each axis the difference over the cell, and that over the next cell on the side where the point is; the eight
    gradients that can be made of those, each of unit length, interpolated between the cells' centres.
    """
    n = cell_counts(grid)
    own = interpolate(corners(grid, cell), at)[1] * n
    differences, shares = [], []
    for a in range(3):
        after = at[:, a].detach() >= 0.5
        other = cell.clone()
        other[:, a] += torch.where(after, 1, -1)
        inside = (other[:, a] >= 0) & (other[:, a] < n[a])
        other = torch.where(inside[:, None], other, cell)
        next_one = interpolate(corners(grid, other), at)[1][:, a] * n[a]
        differences.append((own[:, a], next_one))
        distance = torch.where(after, at[:, a] - 0.5, 0.5 - at[:, a])
        shares.append(torch.where(inside, distance, 0.0))
    total = torch.zeros_like(at)
    for b in range(8):
        chosen = [b >> a & 1 for a in range(3)]
        gradient = torch.stack([differences[a][chosen[a]] for a in range(3)], 1)
        square = gradient.square().sum(1, keepdim=True)
        usable = square > 0
        unit = torch.where(usable, gradient / torch.sqrt(torch.where(usable, square, 1.0)), 0.0)
        weight = torch.ones_like(at[:, 0])
        for a in range(3):
            weight = weight * (shares[a] if chosen[a] else 1 - shares[a])
        total = total + unit * weight[:, None]
    return total
