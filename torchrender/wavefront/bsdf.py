"""What BSDFs have in common: native models (native_bsdf.py), and those that users write (torch_adapter.py).

Directions are local, +z along the shading normal, and point away from the surface; values include the cosine. Of a
smooth lobe a detached direction is sampled; a delta lobe's direction is an attached function of `wi` and of the model's
parameters, and its `eval` is the attached weight of the lobe that was chosen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch

from ..scene.packing import Record
from ..scene.torch_bsdf import SurfaceInteraction
from .color import luminance
from .world import At, World

Color = Callable[[str], torch.Tensor]


@dataclass
class BsdfSample:
    """Sampled directions (N, 3), and the numbers (N,) that go with them.

    `pdf` is their density or the probability of the lobe, 0 where there is no sample; `eta` the relative index of
    refraction along the new ray; `lobe` the number of the lobe.
    """

    wo: torch.Tensor
    pdf: torch.Tensor
    eta: torch.Tensor
    lobe: torch.Tensor


class Bsdf:
    """A BSDF with its parameters at N points. Of `si` only models take notice that are written by users."""

    smooth: ClassVar[bool] = True  # has a lobe with a density, which is number 0
    delta: ClassVar[bool] = False  # has delta lobes

    def __init__(self, world: World, record: Record, at: At, si: SurfaceInteraction | None = None) -> None:
        self.world, self.record, self.channels = world, record, world.channels

        def color(name: str) -> torch.Tensor:
            return world.color("bsdf", record, name, at)

        self.scalar: Color = lambda name: luminance(color(name))
        self.read(color, lambda name: world.tensor("bsdf", record, name))

    @classmethod
    def oriented(cls, record: Record) -> bool:
        """Whether the frame's first axis follows the texture coordinates."""
        return False

    def read(self, color: Color, number: Color) -> None:
        """Take the parameters: colours at the points (N, C), single numbers (); of textures `scalar` makes (N,)."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(wi), dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        raise NotImplementedError


def one_lobe(wo: torch.Tensor, pdf: torch.Tensor, eta: torch.Tensor | None = None) -> BsdfSample:
    """Samples that are all of lobe 0, and go through no interface unless `eta` is given."""
    eta = torch.ones_like(pdf) if eta is None else eta
    return BsdfSample(wo, pdf, eta, torch.zeros(len(wo), dtype=torch.int64))
