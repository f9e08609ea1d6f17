"""BSDFs of microscopic facets."""

from __future__ import annotations

import math

import torch

from .bsdf import Bsdf, BsdfSample, dot, fresnel_conductor, fresnel_dielectric, normalized
from .geometry import root

BISECTIONS = 90


class Facets:
    """Microscopic facets of the roughness alpha, () or (N,), that along x if there is another along y. Walter et al.,
    "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007."""

    def __init__(self, alpha: torch.Tensor, ggx: bool, across: torch.Tensor | None = None) -> None:
        self.alpha, self.across, self.ggx = alpha, alpha if across is None else across, ggx

    def density(self, h: torch.Tensor) -> torch.Tensor:
        """D(h), equations 33 and 25."""
        cos2, area = h[:, 2].square(), math.pi * self.alpha * self.across
        slope2 = ((h[:, 0] / self.alpha).square() + (h[:, 1] / self.across).square()) / cos2
        if self.ggx:
            return 1 / (area * cos2.square() * (1 + slope2).square())
        return torch.exp(-slope2) / (area * cos2.square())

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """G1(v), equations 34 and 26."""
        spread = torch.stack([self.alpha * v[:, 0], self.across * v[:, 1]], 1).norm(dim=1)
        a = v[:, 2].abs() / spread
        if self.ggx:
            return 2 / (1 + root(1 + 1 / a.square()))
        return 2 / (2 + torch.exp(-a * a) / (a * math.sqrt(math.pi)) - torch.erfc(a))

    def visible_normal(self, wi: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """GGX: Dupuy and Benyoub, HPG 2023. Beckmann: Heitz and d'Eon, EGSR 2014, inverted by bisection."""
        alpha, across = self.alpha.detach(), self.across.detach()
        stretch = torch.stack([alpha, across, torch.ones_like(alpha)], -1)
        w = normalized(wi * stretch)
        if self.ggx:
            phi, z = 2 * math.pi * u[:, 1], (1 - u[:, 2]) * (1 + w[:, 2]) - w[:, 2]
            r = root(1 - z * z)
            return normalized((torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1) + w) * stretch)
        sin, cos = w[:, :2].norm(dim=1), w[:, 2]

        def visible_below(x: torch.Tensor) -> torch.Tensor:
            return math.sqrt(math.pi) * cos * torch.erfc(-x) + sin * torch.exp(-x * x)

        low, high = torch.full_like(sin, -7.0), (cos / sin).clamp(max=7.0)
        target = u[:, 1] * visible_below(high)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            below = visible_below(middle) < target
            low, high = torch.where(below, middle, low), torch.where(below, high, middle)
        slope = torch.stack([low, torch.erfinv(2 * u[:, 2] - 1)], 1)
        c, s = (w[:, :2] / sin[:, None]).unbind(1)
        x, y = c * slope[:, 0] - s * slope[:, 1], s * slope[:, 0] + c * slope[:, 1]
        return normalized(torch.stack([-alpha * x, -across * y, torch.ones_like(x)], 1))


class OfFacets(Bsdf):
    smooth, delta = True, False

    def read_facets(self) -> Facets:
        names = ("alpha_u", "alpha_v") if self.oriented else ("alpha",)
        alpha, *across = (self.scalar(name) for name in names)
        return Facets(alpha, self.record.field["distribution"] == 1, *across)


