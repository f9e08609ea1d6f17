"""Look-ups in images."""

from __future__ import annotations

from typing import TypeAlias

import torch

Pair: TypeAlias = "tuple[torch.Tensor, torch.Tensor]"
"""Indices (N,) of two neighbouring rows or columns."""


def wrap(i: torch.Tensor, n: int, mode: int) -> torch.Tensor:
    """Texel indices in range: repeated, mirrored or clamped."""
    if mode == 2:
        return i.clamp(0, n - 1)
    if mode == 0:
        return i % n
    r = i % (2 * n)
    return torch.where(r >= n, 2 * n - 1 - r, r)


def texels(data: torch.Tensor, row: torch.Tensor, column: torch.Tensor) -> torch.Tensor:
    """``data[row, column]`` for data (H, W, C): one gather, whose adjoint is one sum."""
    flat = data.reshape(-1, data.shape[-1])
    return flat.index_select(0, (row * data.shape[1] + column).flatten()).reshape(*row.shape, data.shape[-1])


def bilinear(
    data: torch.Tensor, rows: Pair, columns: Pair, a: torch.Tensor, b: torch.Tensor, channels: int
) -> torch.Tensor:
    """Texels between two rows and two columns, at the fractions a (across) and b (down): (N, C)."""
    (y0, y1), (x0, x1), a, b = rows, columns, a[:, None], b[:, None]
    corner = texels(data, torch.stack([y0, y0, y1, y1]), torch.stack([x0, x1, x0, x1]))
    upper = corner[0] * (1 - a) + corner[1] * a
    lower = corner[2] * (1 - a) + corner[3] * a
    return (upper * (1 - b) + lower * b).expand(-1, channels)
