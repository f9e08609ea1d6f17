"""A table of the sigmoids of all colours, and its interpolation, which is fast enough for images.

By the largest channel, its value, and the ratios of the other two to it, as Jakob and Hanika have it. Both the value
and the ratios are denser at their ends, where coefficients vary most.
"""

from __future__ import annotations

import torch

from .cached import made_once
from .sigmoids import nodes
from .solving import levenberg, newton, reachable

FINE, COARSE = 64, 16  # nodes an axis: for images, and to begin the search for a constant's coefficients
BLACK = 1e-6  # what is not brighter than this is black
_END = 5e-4  # how near colours of the table come to the ends of ratios and values, but for dark ones
_PART = 2048  # colours at a time, so that they stay in the cache


def lookup(rgb: torch.Tensor, size: int) -> torch.Tensor:
    """Coefficients (..., 3) of colours (..., 3) from 0 to 1, trilinear in a table of `size` nodes an axis.

    Differentiable as what it is. The derivative at black is that of grey.
    """
    columns, value_nodes, ratio_nodes = _table(size, rgb.dtype)
    top, channel = rgb.max(-1)
    lit = top > BLACK
    value = torch.where(lit, top, rgb.mean(-1))
    cell, z = _place(value, value_nodes, 2)
    first, corner = (channel * size + cell) * size * size, []
    for axis in (1, 2):
        place = channel + axis
        other = rgb.gather(-1, (place - 3 * (place > 2))[..., None])[..., 0]
        ratio = torch.where(lit, other / torch.where(lit, top, 1.0), 1.0)
        cell, t = _place(ratio, ratio_nodes, 1)
        first = first + cell * size ** (axis - 1)
        corner.append(t)
    # number by number, which is several times faster than by rows of three
    places = [first.reshape(-1) + (i * size + j) * size + k for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    found = []
    for column in columns:
        ends = [column.to(rgb.device).index_select(0, place).reshape(top.shape) for place in places]
        for t in (*corner, z):
            ends = [torch.lerp(low, high, t) for low, high in zip(ends[::2], ends[1::2])]
        found.append(ends[0])
    return torch.stack(found, -1)


def _place(numbers: torch.Tensor, at: torch.Tensor, times: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The cell of each number, and how far it is through it, which alone has a derivative."""
    at = at.to(numbers.device)
    t = numbers.detach().clamp(0, 1)
    for _ in range(times):  # the inverse of the smooth step
        t = 0.5 - torch.sin(torch.asin(1 - 2 * t) / 3)
    cell = (t * (len(at) - 1)).long().clamp(0, len(at) - 2)
    low, high = (at.index_select(0, end.reshape(-1)).reshape(cell.shape) for end in (cell, cell + 1))
    return cell, (numbers - low) / (high - low)


@made_once
def _table(size: int, dtype: torch.dtype) -> tuple[tuple[torch.Tensor, ...], torch.Tensor, torch.Tensor]:
    """Three coefficients (3 size^3,), by channel, value, second and first ratio; values and ratios (size,)."""
    table, value_nodes, ratio_nodes = _made(size)
    columns = tuple(column.to(dtype, copy=True) for column in table.unbind(-1))
    return columns, value_nodes.to(dtype), ratio_nodes.to(dtype)


@made_once
def _made(size: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The table (3 size^3, 3), float32, and the values and ratios (size,) of its nodes."""
    t = torch.linspace(0, 1, size, dtype=torch.float64)
    ratio_nodes = _smooth_step(t)
    value_nodes = _smooth_step(ratio_nodes)
    colours = _colours(value_nodes, ratio_nodes)
    table = _march(colours.float(), 2 if size == FINE else 4)
    if size == FINE:
        _correct(table, colours)
    return table.reshape(size, 3, -1, 3).transpose(0, 1).reshape(-1, 3), value_nodes, ratio_nodes


def _smooth_step(t: torch.Tensor) -> torch.Tensor:
    return t * t * (3 - 2 * t)


def _colours(values: torch.Tensor, ratios: torch.Tensor) -> torch.Tensor:
    """(size, 3 size^2, 3): value, then channel and ratios."""
    second, first = torch.meshgrid(ratios.clamp(min=_END), ratios.clamp(min=_END), indexing="ij")
    shades = torch.stack([torch.ones_like(first), first, second], -1).reshape(-1, 3)
    shades = torch.cat([shades.roll(channel, 1) for channel in range(3)])
    return reachable(values.clamp(BLACK, 1 - _END)[:, None, None] * shades)


def _march(colours: torch.Tensor, steps: int) -> torch.Tensor:
    """Some of Newton's steps from each value to the next, from the middle to both ends; at 48 nodes."""
    rule, middle = nodes(10, torch.float32), len(colours) // 2
    result = torch.empty_like(colours)
    target = colours[middle]
    grey = target.mean(-1, keepdim=True)
    current = torch.zeros_like(target)
    for step in range(1, 9):
        current = newton(current, grey + (target - grey) * step / 8, rule, 2)
    result[middle] = newton(current, target, rule, 4)
    for numbers, back in ((range(middle - 1, -1, -1), 1), (range(middle + 1, len(colours)), -1)):
        for i in numbers:
            for part in range(0, colours.shape[1], _PART):
                rows = slice(part, part + _PART)
                result[i, rows] = newton(result[i + back, rows], colours[i, rows], rule, steps)
    return result.nan_to_num(0.0)


def _correct(table: torch.Tensor, colours: torch.Tensor) -> None:
    """What Newton's steps have missed, and steep spectra, for which they had too few nodes."""
    rule, found = nodes(10, torch.float32), table.view(-1, 3)
    wanted = colours.view(-1, 3)
    errors = [
        (rule.colours(part)[0] - target).abs().amax(-1)
        for part, target in zip(found.split(_PART), wanted.float().split(_PART))
    ]
    wrong = (torch.cat(errors) > 2e-4).nonzero()[:, 0]
    start = found[wrong].double()
    found[wrong] = levenberg(start, wanted[wrong], nodes(1, torch.float64), 30, 1e-5).float()
