"""The BSDFs whose shape is simple."""

from __future__ import annotations

import math

import torch

from torchrender.warp import cosine_hemisphere
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe
from torchrender.wavefront.world import Record

from .. import mueller
from .common import Delta, Polarised, Polarising, above, fresnel_conductor, fresnel_dielectric, mirrored


def s_axis(wi: torch.Tensor) -> torch.Tensor:
    """Across the plane of incidence (N, 3)."""
    return torch.linalg.cross(wi.new_tensor([0.0, 0.0, 1.0]).expand_as(wi), wi)


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


class Conductor(Polarising, Delta):
    """A smooth metal."""

    def read(self, color: Color, number: Color) -> None:
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.reflectance * fresnel_conductor(wi[:, 2:].clamp(min=0.0), self.eta, self.k)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(mirrored(wi), torch.where(wi[:, 2] > 0, 1.0, 0.0).to(wi))

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        return s_axis(wi), mueller.reflection(wi[:, 2:], self.eta - 1j * self.k)


class Dielectric(Polarising, Delta):
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

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        c, eta = wi[:, 2:].abs(), self.eta.reshape(-1, 1) if self.eta.ndim < 2 else self.eta
        m = torch.where(wi[:, 2:] >= 0, eta, 1 / eta)
        reflects = (lobe == 0)[:, None, None, None]
        return s_axis(wi), torch.where(reflects, mueller.reflection(c, m), mueller.refraction(c, m))


class DispersiveDielectric(Dielectric):
    """Lobe 0 reflects, each component by its own index; lobe 3 refracts all of them as the first."""

    def read(self, color: Color, number: Color) -> None:
        self.eta = color("eta").expand(-1, self.channels)
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r, _, _, eta_ti = fresnel_dielectric(wi[:, 2:].expand_as(self.eta), self.eta)
        return torch.where((lobe == 0)[:, None], self.reflectance * r, self.transmittance * (1 - r) * eta_ti**2)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        _, cos_t, eta_it, eta_ti = fresnel_dielectric(wi[:, 2], self.eta[:, 0])
        r = self.chance(fresnel_dielectric(wi[:, 2:].expand_as(self.eta), self.eta)[0].detach())
        reflects = u[:, 0] < r
        refracted = torch.stack([-eta_ti * wi[:, 0], -eta_ti * wi[:, 1], cos_t], 1)
        return BsdfSample(
            torch.where(reflects[:, None], mirrored(wi), refracted),
            torch.where(reflects, r, 1 - r),
            torch.where(reflects, 1.0, eta_it).detach(),
            torch.where(reflects, 0, 3),
        )

    def chance(self, reflectances: torch.Tensor) -> torch.Tensor:
        """Of reflection (N,)."""
        return reflectances[:, 0]


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

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        reflected, passed = mueller.pane(wi[:, 2:].abs(), self.eta.reshape(-1, 1))
        return s_axis(wi), torch.where((lobe == 0)[:, None, None, None], reflected, passed)


class Plate(Polarising, Delta):
    """A plate that polarises: of unpolarised light a share passes."""

    share = 0.5

    @classmethod
    def oriented(cls, record: Record) -> bool:
        return True

    def read(self, color: Color, number: Color) -> None:
        self.transmittance = color("transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.share * self.transmittance.expand(len(wi), self.channels)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(-wi, torch.ones_like(wi[:, 2]))


class Polarizer(Plate):
    """It absorbs what is along one axis, as the ray sees that: Korger et al., Optics Express 21(22), 2013."""

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        theta = torch.deg2rad(self.scalar("theta"))
        absorbed = torch.stack([torch.sin(theta), torch.cos(theta), 0 * theta], 1)
        one = torch.ones(1, 1, dtype=wi.dtype)
        return absorbed, mueller.amplitudes(0 * one, one)


class Retarder(Plate):
    """Nothing is lost. What is across the fast axis lags."""

    share = 1.0

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        theta, delta = (torch.deg2rad(self.scalar(name)) for name in ("theta", "delta"))
        fast = torch.stack([torch.cos(theta), torch.sin(theta), 0 * theta], 1)
        delta = delta[:, None]
        return fast, mueller.amplitudes(torch.ones_like(delta), torch.exp(-1j * delta))


class CircularPolarizer(Plate):
    """Light of one hand passes, along x +- i y."""

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        state = torch.tensor([1, -1j if self.record.field["left_handed"] else 1j], dtype=torch.complex128)
        return wi, mueller.mueller(torch.outer(state, state.conj()) / 2)[None, None]


class Null(Polarising, Delta):
    """No surface at all: rays pass unchanged."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(wi), self.channels, dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(-wi, torch.ones_like(wi[:, 2]))

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        return wi, torch.eye(4, dtype=wi.dtype)[None, None]
