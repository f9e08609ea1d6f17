"""BSDFs of microfacets. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007."""

from __future__ import annotations

import math

import torch

from torchrender.surface import dot, normalize
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe
from torchrender.wavefront.geometry import reattach, root
from torchrender.wavefront.world import Record

from .. import mueller
from .common import (
    Polarised,
    Polarising,
    above,
    at_least,
    fresnel_conductor,
    fresnel_dielectric,
    reflectance,
    upper,
    upright,
)

LEAST_ALPHA = 1e-3


class Microfacets:
    """Microfacets of the roughness alpha, () or (N,), that along x if there is another along y."""

    def __init__(self, alpha: torch.Tensor, ggx: bool, across: torch.Tensor | None = None) -> None:
        self.alpha, self.ggx = at_least(alpha, LEAST_ALPHA), ggx
        self.across = self.alpha if across is None else at_least(across, LEAST_ALPHA)

    def density(self, h: torch.Tensor) -> torch.Tensor:
        """D(h), equations 33 and 25."""
        x, y, cos2 = h[:, 0] / self.alpha, h[:, 1] / self.across, h[:, 2].square()
        area, slope2 = math.pi * self.alpha * self.across, x * x + y * y
        if self.ggx:
            return 1 / (area * (slope2 + cos2).square())
        cos2 = cos2.clamp(min=1e-8)
        return torch.exp(-slope2 / cos2) / (area * cos2.square())

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """G1(v), equations 34 and 26."""
        z = v[:, 2].abs()
        projected_roughness2 = (self.alpha * v[:, 0]).square() + (self.across * v[:, 1]).square()
        if self.ggx:
            return 2 * z / (z + root(z * z + projected_roughness2))
        projected_roughness = torch.sqrt(projected_roughness2.clamp(min=1e-20))
        a = z / projected_roughness
        return 2 * z / (2 * z + projected_roughness * (torch.exp(-a * a) / math.sqrt(math.pi) - a * torch.erfc(a)))

    def visible_normal(self, wi: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """GGX: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023."""
        alpha, across, wi = self.alpha.detach(), self.across.detach(), wi.detach()
        stretch = torch.stack([alpha, across, torch.ones_like(alpha)], -1)
        w = normalize(wi * stretch)
        if self.ggx:
            phi, z = 2 * math.pi * u[:, 1], (1 - u[:, 2]) * (1 + w[:, 2]) - w[:, 2]
            r = root(u[:, 2] * (1 + w[:, 2]) * (1 + z))
            return normalize((torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1) + w) * stretch)
        sine = root((w[:, :2] * w[:, :2]).sum(1))
        tilted = sine > 1e-15
        along, across = visible_slope(sine, w[:, 2], u[:, 1]), torch.erfinv((2 * u[:, 2] - 1).clamp(-MOST, MOST))
        c, s = (torch.where(tilted, w[:, i] / torch.where(tilted, sine, 1.0), 1.0 - i) for i in (0, 1))
        x, y = c * along - s * across, s * along + c * across
        return normalize(torch.stack([-x, -y, torch.ones_like(x)], 1) * stretch)


MOST = 1 - 2e-7


