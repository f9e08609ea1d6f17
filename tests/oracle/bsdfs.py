"""BSDFs. Directions are local, +z along the shading normal, and point away from the surface; values include the cosine.

Of a smooth model a detached direction is sampled; a delta model's direction is an attached function of `wi` and of the
model's parameters, and its `eval` is the attached weight of the lobe that was chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from .geometry import root
from .numbers import cosine_hemisphere
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

    smooth = False
    albedo: str | None = None  # the texture that is the output `albedo`; None is white

    def __init__(self, world: World, record: Record, at: At) -> None:
        self.channels = world.channels
        self.read(lambda name: world.color("bsdf", record, name, at), lambda name: world.tensor("bsdf", record, name))

    def read(self, color, number) -> None:
        """Take the parameters: colours at the points (N, C), single numbers ()."""

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(wi), dtype=wi.dtype)


class Diffuse(Bsdf):
    smooth = True
    albedo = "reflectance"

    def read(self, color, number) -> None:
        self.reflectance = color("reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return self.reflectance * torch.where(above, wo[:, 2] / math.pi, 0.0)[:, None]

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.where((wi[:, 2] > 0) & (wo[:, 2] > 0), wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wo = cosine_hemisphere(u[:, 1], u[:, 2])
        one = torch.ones_like(wo[:, 2])
        return BsdfSample(wo, torch.where(wi[:, 2] > 0, wo[:, 2] / math.pi, 0.0), one, torch.zeros(len(wi)).long())


class Conductor(Bsdf):
    albedo = "specular_reflectance"

    def read(self, color, number) -> None:
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.reflectance * fresnel_conductor(wi[:, 2:].clamp(min=0.0), self.eta, self.k)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wo = wi * wi.new_tensor([-1.0, -1.0, 1.0])
        one = torch.ones_like(wo[:, 2])
        return BsdfSample(wo, torch.where(wi[:, 2] > 0, 1.0, 0.0).to(wi), one, torch.zeros(len(wi)).long())


class Dielectric(Bsdf):
    """Lobe 0 reflects, lobe 1 refracts."""

    albedo = "specular_transmittance"

    def read(self, color, number) -> None:
        self.eta = number("eta")
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r, _, _, eta_ti = fresnel_dielectric(wi[:, 2], self.eta)
        transmitted = (1 - r) * eta_ti * eta_ti
        reflects = (lobe == 0)[:, None]
        return torch.where(reflects, self.reflectance * r[:, None], self.transmittance * transmitted[:, None])

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        r, cos_t, eta_it, eta_ti = fresnel_dielectric(wi[:, 2], self.eta)
        reflects = u[:, 0] < r.detach()
        x, y, z = wi.unbind(1)
        mirrored = torch.stack([-x, -y, z], 1)
        refracted = torch.stack([-eta_ti * x, -eta_ti * y, cos_t], 1)
        return BsdfSample(
            torch.where(reflects[:, None], mirrored, refracted),
            torch.where(reflects, r, 1 - r).detach(),
            torch.where(reflects, 1.0, eta_it).detach(),
            (~reflects).long(),
        )


class Null(Bsdf):
    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(wi), self.channels, dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        one = torch.ones_like(wi[:, 2])
        return BsdfSample(-wi, one, one, torch.zeros(len(wi)).long())


class TwoSided:
    """Another BSDF on either side; seen from behind, directions are mirrored. See `resolve`."""


def resolve(world: World, bsdf: torch.Tensor, behind: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers of BSDFs (N,) with `twosided` replaced by what it holds; and where directions are mirrored."""
    leaf, mirrored = bsdf.clone(), torch.zeros_like(behind)
    for i, record in enumerate(world.records["bsdf"]):
        if record.type == "twosided":
            front, back = record.field["brdf_0"], record.field["brdf_1"]
            here = bsdf == i
            leaf = torch.where(here & behind, front if back < 0 else back, torch.where(here, front, leaf))
            mirrored = mirrored | (here & behind)
    return leaf, mirrored


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
    first, second = length + c2, 2 * cos_i * root(0.5 * (length + a))
    senkrecht = (first - second) / (first + second)
    third, fourth = length * c2 + s2 * s2, second * s2
    return 0.5 * (senkrecht + senkrecht * (third - fourth) / (third + fourth))


BSDFS = {"diffuse": Diffuse, "conductor": Conductor, "dielectric": Dielectric, "null": Null, "twosided": TwoSided}
