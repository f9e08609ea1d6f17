"""What emitters have in common: what arrives from a sampled point or direction."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..scene.packing import Record
from .geometry import Rows
from .world import World


@dataclass
class Light(Rows):
    """Sampled light at N points.

    `direction` (N, 3), unit, from the point; `distance` (N,), detached; `pdf` (N,) per solid angle, detached, 0 where
    nothing arrives; `value` (N, C), emission times the geometry that moves, over what it was when it was sampled;
    `delta` (N,), no ray can hit the emitter by itself.
    """

    direction: torch.Tensor
    distance: torch.Tensor
    pdf: torch.Tensor
    value: torch.Tensor
    delta: torch.Tensor


class Emitter:
    """An emitter of a scene; `index` is its number."""

    environment = False  # seen by rays that leave the scene

    def __init__(self, world: World, index: int) -> None:
        self.world, self.index, self.record = world, index, world.records["emitter"][index]
        self.prepare(self.record)

    def prepare(self, record: Record) -> None:
        """What is needed besides."""

    def number(self, name: str) -> torch.Tensor:
        return self.world.tensor("emitter", self.record, name)

    def color(self, name: str, count: int) -> torch.Tensor:
        return self.number(name).expand(count, self.world.channels)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        raise NotImplementedError


def endless(d: torch.Tensor, pdf: torch.Tensor, value: torch.Tensor, delta: bool = False) -> Light:
    """Light from infinitely far away."""
    everywhere = torch.full((len(d),), delta)
    return Light(d, torch.full((len(d),), math.inf, dtype=d.dtype), pdf, value, everywhere)
