"""The film: which samples are drawn for an image, and the weighted mean of them in its pixels (csrc/cpu/film.h)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import torch

from ..scene.film import Film


class Splats:
    """Samples of pixels, and the pixels that they contribute to.

    Args:
        film: its size and filter.
        rendered: rows and columns of the film that are wanted, (y0, x0, height, width).
        sampled: those that samples are drawn in.
        pixels: (N, 2) integers in the image of `rendered`, of which alone results are wanted, or None.
    """

    def __init__(self, film: Film, rendered: tuple[int, ...], sampled: tuple[int, ...], pixels: Any = None) -> None:
        self.kind, self.filter = film.filter.type, film.filter
        radius = {"box": 0.5, "tent": self.filter.radius, "gaussian": 4 * self.filter.stddev}[self.kind]
        self.reach = 0 if self.kind == "box" else max(1, math.ceil(radius - 0.5))
        self.y0, self.x0, height, width = rendered
        whole = {"dtype": torch.int64, "device": "cpu"}
        wanted = torch.arange(height * width, **whole)
        self.where = wanted  # in `sums`, of each pixel of the result
        if pixels is not None:
            pixels = torch.as_tensor(pixels, **whole)
            wanted, self.where = torch.unique(pixels[:, 0] * width + pixels[:, 1], return_inverse=True)
        self.count = len(wanted)
        self.target = torch.full((height, width), -1, **whole)
        self.target.view(-1)[wanted] = torch.arange(self.count, **whole)
        self.sources = self._around(sampled) if pixels is None else self._around_each(wanted, width, sampled)

    def _around(self, sampled: tuple[int, ...]) -> torch.Tensor:
        """Pixels (S, 2) whose samples reach the rectangle that is wanted, in the order of rows."""
        y0, x0, rows, columns = sampled
        height, width = self.target.shape
        top, left = max(y0, self.y0 - self.reach), max(x0, self.x0 - self.reach)
        bottom = min(y0 + rows, self.y0 + height + self.reach)
        right = min(x0 + columns, self.x0 + width + self.reach)
        return torch.cartesian_prod(torch.arange(top, bottom), torch.arange(left, right))

    def _around_each(self, wanted: torch.Tensor, width: int, sampled: tuple[int, ...]) -> torch.Tensor:
        """The same for single pixels."""
        rows, columns = wanted // width + self.y0, wanted % width + self.x0
        around = torch.arange(-self.reach, self.reach + 1)
        rows = (rows[:, None, None] + around[:, None]).expand(-1, len(around), len(around)).flatten()
        columns = (columns[:, None, None] + around).expand(-1, len(around), len(around)).flatten()
        y0, x0, height, wide = sampled
        inside = (rows >= y0) & (rows < y0 + height) & (columns >= x0) & (columns < x0 + wide)
        numbers = torch.unique((rows[inside] - y0) * wide + columns[inside] - x0)
        return torch.stack([numbers // wide + y0, numbers % wide + x0], 1)

    def weight(self, x: torch.Tensor) -> torch.Tensor:
        """The filter at distances from a pixel's centre."""
        if self.kind == "box":
            return torch.ones_like(x)
        if self.kind == "tent":
            return (1 - x.abs() / self.filter.radius).clamp(min=0.0)
        scale, radius = 0.5 / self.filter.stddev**2, 4 * self.filter.stddev
        return torch.where(x.abs() < radius, torch.exp(-scale * x * x) - math.exp(-scale * radius * radius), 0.0)

    def reached(self, pixel: torch.Tensor, offset: torch.Tensor) -> Iterator[tuple[torch.Tensor, ...]]:
        """Numbers of samples, of the pixels that they reach, and weights.

        `pixel` (N, 2) are rows and columns of samples, `offset` (N, 2) their places in them, y and x.
        """
        height, width = self.target.shape
        around = range(-self.reach, self.reach + 1)
        for i in around:
            for j in around:
                row, column = pixel[:, 0] + (i - self.y0), pixel[:, 1] + (j - self.x0)
                rows = ((row >= 0) & (row < height) & (column >= 0) & (column < width)).nonzero()[:, 0]
                target = self.target[row[rows], column[rows]]
                rows, target = rows[target >= 0], target[target >= 0]
                yield rows, target, self.weight(i + 0.5 - offset[rows, 0]) * self.weight(j + 0.5 - offset[rows, 1])

    def add(self, sums: torch.Tensor, pixel: torch.Tensor, offset: torch.Tensor, values: torch.Tensor) -> None:
        """Add samples' values (N, K) times weights to `sums` (count, K), float64."""
        for rows, target, weight in self.reached(pixel, offset):
            sums.index_add_(0, target, values[rows].double() * weight[:, None])

    def collect(self, adjoint: torch.Tensor, pixel: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
        """The transposed of `add`: (N, K) of (count, K)."""
        found = torch.zeros(len(pixel), adjoint.shape[1], dtype=torch.float64, device="cpu")
        for rows, target, weight in self.reached(pixel, offset):
            found.index_add_(0, rows, adjoint[target] * weight[:, None])
        return found
