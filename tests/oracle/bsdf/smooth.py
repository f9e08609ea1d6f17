"""The BSDFs whose shape is simple."""

from __future__ import annotations

import math

import torch

from torchrender.warp import cosine_hemisphere
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe

from .common import Delta, above, fresnel_conductor, fresnel_dielectric, mirrored


class Diffuse(Bsdf):
    """Lambertian reflection."""

    def read(self, color: Color, number: Color) -> None:
        self.reflectance = color("reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.reflectance * torch.where(above(wi, wo), wo[:, 2] / math.pi, 0.0)[:, None]

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.where(above(wi, wo), wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wo = cosine_hemisphere(u[:, 1], u[:, 2])
        return one_lobe(wo, torch.where(wi[:, 2] > 0, wo[:, 2] / math.pi, 0.0))


class Conductor(Delta):
    """A smooth metal."""

    def read(self, color: Color, number: Color) -> None:
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.reflectance * fresnel_conductor(wi[:, 2:].clamp(min=0.0), self.eta, self.k)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(mirrored(wi), torch.where(wi[:, 2] > 0, 1.0, 0.0).to(wi))


class Dielectric(Delta):
    """Lobe 0 reflects, lobe 1 refracts."""

    def read(self, color: Color, number: Color) -> None:
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
        x, y, _ = wi.unbind(1)
        refracted = torch.stack([-eta_ti * x, -eta_ti * y, cos_t], 1)
        return BsdfSample(
            torch.where(reflects[:, None], mirrored(wi), refracted),
            torch.where(reflects, r, 1 - r).detach(),
            torch.where(reflects, 1.0, eta_it).detach(),
            (~reflects).long(),
        )


class DispersiveDielectric(Delta):
    """Lobe 0 reflects, each component by its own index; lobe 3 refracts all of them as the first."""

    def read(self, color: Color, number: Color) -> None:
        self.eta = color("eta").expand(-1, self.channels)
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r, _, _, eta_ti = fresnel_dielectric(wi[:, 2:].expand_as(self.eta), self.eta)
        return torch.where((lobe == 0)[:, None], self.reflectance * r, self.transmittance * (1 - r) * eta_ti**2)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        r, cos_t, eta_it, eta_ti = fresnel_dielectric(wi[:, 2], self.eta[:, 0])
        reflects = u[:, 0] < r.detach()
        refracted = torch.stack([-eta_ti * wi[:, 0], -eta_ti * wi[:, 1], cos_t], 1)
        return BsdfSample(
            torch.where(reflects[:, None], mirrored(wi), refracted),
            torch.where(reflects, r, 1 - r).detach(),
            torch.where(reflects, 1.0, eta_it).detach(),
            torch.where(reflects, 0, 3),
        )


class ThinDielectric(Dielectric):
    """Lobe 0 reflects, lobe 1 goes straight on."""

    def reflected(self, wi: torch.Tensor) -> torch.Tensor:
        """Of the light that interreflects between both faces."""
        r = fresnel_dielectric(wi[:, 2].abs(), self.eta)[0]
        return 2 * r / (1 + r)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r = self.reflected(wi)[:, None]
        return torch.where((lobe == 0)[:, None], self.reflectance * r, self.transmittance * (1 - r))

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        r = self.reflected(wi).detach()
        reflects = u[:, 0] < r
        wo = torch.where(reflects[:, None], mirrored(wi), -wi)
        return BsdfSample(wo, torch.where(reflects, r, 1 - r), torch.ones_like(r), (~reflects).long())


class Plate(Delta):
    """A plate that polarises: of unpolarised light a share passes."""

    share = 0.5

    def read(self, color: Color, number: Color) -> None:
        self.transmittance = color("transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.share * self.transmittance.expand(len(wi), self.channels)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(-wi, torch.ones_like(wi[:, 2]))


class Retarder(Plate):
    """Nothing is lost."""

    share = 1.0


class Null(Delta):
    """No surface at all: rays pass unchanged."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(wi), self.channels, dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(-wi, torch.ones_like(wi[:, 2]))
