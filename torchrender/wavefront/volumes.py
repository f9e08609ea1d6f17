"""Volumes: functions of the world, the volume's record and points (N, 3) of the world, to values (N, C)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from ..surface import inverse_linear
from .texels import texels, wrap

if TYPE_CHECKING:
    from ..scene.packing import Record
    from .world import World


def constvolume(world: World, record: Record, p: torch.Tensor) -> torch.Tensor:
    """The same value everywhere."""
    return world.tensor("volume", record, "value").expand(len(p), world.channels)


def to_grid(world: World, record: Record, p: torch.Tensor) -> torch.Tensor:
    """Points (N, 3) in the space of a grid's unit cube."""
    matrix = world.tensor("volume", record, "to_world")
    return (inverse_linear(matrix) * (p - matrix[:3, 3])[:, None]).sum(2)


def gridvolume(world: World, record: Record, p: torch.Tensor) -> torch.Tensor:
    """Voxels, nearest or trilinear."""
    data, mode = world.tensor("volume", record, "data"), record.field["wrap_mode"]
    size = data.shape[2], data.shape[1], data.shape[0]
    layers = data.flatten(0, 1)  # rows of all slices, one after the other
    q = to_grid(world, record, p)
    if record.field["filter_type"] == 1:  # nearest
        i, j, k = (wrap(torch.floor(q[:, a] * n).long(), n, mode) for a, n in enumerate(size))
        return texels(layers, k * size[1] + j, i).expand(-1, world.channels)
    at = torch.stack([q[:, a] * n - 0.5 for a, n in enumerate(size)], 1)
    low = torch.floor(at.detach())
    part = at - low
    total = torch.zeros(len(p), data.shape[3], dtype=data.dtype)
    for corner in range(8):
        bits = [corner >> a & 1 for a in range(3)]
        i, j, k = (wrap(low[:, a].long() + bits[a], n, mode) for a, n in enumerate(size))
        weights = [part[:, a] if bits[a] else 1 - part[:, a] for a in range(3)]
        total = total + texels(layers, k * size[1] + j, i) * (weights[0] * weights[1] * weights[2])[:, None]
    return total.expand(-1, world.channels)


VOLUMES: dict[str, Callable[[World, Record, torch.Tensor], torch.Tensor]] = {
    "constvolume": constvolume,
    "gridvolume": gridvolume,
}


def evaluate(world: World, index: int, p: torch.Tensor) -> torch.Tensor:
    """A volume by its number, at points."""
    record = world.records["volume"][index]
    return VOLUMES[record.type](world, record, p)
