"""What BSDFs have in common: native models once more as tensor operations, and those that users write.

Directions are local, +z along the shading normal, and point away from the surface; values include the cosine. Of a
smooth lobe a detached direction is sampled; a delta lobe's direction is an attached function of `wi` and of the model's
parameters, and its `eval` is the attached weight of the lobe that was chosen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch

from ..scene.torch_bsdf import SurfaceInteraction
from .color import luminance
from .geometry import reattach, root
from .world import At, Record, World

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


class Delta(Bsdf):
    """One of delta lobes only."""

    smooth, delta = False, True


def one_lobe(wo: torch.Tensor, pdf: torch.Tensor, eta: torch.Tensor | None = None) -> BsdfSample:
    """Samples that are all of lobe 0, and go through no interface unless `eta` is given."""
    eta = torch.ones_like(pdf) if eta is None else eta
    return BsdfSample(wo, pdf, eta, torch.zeros(len(wo), dtype=torch.int64))


def above(wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
    """Where both directions are above the surface."""
    return (wi[:, 2] > 0) & (wo[:, 2] > 0)


def upper(v: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3), those from below mirrored."""
    return torch.cat([v[:, :2], v[:, 2:].abs()], 1)


def mirrored(wi: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3) of the mirror reflection."""
    return wi * wi.new_tensor([-1.0, -1.0, 1.0])


def upright(usable: torch.Tensor, *vectors: torch.Tensor) -> list[torch.Tensor]:
    """Vectors (N, 3) that are +z where they are not usable (N,), whose functions have derivatives that are finite."""
    up = vectors[0].new_tensor([0.0, 0.0, 1.0])
    return [torch.where(usable[:, None], v, up) for v in vectors]


def at_least(x: torch.Tensor, low: float) -> torch.Tensor:
    """Numbers that count as `low` where they are smaller, with the derivative there."""
    return reattach(x.detach().clamp(min=low), x)


def fresnel_dielectric(cos_i: torch.Tensor, eta: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Reflectance, signed cosine of refraction, relative index along the ray and its inverse, each (N,)."""
    outside = cos_i >= 0
    eta_it, eta_ti = torch.where(outside, eta, 1 / eta), torch.where(outside, 1 / eta, eta)
    ci, ct = cos_i.abs(), root(1 - eta_ti * eta_ti * (1 - cos_i * cos_i))
    matched, grazing = (eta == 1).expand_as(ci), ci == 0
    usable = ~(matched | grazing)
    safe_ci, safe_ct = torch.where(usable, ci, 1.0), torch.where(usable, ct, 1.0)
    r = torch.where(usable, reflectance(safe_ci, safe_ct, eta_it), torch.where(matched, 0.0, 1.0).to(ci))
    cos_t = torch.where(matched, -cos_i, torch.where(outside, -ct, ct))
    return r, cos_t, eta_it, eta_ti


def reflectance(ci: torch.Tensor, ct: torch.Tensor, eta: torch.Tensor) -> torch.Tensor:
    """Fresnel's, from the cosines of both directions and the index of refraction along the ray."""
    senkrecht = (ci - eta * ct) / (ci + eta * ct)
    parallel = (ct - eta * ci) / (ct + eta * ci)
    return 0.5 * (senkrecht * senkrecht + parallel * parallel)


def fresnel_conductor(cos_i: torch.Tensor, eta: torch.Tensor, k: torch.Tensor) -> torch.Tensor:
    """Reflectance of a metal with the index eta - i k, for a cosine that is not negative."""
    c2 = cos_i * cos_i
    s2 = 1 - c2
    a = eta * eta - k * k - s2
    length = root(a * a + 4 * eta * eta * k * k)
    larger = root(0.5 * (length + a.abs()))
    # The smaller of two numbers whose product is eta k and whose squares differ by a: differentiable at eta = 0.
    real = torch.where(a < 0, eta * k / torch.where(a < 0, larger, 1.0), larger)
    first, second = length + c2, 2 * cos_i * real
    senkrecht = (first - second) / (first + second)
    third, fourth = length * c2 + s2 * s2, second * s2
    return 0.5 * (senkrecht + senkrecht * (third - fourth) / (third + fourth))
