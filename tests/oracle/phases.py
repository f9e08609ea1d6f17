"""Phase functions: functions of the world, the record, points (N, 3), directions of travel before and after (N, 3), to
densities per solid angle (N,)."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from .geometry import dot
from .world import Record, World


def isotropic(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    return torch.full((len(p),), 1 / (4 * math.pi), dtype=p.dtype)


def hg(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    g = world.tensor("phase", record, "g")
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * dot(before, after)) ** 1.5)


PHASES: dict[str, Callable[..., torch.Tensor]] = {"isotropic": isotropic, "hg": hg}


def evaluate(world: World, index: int, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """A phase function by its number; -1 is isotropic."""
    if index < 0:
        return torch.full((len(p),), 1 / (4 * math.pi), dtype=p.dtype)
    record = world.records["phase"][index]
    return PHASES[record.type](world, record, p, before, after)
