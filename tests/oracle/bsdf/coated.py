"""Diffuse bases under an interface."""

from __future__ import annotations

import math

import torch

from torchrender.warp import cosine_hemisphere
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe

from .. import mueller
from .common import Part, Polarised, Polarising, above, fresnel_dielectric, mirrored
from .rough import MicrofacetReflection, Microfacets, off_facets, reflect
from .rough_transmittance import COSINES, rough_transmittance


def diffuse_fresnel(eta: torch.Tensor) -> torch.Tensor:
    """What an interface reflects of diffuse light: Egan and Hilgeman 1973 below 1, d'Eon and Irving 2011 above."""
    below = 0.0636 / eta + 0.6681 + 0.7099 * eta - 1.4399 * eta.square()
    c = (0.919317, -3.4793, 6.75335, -7.80989, 4.98554, -1.36881)
    beyond = torch.stack([x * eta**-i for i, x in enumerate(c)]).sum(0)
    return torch.where(eta < 1, below, beyond)


def specular_sampling_weight(
    reflected: torch.Tensor | float, specular: torch.Tensor, diffuse: torch.Tensor
) -> torch.Tensor:
    """How often the coating is sampled (N,), of which light this much is `reflected`, instead of the base."""
    coat, base = reflected * specular.abs().amax(1), (1 - reflected) * diffuse.abs().amax(1)
    some = coat + base > 0
    return torch.where(some, coat / torch.where(some, coat + base, 1.0), 0.5).clamp(0.1, 0.9).detach()


TURNED = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))  # by 90 degrees


def below_coat(eta: torch.Tensor, wi: torch.Tensor, wo: torch.Tensor) -> Polarised:
    """Of a base below a smooth interface: along the normal, which is across the axis of Fresnel's equations.

    The base forgets what polarisation arrives.
    """
    index = eta.reshape(1, 1).to(torch.complex128)
    inside = mueller.refracted(wi[:, 2:], index) / index
    into, out = mueller.refraction(wo[:, 2:], index), mueller.refraction(inside.real, 1 / index)
    return wi.new_tensor([0.0, 0.0, 1.0]).expand_as(wi), TURNED @ out @ mueller.DEPOLARISER @ into @ TURNED


