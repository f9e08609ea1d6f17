"""The film: which samples are drawn for an image, and the weighted mean of them in its pixels (csrc/cpu/film.h)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch

from ..scene.film import Film, ReconstructionFilter
from .geometry import Rows
from .numbers import CAMERA_BLOCK, Numbers, pixel_key


def cubic(x: torch.Tensor, b: float, c: float) -> torch.Tensor:
    """Mitchell and Netravali, "Reconstruction Filters in Computer Graphics", SIGGRAPH 1988, equation 8."""
    x = x.abs()
    inner = ((12 - 9 * b - 6 * c) * x + (-18 + 12 * b + 6 * c)) * x * x + (6 - 2 * b)
    outer = (((-b - 6 * c) * x + (6 * b + 30 * c)) * x - (12 * b + 48 * c)) * x + (8 * b + 24 * c)
    return torch.where(x < 1, inner, torch.where(x < 2, outer, 0.0)) / 6


def filter_weight(rfilter: ReconstructionFilter, x: torch.Tensor) -> torch.Tensor:
    """The filter at distances from a pixel's centre."""
    kind = rfilter.type
    if kind == "box":
        return torch.ones_like(x)
    if kind == "tent":
        return (1 - x.abs() / rfilter.radius).clamp(min=0.0)
    if kind == "mitchell":
        return cubic(x, rfilter.B, rfilter.C)
    if kind == "catmullrom":
        return cubic(x, 0.0, 0.5)
    if kind == "lanczos":
        n = rfilter.lobes
        return torch.where(x.abs() < n, torch.sinc(x) * torch.sinc(x / n), 0.0)
    scale, radius = 0.5 / rfilter.stddev**2, 4 * rfilter.stddev
    return torch.where(x.abs() < radius, torch.exp(-scale * x * x) - math.exp(-scale * radius * radius), 0.0)


@dataclass
class Samples(Rows):
    """Samples of pixels: rows and columns (N, 2), numbers (N,), places in pixels, y and x, and on a lens (N, 2)."""

    pixel: torch.Tensor
    sample: torch.Tensor
    offset: torch.Tensor
    lens: torch.Tensor

    @property
    def positions(self) -> torch.Tensor:
        """Places on the film (N, 2), x and y."""
        return (self.pixel.double() + self.offset).flip(1)


class Splats:
    """Samples of pixels, and the pixels that they contribute to.

    Args:
        film: its size and filter.
        rendered: rows and columns of the film that are wanted, (y0, x0, height, width).
        sampled: those that samples are drawn in.
        pixels: (N, 2) integers in the image of `rendered`, of which alone results are wanted, or None.
    """

    def __init__(self, film: Film, rendered: tuple[int, ...], sampled: tuple[int, ...], pixels: Any = None) -> None:
        self.filter = film.filter
        self.reach = max(0, math.ceil(film.filter.reach - 0.5))
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

    def samples(self, index: torch.Tensor, spp: int, random: Numbers, first: int = 0) -> Samples:
        """The samples of these numbers (N,), which count those of one pixel after the other, from `first` on."""
        pixel, sample = self.sources[index // spp], index % spp + first
        drawn = random.block(pixel_key(*pixel.unbind(1)), sample, CAMERA_BLOCK)
        return Samples(pixel, sample, drawn[:, :2].flip(1).double(), drawn[:, 2:])

    def spread(self, pixel: torch.Tensor, offset: torch.Tensor) -> Spread:
        """What the samples of pixels (N, 2), rows and columns in order, at places (N, 2) in them, y and x, reach."""
        keys, lane, counts = torch.unique_consecutive(pixel, dim=0, return_inverse=True, return_counts=True)
        starts = torch.cumsum(counts, 0) - counts
        place = torch.arange(len(pixel)) - starts[lane]
        around = torch.arange(-self.reach, self.reach + 1)
        weights = torch.zeros(len(keys), int(counts.max()), len(around) ** 2, dtype=torch.float64, device="cpu")
        y, x = (filter_weight(self.filter, around + 0.5 - offset[:, i, None]) for i in (0, 1))
        weights[lane, place] = (y[:, :, None] * x[:, None]).flatten(1)
        height, width = self.target.shape
        row = (keys[:, 0, None, None] + around[:, None] - self.y0).expand(-1, len(around), len(around)).flatten(1)
        column = (keys[:, 1, None, None] + around - self.x0).expand(-1, len(around), len(around)).flatten(1)
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        target = torch.where(inside, self.target[row.clamp(0, height - 1), column.clamp(0, width - 1)], -1)
        return Spread(lane, place, weights, target)


@dataclass
class Spread:
    """From samples to pixels of an image and back.

    Attributes:
        lane, place: (N,), the number of a sample's own pixel, and which of its samples it is.
        weights: (P, L, K), of the samples of P pixels in the K pixels around each.
        target: (P, K), the numbers of those in the image, -1 for none.
    """

    lane: torch.Tensor
    place: torch.Tensor
    weights: torch.Tensor
    target: torch.Tensor

    def add(self, sums: torch.Tensor, values: torch.Tensor) -> None:
        """Add samples' values (N, C) times weights to `sums` (count, C), float64."""
        columns = values.new_zeros(*self.weights.shape[:2], values.shape[1], dtype=torch.float64)
        columns[self.lane, self.place] = values.double()
        totals = self.weights.transpose(1, 2) @ columns
        wanted = self.target >= 0
        sums.index_add_(0, self.target[wanted], totals[wanted])

    def collect(self, adjoint: torch.Tensor) -> torch.Tensor:
        """The transposed of `add`: (N, C) of (count, C)."""
        around = torch.where((self.target >= 0)[..., None], adjoint[self.target.clamp(min=0)], 0.0)
        return (self.weights @ around)[self.lane, self.place]
