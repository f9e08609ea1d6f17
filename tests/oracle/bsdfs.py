"""The BSDFs whose shape is simple, those around others, and the list of all."""

from __future__ import annotations

import math

import torch

from .bsdf import Bsdf, BsdfSample, fresnel_conductor, fresnel_dielectric
from .coated import Plastic, RoughPlastic
from .numbers import cosine_hemisphere
from .principled import Principled, PrincipledThin
from .redner import RednerMaterial
from .rough import AnisotropicConductor, AnisotropicDielectric, RoughConductor, RoughDielectric
from .world import World


class Diffuse(Bsdf):
    smooth, delta = True, False
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


class ThinDielectric(Dielectric):
    """Lobe 0 reflects, lobe 1 goes straight on."""

    def reflected(self, wi: torch.Tensor) -> torch.Tensor:
        """Of the light that is thrown to and fro between both faces."""
        r = fresnel_dielectric(wi[:, 2].abs(), self.eta)[0]
        return 2 * r / (1 + r)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r = self.reflected(wi)[:, None]
        return torch.where((lobe == 0)[:, None], self.reflectance * r, self.transmittance * (1 - r))

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        r = self.reflected(wi).detach()
        reflects = u[:, 0] < r
        wo = wi * torch.where(reflects[:, None], wi.new_tensor([-1, -1, 1]), wi.new_tensor([-1, -1, -1]))
        return BsdfSample(wo, torch.where(reflects, r, 1 - r), torch.ones_like(r), (~reflects).long())


class Hole(Null):
    """What is met of a `mask` where it is not."""


class Layer:
    """Gives way to a BSDF that it holds; see layers.py."""


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


BSDFS = {
    "diffuse": Diffuse,
    "conductor": Conductor,
    "dielectric": Dielectric,
    "roughdielectric": RoughDielectric,
    "roughconductor": RoughConductor,
    "anisotropicconductor": AnisotropicConductor,
    "anisotropicdielectric": AnisotropicDielectric,
    "plastic": Plastic,
    "roughplastic": RoughPlastic,
    "thindielectric": ThinDielectric,
    "principled": Principled,
    "principledthin": PrincipledThin,
    "redner": RednerMaterial,
    "null": Null,
    "mask": Hole,
    "twosided": Layer,
    "blendbsdf": Layer,
    "normalmap": Layer,
    "bumpmap": Layer,
}
LAYERS = ("twosided", "blendbsdf", "mask", "normalmap", "bumpmap")
