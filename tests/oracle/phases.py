"""Phase functions: functions of the world, the record, points (N, 3), directions of travel before and after (N, 3), to
densities per solid angle (N,)."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from torchrender.surface import dot
from torchrender.wavefront import volumes
from torchrender.wavefront.world import Record, World


def isotropic(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    return torch.full((len(p),), 1 / (4 * math.pi), dtype=p.dtype)


def hg(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    g = world.tensor("phase", record, "g")
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * dot(before, after)) ** 1.5)


def rayleigh(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    return 3 / (16 * math.pi) * (1 + dot(before, after) ** 2)


def tabphase(world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    values = world.tensor("phase", record, "values")
    x = (dot(before, after).clamp(-1, 1) + 1) / 2 * (len(values) - 1)
    i = x.detach().floor().long().clamp(max=len(values) - 2)
    integral = torch.trapezoid(values, dx=2 / (len(values) - 1))
    return torch.lerp(values[i], values[i + 1], x - i) / (2 * math.pi * integral)


def blendphase(
    world: World, record: Record, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor
) -> torch.Tensor:
    weight = volumes.evaluate(world, record.field["weight"], p)[:, 0] if record.field["weight"] >= 0 else 0.5
    first, second = (evaluate(world, record.field[name], p, before, after) for name in ("phase_0", "phase_1"))
    return (1 - weight) * first + weight * second


PHASES: dict[str, Callable[..., torch.Tensor]] = {
    "isotropic": isotropic,
    "hg": hg,
    "rayleigh": rayleigh,
    "tabphase": tabphase,
    "blendphase": blendphase,
}


def evaluate(world: World, index: int, p: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """A phase function by its number; -1 is isotropic."""
    if index < 0:
        return torch.full((len(p),), 1 / (4 * math.pi), dtype=p.dtype)
    record = world.records["phase"][index]
    return PHASES[record.type](world, record, p, before, after)
