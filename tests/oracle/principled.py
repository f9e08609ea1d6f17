"""Burley's principled BSDF, part by part."""

from __future__ import annotations

import math

import torch

from .bsdf import Bsdf, BsdfSample, dot, fresnel_dielectric, luminance, normalized
from .geometry import root
from .numbers import cosine_hemisphere
from .rough import Facets

SCALARS = "roughness metallic spec_trans spec_tint sheen sheen_tint flatness clearcoat clearcoat_gloss".split()
COAT_ALPHA = 0.25


def schlick(cosine: torch.Tensor) -> torch.Tensor:
    return (1 - cosine).clamp(min=0.0) ** 5


def mix(a, b, t):
    return a + (b - a) * t


def diffuse(ni, no, d, roughness, flatness) -> torch.Tensor:
    """Diffuse reflection with retro-reflection, and its flat variant: Burley 2012, 5.3, and 2015, 4.3."""
    fi, fo, retro = schlick(ni), schlick(no), 2 * roughness * d.square()
    lambert = (1 - 0.5 * fi) * (1 - 0.5 * fo) + retro * (fo + fi + fo * fi * (retro - 1))
    flat = mix(1.0, retro / 2, fi) * mix(1.0, retro / 2, fo)
    return mix(lambert, 1.25 * (flat * (1 / (ni + no) - 0.5) + 0.5), flatness)


def hue_of(color: torch.Tensor) -> torch.Tensor:
    bright = luminance(color)[:, None]
    return torch.where(bright > 0, color / torch.where(bright > 0, bright, 1.0), 1.0)


