"""What BSDFs have in common. Directions are local, +z along the shading normal, and point away from the surface; values
include the cosine.

Of a smooth model a detached direction is sampled; a delta model's direction is an attached function of `wi` and of the
model's parameters, and its `eval` is the attached weight of the lobe that was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .geometry import root
from .world import At, Record, World


@dataclass
class BsdfSample:
    """Directions (N, 3), their density or the probability of the lobe (N,), 0 where there is none; the relative index
    of refraction along the new ray; the number of the lobe."""

    wo: torch.Tensor
    pdf: torch.Tensor
    eta: torch.Tensor
    lobe: torch.Tensor


class Bsdf:
    """A BSDF with its parameters at N points."""

    smooth = False  # has a lobe with a density, which is number 0
    delta = True  # has delta lobes
    oriented = False  # the frame's first axis follows the texture coordinates
    albedo: str | None = None  # the texture that is the output `albedo`; None is white

    def __init__(self, world: World, record: Record, at: At) -> None:
        self.channels, self.record = world.channels, record

        def color(name: str) -> torch.Tensor:
            return world.color("bsdf", record, name, at)

        self.scalar = lambda name: luminance(color(name))
        self.read(color, lambda name: world.tensor("bsdf", record, name))

    def read(self, color, number) -> None:
        """Take the parameters: colours at the points (N, C), single numbers (); of textures `scalar` makes (N,)."""

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(wi), dtype=wi.dtype)


def luminance(color: torch.Tensor) -> torch.Tensor:
    """Of colours (N, C): (N,)."""
    return color[:, 0] if color.shape[1] == 1 else color @ color.new_tensor([0.2126, 0.7152, 0.0722])


def fresnel_dielectric(cos_i: torch.Tensor, eta: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Reflectance, signed cosine of refraction, relative index along the ray and its inverse, each (N,)."""
    outside = cos_i >= 0
    eta_it, eta_ti = torch.where(outside, eta, 1 / eta), torch.where(outside, 1 / eta, eta)
    ci, ct = cos_i.abs(), root(1 - eta_ti * eta_ti * (1 - cos_i * cos_i))
    matched, grazing = (eta == 1).expand_as(ci), ci == 0
    usable = ~(matched | grazing)
    safe_ci, safe_ct = torch.where(usable, ci, 1.0), torch.where(usable, ct, 1.0)
    senkrecht = (safe_ci - eta_it * safe_ct) / (safe_ci + eta_it * safe_ct)
    parallel = (safe_ct - eta_it * safe_ci) / (safe_ct + eta_it * safe_ci)
    r = 0.5 * (senkrecht * senkrecht + parallel * parallel)
    r = torch.where(usable, r, torch.where(matched, 0.0, 1.0).to(r))
    cos_t = torch.where(matched, -cos_i, torch.where(outside, -ct, ct))
    return r, cos_t, eta_it, eta_ti


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


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(1)


def normalized(v: torch.Tensor) -> torch.Tensor:
    return v / v.norm(dim=1, keepdim=True)