class RoughConductor(OfFacets):
    albedo = "specular_reflectance"

    def read(self, color, number) -> None:
        self.facets = self.read_facets()
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def visible(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """D(h) G1(wi) / |cos_i|, 0 where one direction is below the surface."""
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        h = normalized(wi + torch.where(above[:, None], wo, wi))
        return torch.where(above, self.facets.density(h) * self.facets.masking(wi) / wi[:, 2], 0.0)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        """Equation 20."""
        value = self.visible(wi, wo) * self.facets.masking(wo) / 4
        cosine = 0.5 * (wi + wo).norm(dim=1, keepdim=True)
        return self.reflectance * fresnel_conductor(cosine, self.eta, self.k) * value[:, None]

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return (self.visible(wi, wo) / 4).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        seen = torch.cat([wi[:, :2], wi[:, 2:].abs()], 1).detach()
        m = self.facets.visible_normal(seen, u)
        wo = 2 * dot(seen, m)[:, None] * m - seen
        return BsdfSample(wo, self.pdf(wi, wo), torch.ones_like(wo[:, 2]), torch.zeros(len(wi)).long())


class AnisotropicConductor(RoughConductor):
    oriented = True


class RoughDielectric(OfFacets):
    albedo = "specular_transmittance"

    def read(self, color, number) -> None:
        self.eta = number("eta")
        self.facets = self.read_facets()
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def split(self, wi: torch.Tensor, wo: torch.Tensor):
        """Half vectors, relative index along the ray, what is reflected by a facet, and which directions are so."""
        reflects = wi[:, 2] * wo[:, 2] > 0
        eta = torch.where(wi[:, 2] >= 0, self.eta, 1 / self.eta)
        h = normalized(wi + wo * torch.where(reflects, 1.0, eta)[:, None])
        h = h * torch.sign(h[:, 2:])
        i, o = dot(wi, h), dot(wo, h)
        possible = (i * wi[:, 2] > 0) & (o * wo[:, 2] > 0)
        # By both cosines (of refraction Snell's law holds), as in C++: lines do not start at the very point that was
        # hit, and unequal functions off the unit sphere would have derivatives unequal by so much.
        safe_i, safe_o = torch.where(possible, i, 1.0).abs(), torch.where(possible, o, 1.0).abs()
        senkrecht = (safe_i - eta * safe_o) / (safe_i + eta * safe_o)
        parallel = (safe_o - eta * safe_i) / (safe_o + eta * safe_i)
        refracted = 0.5 * (senkrecht.square() + parallel.square())
        fresnel = torch.where(reflects, fresnel_dielectric(0.5 * (i + o), self.eta)[0], refracted)
        return h, eta, fresnel, reflects, possible

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        """Equations 20 and 21, the second for radiance."""
        h, eta, fresnel, reflects, possible = self.split(wi, wo)
        common = self.facets.density(h) * self.facets.masking(wi) * self.facets.masking(wo) / wi[:, 2].abs()
        i, o = dot(wi, h), dot(wo, h)
        mirrored = fresnel * common / 4
        refracted = (1 - fresnel) * common * (i * o).abs() / (i + eta * o).square()
        mirrored, refracted = (torch.where(possible, f, 0.0)[:, None] for f in (mirrored, refracted))
        return torch.where(reflects[:, None], self.reflectance * mirrored, self.transmittance * refracted)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """Equations 14, 17 and 24."""
        h, eta, fresnel, reflects, possible = self.split(wi, wo)
        i, o = dot(wi, h), dot(wo, h)
        visible = self.facets.density(h) * self.facets.masking(wi) * (i / wi[:, 2]).abs()
        refracted = (1 - fresnel) * eta.square() * o.abs() / (i + eta * o).square()
        density = visible * torch.where(reflects, fresnel / (4 * o.abs()), refracted)
        return torch.where(possible, density, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        m = self.facets.visible_normal(wi * torch.where(wi[:, 2:] < 0, -1.0, 1.0), u)
        i = dot(wi, m)
        fresnel, cos_t, eta_it, eta_ti = fresnel_dielectric(i, self.eta)
        reflects = u[:, 0] < fresnel
        mirrored = 2 * i[:, None] * m - wi
        refracted = (eta_ti * i + cos_t)[:, None] * m - eta_ti[:, None] * wi
        wo = torch.where(reflects[:, None], mirrored, refracted).detach()
        right_side = (wo[:, 2] * wi[:, 2] > 0) == reflects
        pdf = torch.where(right_side, self.pdf(wi, wo), 0.0)
        return BsdfSample(wo, pdf, torch.where(reflects, 1.0, eta_it).detach(), torch.zeros(len(wi)).long())


class AnisotropicDielectric(RoughDielectric):
    oriented = True