class Principled(Bsdf):
    smooth, delta = True, False
    albedo = "base_color"

    def read(self, color, number) -> None:
        self.color = color("base_color")
        for name in SCALARS:
            setattr(self, name, self.scalar(name))
        eta, low = number("eta"), root(0.08 * number("specular"))
        self.eta = torch.where(eta > 0, eta, 2 / (1 - low) - 1)
        self.facets = Facets(self.roughness.square(), True)
        self.rates = [number(f"{name}_sampling_rate") for name in ("main_specular", "diffuse_reflectance", "clearcoat")]

    def coat_density(self, cos2: torch.Tensor) -> torch.Tensor:
        """Burley 2012, equation 4 with exponent 1."""
        a2 = mix(0.1, 0.001, self.clearcoat_gloss).square()
        return (a2 - 1) / (math.pi * torch.log(a2) * (1 + (a2 - 1) * cos2))

    def split(self, wi: torch.Tensor, wo: torch.Tensor):
        """Half vector, its cosines with both, relative index, reflectance of a facet; which directions are so."""
        outside, reflects = wi[:, 2] >= 0, wi[:, 2] * wo[:, 2] > 0
        eta = torch.where(outside, self.eta, 1 / self.eta)
        h = normalized(wi + wo * torch.where(reflects, 1.0, eta)[:, None])
        h = h * torch.sign(h[:, 2:])
        i, o = dot(wi, h), dot(wo, h)
        possible = (i * wi[:, 2] > 0) & (o * wo[:, 2] > 0)
        safe_i, safe_o = torch.where(possible, i, 1.0).abs(), torch.where(possible, o, 1.0).abs()
        senkrecht = (safe_i - eta * safe_o) / (safe_i + eta * safe_o)
        parallel = (safe_o - eta * safe_i) / (safe_o + eta * safe_i)
        refracted = 0.5 * (senkrecht.square() + parallel.square())
        fresnel = torch.where(reflects, fresnel_dielectric(0.5 * (i + o), self.eta)[0], refracted)
        return h, i, o, eta, fresnel, outside, reflects, possible

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        h, i, o, eta, fresnel, outside, reflects, possible = self.split(wi, wo)
        common = self.facets.density(h) * self.facets.masking(wi) * self.facets.masking(wo) / wi[:, 2].abs()
        dielectric, ni, no, d = 1 - self.metallic, wi[:, 2].abs(), wo[:, 2].abs(), 0.5 * (i + o).abs()
        clear, opaque = dielectric * self.spec_trans, dielectric * (1 - self.spec_trans)
        hue = hue_of(self.color)

        # what facets reflect above the surface: dielectric, metal, tinted dielectric
        inside = root(1 - (1 - d.square()) / eta.square())
        weight = schlick(torch.where(eta > 1, d, inside))[:, None]
        r0 = ((eta - 1) / (eta + 1)).square()[:, None]
        reflected = (dielectric * (1 - self.spec_tint) * fresnel)[:, None]
        reflected = reflected + self.metallic[:, None] * mix(self.color, 1.0, weight)
        reflected = reflected + (dielectric * self.spec_tint)[:, None] * mix(hue * r0, 1.0, weight)
        above = torch.where(possible[:, None], reflected * (common / 4)[:, None], 0.0)

        # diffuse base, sheen and clear coat
        above = (
            above + self.color * (opaque * no * diffuse(ni, no, d, self.roughness, self.flatness) / math.pi)[:, None]
        )
        tint = mix(1.0, hue, self.sheen_tint[:, None])
        above = above + tint * (self.sheen * dielectric * schlick(d) * no)[:, None]
        soft = Facets(torch.tensor(COAT_ALPHA, dtype=wi.dtype), True)
        coat = 0.25 * self.clearcoat * mix(0.04, 1.0, schlick(d)) * self.coat_density(h[:, 2].square())
        coat = coat * soft.masking(wi) * soft.masking(wo) * no
        above = above + torch.where(possible, coat, 0.0)[:, None]

        back = torch.where(possible, clear * fresnel * common / 4, 0.0)[:, None]
        through = clear * (1 - fresnel) * common * (i * o).abs() / (i + eta * o).square()
        below = root(self.color) * torch.where(possible, through, 0.0)[:, None]
        front = (outside & reflects)[:, None]
        return torch.where(front, above, torch.where(reflects[:, None], back, below))

    def chances(self, outside: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Of interface, base and clear coat; and the share of facets' light that may get through."""
        dielectric = 1 - self.metallic
        clear = dielectric * self.spec_trans
        main, base, coat = self.rates
        base = dielectric * (1 - self.spec_trans) * base
        coat = 0.25 * self.clearcoat * coat
        total = main + base + coat
        shares = (torch.where(outside, x / total, y) for x, y in ((main, 1.0), (base, 0.0), (coat, 0.0)))
        return *(s.detach() for s in shares), clear.detach()

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        h, i, o, eta, fresnel, outside, reflects, possible = self.split(wi, wo)
        main, base, coat, clear = self.chances(outside)
        mirrors = torch.where(outside, 1 - clear * (1 - fresnel), fresnel)
        visible = main * self.facets.density(h) * self.facets.masking(wi) * (i / wi[:, 2]).abs()
        refracted = visible * (1 - mirrors) * eta.square() * o.abs() / (i + eta * o).square()
        mirrored = visible * mirrors / (4 * o.abs())
        front = mirrored + base * wo[:, 2].abs() / math.pi
        front = front + coat * self.coat_density(h[:, 2].square()) * h[:, 2].abs() / (4 * o.abs())
        density = torch.where(reflects, torch.where(outside, front, mirrored), refracted)
        return torch.where(possible, density, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        outside = wi[:, 2] >= 0
        side = torch.where(outside, 1.0, -1.0)[:, None]
        main, base, _, clear = self.chances(outside)
        diffuse, coated = (u[:, 0] >= main) & (u[:, 0] < main + base), u[:, 0] >= main + base
        m = torch.where(coated[:, None], self.coat_normal(u), self.facets.visible_normal(wi * side, u)) * side
        i = dot(wi, m)
        fresnel, cos_t, eta_it, eta_ti = fresnel_dielectric(i * side[:, 0], self.eta)
        mirrors = torch.where(outside, 1 - clear * (1 - fresnel), fresnel)
        reflects = diffuse | coated | (u[:, 0] < main * mirrors)
        mirrored = 2 * i[:, None] * m - wi
        refracted = (eta_ti * i - cos_t.abs())[:, None] * m - eta_ti[:, None] * wi
        wo = torch.where(reflects[:, None], mirrored, refracted)
        wo = torch.where(diffuse[:, None], cosine_hemisphere(u[:, 1], u[:, 2]), wo).detach()
        right_side = ((wo[:, 2] * wi[:, 2] > 0) == reflects) & (diffuse | (i > 0))
        pdf = torch.where(right_side, self.pdf(wi, wo), 0.0)
        return BsdfSample(wo, pdf, torch.where(reflects, 1.0, eta_it).detach(), torch.zeros(len(wi)).long())

    def coat_normal(self, u: torch.Tensor) -> torch.Tensor:
        a2 = mix(0.1, 0.001, self.clearcoat_gloss).square().detach()
        sin2 = ((a2 ** u[:, 2] - a2) / (1 - a2)).clamp(0.0, 1.0)
        phi, sine = 2 * math.pi * u[:, 1], root(sin2)
        return torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), root(1 - sin2)], 1)


