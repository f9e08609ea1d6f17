"""Height fields in plain PyTorch: the surface of the shape `heightfield` as functions that autograd differentiates.

Heights (H, W) lie over the unit square of texture coordinates like the texels of a bitmap: number (row i, column j) is
centred at v = (i + 0.5) / H, u = (j + 0.5) / W, row 0 at v = 0; beyond the border they go on as they end. They are the
control values of a uniform cubic B-spline ("bspline", which is smooth to its second derivatives and does not pass
through them) or the values between which the surface is bilinear ("bilinear").
"""

from __future__ import annotations

import functools
from typing import Any

import torch

from .errors import describe
from .transform import as_matrix

INTERPOLATIONS = ("bspline", "bilinear")


def evaluate(
    heights: torch.Tensor, uv: torch.Tensor, interpolation: str = "bspline"
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The height and its slopes at points of the surface, differentiable in both arguments.

    Args:
        heights: (H, W), scene units before `to_world`.
        uv: (..., 2), texture coordinates; [0, 1] is the surface.
        interpolation: "bspline" or "bilinear".

    Returns:
        z, dz/du, dz/dv, each of shape (...).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    _check(heights, interpolation)
    if not isinstance(uv, torch.Tensor) or uv.ndim < 1 or uv.shape[-1] != 2 or not uv.is_floating_point():
        raise ValueError(f"uv: expected a floating-point tensor of shape (..., 2), got {describe(uv)}")
    columns, x, dx = _weights(uv[..., 0], heights.shape[1], interpolation)
    rows, y, dy = _weights(uv[..., 1], heights.shape[0], interpolation)
    taps = heights[rows[..., :, None], columns[..., None, :]]  # (..., n, n), n weights an axis
    along = (taps * x[..., None, :]).sum(-1)
    return (along * y).sum(-1), ((taps * dx[..., None, :]).sum(-1) * y).sum(-1), (along * dy).sum(-1)


def grid(
    heights: torch.Tensor, resolution: tuple[int, int], interpolation: str = "bspline"
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`evaluate` on a regular grid with the border, in less memory.

    Args:
        heights: (H, W).
        resolution: steps along v and u; there is one point more each way.

    Returns:
        z, dz/du, dz/dv, each (resolution[0] + 1, resolution[1] + 1).
    """
    _check(heights, interpolation)
    steps = tuple(resolution)
    if len(steps) != 2 or any(not isinstance(n, int) or n < 1 for n in steps):
        raise ValueError(f"resolution: expected two positive integers (rows, columns), got {describe(resolution)}")
    axes = [torch.linspace(0, 1, n + 1, dtype=heights.dtype, device=heights.device) for n in steps]
    rows, y, dy = _weights(axes[0], heights.shape[0], interpolation)
    columns, x, dx = _weights(axes[1], heights.shape[1], interpolation)

    def over_columns(weight: torch.Tensor) -> torch.Tensor:
        return functools.reduce(torch.add, (heights[:, columns[:, k]] * weight[:, k] for k in range(weight.shape[1])))

    def over_rows(table: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        return functools.reduce(torch.add, (table[rows[:, k]] * weight[:, k, None] for k in range(weight.shape[1])))

    along = over_columns(x)
    return over_rows(along, y), over_rows(over_columns(dx), y), over_rows(along, dy)


def mesh(
    heights: torch.Tensor,
    to_world: Any = None,
    resolution: tuple[int, int] | None = None,
    interpolation: str = "bspline",
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The surface as a fine mesh, a regular grid of points that lie on it, differentiable in heights and matrix.

    ``tr.Mesh(vertices=v, faces=f, vertex_normals=n, vertex_texcoords=uv)`` takes the four, as ``tr.Mesh(*four)`` does.

    Args:
        heights: (H, W).
        to_world: 4x4 matrix, the identity if omitted.
        resolution: quads along v and u, two triangles each; two a height each way if omitted.
        interpolation: "bspline" or "bilinear".

    Returns:
        vertices (V, 3), faces (F, 3) int32, counter-clockwise seen from where the normals point to, unit normals
        (V, 3), texcoords (V, 2); V = (rows + 1) (columns + 1), row after row.
    """
    _check(heights, interpolation)
    steps = (2 * heights.shape[0], 2 * heights.shape[1]) if resolution is None else resolution
    z, z_u, z_v = grid(heights, steps, interpolation)
    real = {"dtype": heights.dtype, "device": heights.device}
    v, u = torch.meshgrid(*(torch.linspace(0, 1, n + 1, **real) for n in steps), indexing="ij")
    texcoords = torch.stack([u, v], -1).reshape(-1, 2)
    vertices = torch.stack([2 * u - 1, 2 * v - 1, z], -1).reshape(-1, 3)
    normals = torch.stack([-z_u / 2, -z_v / 2, torch.ones_like(z)], -1).reshape(-1, 3)
    mirrored = False
    if to_world is not None:
        matrix = as_matrix(to_world, 4, "to_world").to(**real)
        linear = matrix[:3, :3]
        vertices = vertices @ linear.T + matrix[:3, 3]
        normals = normals @ torch.linalg.inv(linear)
        mirrored = bool(torch.linalg.det(linear.detach()) < 0)
    corner = torch.arange(len(texcoords), dtype=torch.int32, device=heights.device).reshape(steps[0] + 1, steps[1] + 1)
    a, b, c, d = (t.reshape(-1) for t in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    faces = torch.stack([a, b, c, a, c, d], 1).reshape(-1, 3)
    if mirrored:
        faces = faces.flip(1).contiguous()
    return vertices, faces, torch.nn.functional.normalize(normals, dim=1), texcoords


def _weights(x: torch.Tensor, n: int, interpolation: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Of coordinates (...) over n heights: their indices, weights, and the weights' derivatives, each (..., 4 or 2)."""
    at = x * n - 0.5
    first = at.detach().floor()
    f = at - first
    if interpolation == "bilinear":
        weight, slope = [1 - f, f], [-torch.ones_like(f), torch.ones_like(f)]
        offsets = (0, 1)
    else:
        g = 1 - f
        weight = [g**3 / 6, 2 / 3 - f * f * (2 - f) / 2, 2 / 3 - g * g * (2 - g) / 2, f**3 / 6]
        slope = [-g * g / 2, f * (1.5 * f - 2), -g * (1.5 * g - 2), f * f / 2]
        offsets = (-1, 0, 1, 2)
    index = torch.stack([(first.long() + k).clamp(0, n - 1) for k in offsets], -1)
    return index, torch.stack(weight, -1), torch.stack(slope, -1) * n


def _check(heights: Any, interpolation: str) -> None:
    if not isinstance(heights, torch.Tensor) or not heights.is_floating_point():
        raise TypeError(f"heights: expected a floating-point tensor of shape (H, W), got {describe(heights)}")
    if heights.ndim != 2 or heights.numel() == 0:
        raise ValueError(f"heights: expected a tensor of shape (H, W) that is not empty, got {describe(heights)}")
    if interpolation not in INTERPOLATIONS:
        raise ValueError(f"interpolation: expected one of {', '.join(INTERPOLATIONS)}, got {describe(interpolation)}")
