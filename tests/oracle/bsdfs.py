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

BISECTIONS = 90


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


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(1)


def normalized(v: torch.Tensor) -> torch.Tensor:
    return v / v.norm(dim=1, keepdim=True)


class RoughDielectric(Bsdf):
    """Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007."""

    smooth = True
    albedo = "specular_transmittance"

    def __init__(self, world: World, record: Record, at: At) -> None:
        super().__init__(world, record, at)
        self.ggx = record.field["distribution"] == 1

    def read(self, color, number) -> None:
        self.eta, self.alpha = number("eta"), number("alpha")
        self.reflectance, self.transmittance = color("specular_reflectance"), color("specular_transmittance")

    def density(self, h: torch.Tensor) -> torch.Tensor:
        """D(h), equations 33 and 25."""
        cos2, a2 = h[:, 2].square(), self.alpha.square()
        tan2 = (1 - cos2) / cos2
        if self.ggx:
            return a2 / (math.pi * cos2.square() * (a2 + tan2).square())
        return torch.exp(-tan2 / a2) / (math.pi * a2 * cos2.square())

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """G1(v), equations 34 and 26."""
        cotangent = v[:, 2].abs() / v[:, :2].norm(dim=1)
        if self.ggx:
            return 2 / (1 + root(1 + (self.alpha / cotangent).square()))
        a = cotangent / self.alpha
        return 2 / (2 + torch.exp(-a * a) / (a * math.sqrt(math.pi)) - torch.erfc(a))

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
        common = self.density(h) * self.masking(wi) * self.masking(wo) / wi[:, 2].abs()
        i, o = dot(wi, h), dot(wo, h)
        mirrored = fresnel * common / 4
        refracted = (1 - fresnel) * common * (i * o).abs() / (i + eta * o).square()
        mirrored, refracted = (torch.where(possible, f, 0.0)[:, None] for f in (mirrored, refracted))
        return torch.where(reflects[:, None], self.reflectance * mirrored, self.transmittance * refracted)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        """Equations 14, 17 and 24."""
        h, eta, fresnel, reflects, possible = self.split(wi, wo)
        i, o = dot(wi, h), dot(wo, h)
        visible = self.density(h) * self.masking(wi) * (i / wi[:, 2]).abs()
        refracted = (1 - fresnel) * eta.square() * o.abs() / (i + eta * o).square()
        density = visible * torch.where(reflects, fresnel / (4 * o.abs()), refracted)
        return torch.where(possible, density, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        m = self.visible_normal(wi * torch.where(wi[:, 2:] < 0, -1.0, 1.0), u)
        i = dot(wi, m)
        fresnel, cos_t, eta_it, eta_ti = fresnel_dielectric(i, self.eta)
        reflects = u[:, 0] < fresnel
        mirrored = 2 * i[:, None] * m - wi
        refracted = (eta_ti * i + cos_t)[:, None] * m - eta_ti[:, None] * wi
        wo = torch.where(reflects[:, None], mirrored, refracted).detach()
        right_side = (wo[:, 2] * wi[:, 2] > 0) == reflects
        pdf = torch.where(right_side, self.pdf(wi, wo), 0.0)
        return BsdfSample(wo, pdf, torch.where(reflects, 1.0, eta_it).detach(), torch.zeros(len(wi)).long())

    def visible_normal(self, wi: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """GGX: Dupuy and Benyoub, HPG 2023. Beckmann: Heitz and d'Eon, EGSR 2014, inverted by bisection."""
        stretch = torch.stack([self.alpha, self.alpha, torch.ones_like(self.alpha)])
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
        return normalized(torch.stack([-self.alpha * x, -self.alpha * y, torch.ones_like(x)], 1))


BSDFS = {
    "diffuse": Diffuse,
    "conductor": Conductor,
    "dielectric": Dielectric,
    "roughdielectric": RoughDielectric,
    "null": Null,
    "twosided": TwoSided,
}