def visible_slope(sine: torch.Tensor, cosine: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Slopes along the direction that a Beckmann surface of roughness 1 is seen from.

    Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals", EGSR 2014,
    inverted by bisection.
    """

    def visible_below(x: torch.Tensor) -> torch.Tensor:
        return math.sqrt(math.pi) * cosine * torch.erfc(-x) + sine * torch.exp(-x * x)

    low, high = torch.full_like(sine, -7.0), (cosine / sine.clamp(min=1e-10)).clamp(max=7.0)
    target = u * visible_below(high)
    for _ in range(60 if sine.dtype == torch.float64 else 30):
        middle = 0.5 * (low + high)
        below = visible_below(middle) < target
        low, high = torch.where(below, middle, low), torch.where(below, high, middle)
    return low


class MicrofacetReflection:
    """Reflection off microfacets from wi to wo; only above the surface is it `possible`, elsewhere numbers are finite.

    `cosine`: of either direction on the facet; `pdf`: with which `reflect` takes wo; `value`: density times masking,
    equation 20 without Fresnel's reflectance, times the cosine.
    """

    def __init__(self, microfacets: Microfacets, wi: torch.Tensor, wo: torch.Tensor) -> None:
        h = wi + wo
        self.possible = above(wi, wo) & (dot(h, h) > 1e-20)
        wi, wo = upright(self.possible, wi, wo)
        h = wi + wo
        length = torch.sqrt(dot(h, h))
        self.cosine = 0.5 * length
        self.pdf = microfacets.density(h / length[:, None]) * microfacets.masking(wi) / (4 * wi[:, 2])
        self.value = self.pdf * microfacets.masking(wo)


def reflect(microfacets: Microfacets, wi: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3) into which microfacets seen from wi reflect; below the horizon they are no samples."""
    seen = upper(wi.detach())
    m = microfacets.visible_normal(seen, u)
    return normalize(2 * dot(seen, m)[:, None] * m - seen)


def off_facets(wi: torch.Tensor, wo: torch.Tensor, index: torch.Tensor) -> Polarised:
    """Of reflection from wi to wo by facets of this index (N or 1, C or 1)."""
    cosine = torch.sqrt(0.5 + 0.5 * dot(wi, wo))[:, None]  # of half the angle
    return torch.linalg.cross(wi + wo, wi), mueller.reflection(cosine, index)


class DielectricMicrofacet:
    """Those between wi and wo, which they reflect (`reflects`) or refract, wi being above the surface (`outside`).

    `h`: their normals; `i`, `o`: cosines of both directions; `eta`: the relative index along wi; `fresnel`: what is
    reflected. Where there is no such facet (not `possible`) numbers are finite.
    """

    def __init__(self, index: torch.Tensor, wi: torch.Tensor, wo: torch.Tensor) -> None:
        self.outside, self.reflects = wi[:, 2] >= 0, wi[:, 2] * wo[:, 2] > 0
        self.eta = torch.where(self.outside, index, 1 / index)
        bent = torch.where(self.reflects, 1.0, self.eta)[:, None]
        h = normalize(wi + wo * bent)
        h = h * torch.where(h[:, 2:] < 0, -1.0, 1.0).to(h)
        self.possible = (dot(wi, h) * wi[:, 2] > 0) & (dot(wo, h) * wo[:, 2] > 0)
        self.wi, self.wo, self.h = upright(self.possible, wi, wo, h)
        self.i, self.o = dot(self.wi, self.h), dot(self.wo, self.h)
        # By both cosines (of refraction Snell's law holds), as in C++: lines do not start at the very point that was
        # hit, and unequal functions off the unit sphere would have derivatives unequal by so much.
        reflected = fresnel_dielectric(0.5 * (self.i + self.o), index)[0]
        self.fresnel = torch.where(self.reflects, reflected, reflectance(self.i.abs(), self.o.abs(), self.eta))
        bound = torch.where(self.reflects | ~self.possible, 1.0, self.i + self.eta * self.o)
        self.stretch = (self.i * self.o).abs() / bound.square()  # of refraction, equation 21

    def value(self, microfacets: Microfacets) -> torch.Tensor:
        """What equations 20 and 21 have in common, times the cosine of wo."""
        common = microfacets.density(self.h) * microfacets.masking(self.wi) * microfacets.masking(self.wo)
        return common / self.wi[:, 2].abs()


def clamp_eta(eta: torch.Tensor) -> torch.Tensor:
    """Without an interface nothing would be scattered: an index within 0.001 of 1 counts as that far from it."""
    value = eta.detach().clamp(min=1e-3)
    value = torch.where(value < 1, value.clamp(max=1 - 1e-3), value.clamp(min=1 + 1e-3))
    return reattach(value, eta)


class MicrofacetBsdf(Bsdf):
    """What models with the parameters alpha and distribution share."""

    def read_microfacets(self) -> Microfacets:
        names = ("alpha_u", "alpha_v") if self.oriented(self.record) else ("alpha",)
        alpha, *across = (self.scalar(name) for name in names)
        return Microfacets(alpha, self.record.field["distribution"] == 1, *across)


class RoughConductor(Polarising, MicrofacetBsdf):
    """Microfacets of a metal."""

    def read(self, color: Color, number: Color) -> None:
        self.microfacets = self.read_microfacets()
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        r = MicrofacetReflection(self.microfacets, wi, wo)
        fresnel = fresnel_conductor(r.cosine[:, None], self.eta, self.k)
        return torch.where(r.possible[:, None], self.reflectance * fresnel * r.value[:, None], 0.0)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        r = MicrofacetReflection(self.microfacets, wi, wo)
        return torch.where(r.possible, r.pdf, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wo = reflect(self.microfacets, wi, u)
        return one_lobe(wo, self.pdf(wi, wo))

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        return off_facets(wi, wo, self.eta - 1j * self.k)


class AnisotropicConductor(RoughConductor):
    """The same with two roughnesses, along both directions of the texture coordinates."""

    @classmethod
    def oriented(cls, record: Record) -> bool:
        return True


class RoughDielectric(Polarising, MicrofacetBsdf):
    """Microfacets that reflect and refract."""

    def read(self, color: Color, number: Color) -> None:
        self.eta, self.microfacets = clamp_eta(number("eta")), self.read_microfacets()
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        """Equations 20 and 21, the second for radiance."""
        f = DielectricMicrofacet(self.eta, wi, wo)
        value = torch.where(f.reflects, f.fresnel / 4, (1 - f.fresnel) * f.stretch) * f.value(self.microfacets)
        value = torch.where(f.possible, value, 0.0)[:, None]
        return torch.where(f.reflects[:, None], self.reflectance, self.transmittance) * value

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """Equations 14, 17 and 24."""
        f = DielectricMicrofacet(self.eta, wi, wo)
        chance = torch.where(f.reflects, f.fresnel / 4, (1 - f.fresnel) * f.stretch * f.eta.square())
        visible = self.microfacets.density(f.h) * self.microfacets.masking(f.wi) / f.wi[:, 2].abs()
        return torch.where(f.possible, visible * chance, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        m = self.microfacets.visible_normal(wi * torch.where(wi[:, 2:] < 0, -1.0, 1.0).to(wi), u)
        i = dot(wi, m)
        fresnel, cos_t, eta_it, eta_ti = fresnel_dielectric(i, self.eta)
        reflects = u[:, 0] < fresnel
        along = wi - i[:, None] * m
        wo = m * torch.where(reflects, i, cos_t)[:, None] - along * torch.where(reflects, 1.0, eta_ti)[:, None]
        wo = normalize(wo)
        right_side = (wo[:, 2] * wi[:, 2] > 0) == reflects
        return one_lobe(wo, torch.where(right_side, self.pdf(wi, wo), 0.0), torch.where(reflects, 1.0, eta_it))

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        f = DielectricMicrofacet(self.eta, wi, wo)
        c, m = dot(wi, f.h).abs()[:, None], f.eta[:, None]
        matrix = torch.where(f.reflects[:, None, None, None], mueller.reflection(c, m), mueller.refraction(c, m))
        return torch.linalg.cross(f.h, wi), matrix


class AnisotropicDielectric(RoughDielectric):
    """The same with two roughnesses, along both directions of the texture coordinates."""

    @classmethod
    def oriented(cls, record: Record) -> bool:
        return True