THIN = "roughness spec_trans eta spec_tint sheen sheen_tint flatness diff_trans".split()
RATES = [f"{a}_{b}_sampling_rate" for a in ("specular", "diffuse") for b in ("reflectance", "transmittance")]


class PrincipledThin(Bsdf):
    smooth, delta = True, False
    albedo = "base_color"

    def read(self, color, number) -> None:
        self.color = color("base_color")
        for name in THIN:
            setattr(self, name, self.scalar(name))
        self.rates = [number(name) for name in RATES]

    def facets(self, through: torch.Tensor) -> Facets:
        """Those seen through the sheet are as rough as if they refracted: Burley 2015, 5.3."""
        return Facets((self.roughness * torch.where(through, 0.65 * self.eta - 0.35, 1.0)).square(), True)

    def split(self, wi: torch.Tensor, wo: torch.Tensor):
        """Both directions above, the half vector of length 2 cos_d, and whether light goes through."""
        through = wi[:, 2] * wo[:, 2] < 0
        wi, wo = (torch.cat([v[:, :2], v[:, 2:].abs()], 1) for v in (wi, wo))
        return wi, wo, wi + wo, through

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        wi, wo, h, through = self.split(wi, wo)
        d, facets = 0.5 * h.norm(dim=1), self.facets(through)
        shiny = facets.density(normalized(h)) * facets.masking(wi) * facets.masking(wo) / (4 * wi[:, 2])
        shiny = self.spec_trans * shiny
        fresnel = fresnel_dielectric(d, self.eta)[0]
        hue, weight, r0 = hue_of(self.color), schlick(d)[:, None], ((self.eta - 1) / (self.eta + 1)).square()[:, None]
        reflected = mix(fresnel[:, None], mix(hue * r0, 1.0, weight), self.spec_tint[:, None]) * shiny[:, None]
        behind = wo * wo.new_tensor([1.0, 1.0, -1.0])
        transmitted = torch.where(dot(behind, h) < 0, (1 - fresnel) * shiny, 0.0)

        matt, part = (1 - self.spec_trans) * wo[:, 2], 0.5 * self.diff_trans
        front = matt * (1 - part)
        sheen = mix(1.0, hue, self.sheen_tint[:, None]) * (self.sheen * front * schlick(d))[:, None]
        front = front * diffuse(wi[:, 2], wo[:, 2], d, self.roughness, self.flatness) / math.pi
        above = self.color * front[:, None] + sheen + reflected
        below = self.color * (matt * part / math.pi + transmitted)[:, None]
        return torch.where(through[:, None], below, above)

    def chances(self, wi: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Of reflection and transmission by facets, and of both diffusely."""
        r = fresnel_dielectric(wi[:, 2].abs(), self.eta)[0].clamp(0.1, 0.9)
        shiny, part = self.spec_trans, 0.5 * self.diff_trans
        shares = (shiny * r, shiny * (1 - r), (1 - shiny) * (1 - part), (1 - shiny) * part)
        weights = [s * rate for s, rate in zip(shares, self.rates, strict=True)]
        return tuple((w / sum(weights)).detach() for w in weights)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        mirrored, transmitted, reflected, passed = self.chances(wi)
        wi, wo, h, through = self.split(wi, wo)
        facets = self.facets(through)
        visible = facets.density(normalized(h)) * facets.masking(wi) / (4 * wi[:, 2])
        shiny, matt = torch.where(through, transmitted, mirrored), torch.where(through, passed, reflected)
        return (shiny * visible + matt * wo[:, 2] / math.pi).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        mirrored, transmitted, reflected, _ = self.chances(wi)
        shiny = u[:, 0] < mirrored + transmitted
        through = (shiny & (u[:, 0] >= mirrored)) | (u[:, 0] >= mirrored + transmitted + reflected)
        seen = torch.cat([wi[:, :2], wi[:, 2:].abs()], 1).detach()
        m = self.facets(through).visible_normal(seen, u)
        cosine = cosine_hemisphere(u[:, 1], u[:, 2])
        wo = torch.where(shiny[:, None], 2 * dot(seen, m)[:, None] * m - seen, cosine)
        above = wo[:, 2] > 0
        z = torch.where(through, -wo[:, 2], wo[:, 2]) * torch.where(wi[:, 2] < 0, -1.0, 1.0)
        wo = torch.cat([wo[:, :2], z[:, None]], 1).detach()
        one = torch.ones_like(z)
        return BsdfSample(wo, torch.where(above, self.pdf(wi, wo), 0.0), one, torch.zeros(len(wi)).long())