class RoughlyCoated(Polarising, Bsdf):
    """Microfacets over a diffuse base: two lobes that go the same ways."""

    eta: torch.Tensor

    def lobes(self, wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Values (N, C) of the coat and of the base."""
        raise NotImplementedError

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        coat, base = self.lobes(wi, wo)
        return coat + base

    def parts(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> list[Part]:
        coat, base = self.lobes(wi, wo)
        some = coat + base > 0
        share = torch.where(some, coat / torch.where(some, coat + base, 1.0), 1.0)
        return [(share, *off_facets(wi, wo, self.eta.reshape(1, 1))), (1 - share, *below_coat(self.eta, wi, wo))]


class Coated(Bsdf):
    """A diffuse base below a dielectric coating."""

    def read(self, color: Color, number: Color) -> None:
        self.eta, self.nonlinear = number("eta"), self.record.field["nonlinear"] == 1
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")

    def base(self, internal: torch.Tensor) -> torch.Tensor:
        """What leaves the base (N, C) of light that enters it, by the share that is reflected inside."""
        return self.diffuse / (1 - (self.diffuse * internal if self.nonlinear else internal))


class Plastic(Polarising, Coated):
    """Lobe 0 is the diffuse base, lobe 1 the mirror reflection."""

    delta = True

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        axis, base = below_coat(self.eta, wi, wo)
        coat = TURNED @ mueller.reflection(wi[:, 2:], self.eta.reshape(1, 1)) @ TURNED
        return axis, torch.where((lobe != 0)[:, None, None, None], coat, base)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        reflected = fresnel_dielectric(wi[:, 2], self.eta)[0]
        through = (1 - reflected) * (1 - fresnel_dielectric(wo[:, 2], self.eta)[0])
        base = self.base(diffuse_fresnel(1 / self.eta))
        base = base * (through * wo[:, 2] / (math.pi * self.eta.square()))[:, None]
        mirror = torch.where(wi[:, 2:] > 0, self.specular * reflected[:, None], 0.0)
        return torch.where((lobe != 0)[:, None], mirror, torch.where(above(wi, wo)[:, None], base, 0.0))

    def specular_probability(self, wi: torch.Tensor) -> torch.Tensor:
        """Of sampling the mirror reflection."""
        return specular_sampling_weight(fresnel_dielectric(wi[:, 2], self.eta)[0], self.specular, self.diffuse)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.where(above(wi, wo), (1 - self.specular_probability(wi)) * wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        p = self.specular_probability(wi)
        mirrors = u[:, 0] < p
        cosine = cosine_hemisphere(u[:, 1], u[:, 2])
        pdf = torch.where(mirrors, p, (1 - p) * cosine[:, 2] / math.pi)
        wo = torch.where(mirrors[:, None], mirrored(wi), cosine)
        return BsdfSample(wo, torch.where(wi[:, 2] > 0, pdf, 0.0), torch.ones_like(p), mirrors.long())


class RoughPlastic(RoughlyCoated, Coated):
    """A coating of microfacets, of which one roughness applies everywhere."""

    def read(self, color: Color, number: Color) -> None:
        super().read(color, number)
        ggx, alpha = self.record.field["distribution"] == 1, number("alpha")
        self.microfacets = Microfacets(alpha, ggx)
        self.internal, self.table = rough_transmittance(self.world, self.record, self.eta, self.microfacets.alpha, ggx)

    def transmittance(self, cosine: torch.Tensor) -> torch.Tensor:
        x = cosine.clamp(0, 1) * (COSINES - 1)
        cell = x.detach().floor().clamp(max=COSINES - 2).long()
        low, high = self.table.index_select(0, cell), self.table.index_select(0, cell + 1)
        return low + (x - cell) * (high - low)

    def lobes(self, wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        r = MicrofacetReflection(self.microfacets, wi, wo)
        coat = self.specular * (r.value * fresnel_dielectric(r.cosine, self.eta)[0])[:, None]
        through = self.transmittance(wi[:, 2]) * self.transmittance(wo[:, 2]) * wo[:, 2] / math.pi / self.eta.square()
        base, possible = self.base(self.internal) * through[:, None], r.possible[:, None]
        return torch.where(possible, coat, 0.0), torch.where(possible, base, 0.0)

    def specular_probability(self, wi: torch.Tensor) -> torch.Tensor:
        """Of sampling the coating."""
        return specular_sampling_weight(1 - self.transmittance(wi[:, 2]), self.specular, self.diffuse)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        p, r = self.specular_probability(wi), MicrofacetReflection(self.microfacets, wi, wo)
        return torch.where(r.possible, p * r.pdf + (1 - p) * wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        coat = (u[:, 0] < self.specular_probability(wi))[:, None]
        wo = torch.where(coat, reflect(self.microfacets, wi, u), cosine_hemisphere(u[:, 1], u[:, 2]))
        return one_lobe(wo, self.pdf(wi, wo))


class PPlastic(RoughlyCoated):
    """Microfacets that reflect, and diffuse light through a smooth interface."""

    def read(self, color: Color, number: Color) -> None:
        self.eta = number("eta")
        self.microfacets = Microfacets(self.scalar("alpha"), self.record.field["distribution"] == 1)
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")

    def lobes(self, wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        r = MicrofacetReflection(self.microfacets, wi, wo)
        coat = self.specular * (r.value * fresnel_dielectric(r.cosine, self.eta)[0])[:, None]
        entering, leaving = (1 - fresnel_dielectric(w[:, 2], self.eta)[0] for w in (wi, wo))
        base, possible = self.diffuse * (entering * leaving * wo[:, 2] / math.pi)[:, None], r.possible[:, None]
        return torch.where(possible, coat, 0.0), torch.where(possible, base, 0.0)

    def specular_probability(self, wi: torch.Tensor) -> torch.Tensor:
        """Of sampling the microfacets."""
        return specular_sampling_weight(fresnel_dielectric(wi[:, 2], self.eta)[0], self.specular, self.diffuse)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        p, r = self.specular_probability(wi), MicrofacetReflection(self.microfacets, wi, wo)
        return torch.where(r.possible, p * r.pdf + (1 - p) * wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        mirrors = (u[:, 0] < self.specular_probability(wi))[:, None]
        wo = torch.where(mirrors, reflect(self.microfacets, wi, u), cosine_hemisphere(u[:, 1], u[:, 2]))
        return one_lobe(wo, self.pdf(wi, wo))
