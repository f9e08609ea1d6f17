"""The wanted pixels of a film, and what places on it get of them and give to them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch

from ..render_call import RenderCall
from ..wavefront.film import filter_weight


class FilmPlaces:
    """The wanted pixels as an image of their own rectangle.

    Args:
        channels: None for those of radiance and alpha.
        magnitude: the filter's sign is left out, as it is for averages over what is hit.
    """

    def __init__(self, call: RenderCall, channels: int | None = None, magnitude: bool = False) -> None:
        self.filter, self.magnitude = call.film.filter, magnitude
        self.reach = 0 if self.filter.type == "box" else max(1, math.ceil(self.filter.reach - 0.5))
        self.y0, self.x0, self.height, self.width = call.config["crop"]
        self.channels = call.numbers + 1 if channels is None else channels
        self.where: torch.Tensor | None = None
        if call.pixels is not None:
            chosen = torch.as_tensor(call.pixels, dtype=torch.int64)
            self.where = chosen[:, 0] * self.width + chosen[:, 1]
        top, left, rows, columns = call.config["window"]
        y = self._integral(self.y0, self.height, top, rows)
        x = self._integral(self.x0, self.width, left, columns)
        self.normal = (y[:, None] * x)[..., None]

    def _integral(self, first: int, count: int, begin: int, size: int) -> torch.Tensor:
        """Of the filter of each pixel along an axis, over the part of the film that has samples."""
        if self.reach == 0:
            return torch.ones(count, dtype=torch.float64)
        steps = 64
        offset = (torch.arange(-self.reach * steps, (self.reach + 1) * steps, dtype=torch.float64) + 0.5) / steps
        value = self._weight(offset - 0.5) / steps
        at = first + torch.arange(count)[:, None] + offset
        return (value * ((at >= begin) & (at < begin + size))).sum(1)

    def _weight(self, x: torch.Tensor) -> torch.Tensor:
        weight = filter_weight(self.filter, x)
        return weight.abs() if self.magnitude else weight

    def empty(self) -> torch.Tensor:
        return torch.zeros(self.height, self.width, self.channels, dtype=torch.float64)

    def wanted(self, place: torch.Tensor) -> torch.Tensor:
        """Whether places (N, 2) are in wanted pixels, about: (N,) bool."""
        x, y = torch.floor(place[:, 0]).long() - self.x0, torch.floor(place[:, 1]).long() - self.y0
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        if self.where is None:
            return inside
        chosen = torch.zeros(self.height * self.width, dtype=torch.bool)
        chosen[self.where] = True
        return inside & chosen[torch.where(inside, y * self.width + x, 0)]

    def cells(self, window: tuple[int, int, int, int]) -> torch.Tensor:
        """Corners (n, 2), x and y, of the squares of the film, within its sampled window, that reach wanted pixels."""
        top, left, rows, columns = window
        y = torch.arange(max(top, self.y0 - self.reach), min(top + rows, self.y0 + self.height + self.reach))
        x = torch.arange(max(left, self.x0 - self.reach), min(left + columns, self.x0 + self.width + self.reach))
        grid = torch.stack(torch.meshgrid(y, x, indexing="ij"), 2).flip(2).reshape(-1, 2)
        if self.where is None or not len(grid):
            return grid
        wanted = torch.zeros(1, 1, self.height, self.width)
        wanted.view(-1)[self.where] = 1
        pad = self.reach
        near = torch.nn.functional.max_pool2d(torch.nn.functional.pad(wanted, [pad] * 4), 2 * pad + 1, 1, pad)[0, 0]
        row, column = grid[:, 1] - self.y0 + pad, grid[:, 0] - self.x0 + pad
        return grid[near[row, column] > 0]

    def add(self, image: torch.Tensor, values: torch.Tensor, channels: slice) -> None:
        """Values (n, C) of the wanted pixels."""
        flat = image.view(-1, self.channels)[:, channels]
        if self.where is None:
            flat += values
        else:
            flat.index_add_(0, self.where, values.to(flat.dtype))

    def results(self, image: torch.Tensor) -> torch.Tensor:
        flat = image.view(-1, self.channels)
        return flat if self.where is None else flat[self.where]

    def _taps(self, place: torch.Tensor) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Pixels around places (N, 2) and their weights, zero outside."""
        corner = torch.floor(place).long()
        for dy in range(-self.reach, self.reach + 1):
            row = corner[:, 1] + dy
            wy = self._weight(row + 0.5 - place[:, 1])
            for dx in range(-self.reach, self.reach + 1):
                column = corner[:, 0] + dx
                weight = wy * self._weight(column + 0.5 - place[:, 0])
                y, x = row - self.y0, column - self.x0
                inside = (y >= 0) & (y < self.height) & (x >= 0) & (x < self.width)
                index = torch.where(inside, y * self.width + x, torch.zeros_like(y))
                yield index, torch.where(inside, weight, torch.zeros_like(weight))[:, None]

    def splat(self, image: torch.Tensor, place: torch.Tensor, values: torch.Tensor) -> None:
        flat = image.view(-1, self.channels)
        for index, weight in self._taps(place):
            flat.index_add_(0, index, values.to(flat.dtype) * weight)
