"""Burley's principled BSDF, part by part.

"Physically Based Shading at Disney", 2012, and "Extending the Disney BRDF to a BSDF with Integrated Subsurface
Scattering", 2015.
"""

from __future__ import annotations

import math

import torch

from torchrender.surface import dot, normalize
from torchrender.warp import cosine_hemisphere
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe
from torchrender.wavefront.color import luminance
from torchrender.wavefront.geometry import reattach, root
from torchrender.wavefront.world import Record

from .common import at_least, fresnel_dielectric, upper
from .rough import LEAST_ALPHA, DielectricMicrofacet, MicrofacetReflection, Microfacets, clamp_eta, reflect

COAT_ALPHA = 0.25


def schlick(cosine: torch.Tensor) -> torch.Tensor:
    """Schlick's factor of the Fresnel term."""
    return (1 - cosine).clamp(min=0.0) ** 5


def mix(a: torch.Tensor | float, b: torch.Tensor | float, t: torch.Tensor) -> torch.Tensor:
    """Linear interpolation from a, at t = 0, to b."""
    return a + (b - a) * t


def diffuse(
    ni: torch.Tensor, no: torch.Tensor, d: torch.Tensor, roughness: torch.Tensor, flatness: torch.Tensor
) -> torch.Tensor:
    """Diffuse reflection with retro-reflection, and its flat variant: 2012, 5.3, and 2015, 4.3."""
    fi, fo, retro = schlick(ni), schlick(no), 2 * roughness * d.square()
    lambert = (1 - 0.5 * fi) * (1 - 0.5 * fo) + retro * (fo + fi + fo * fi * (retro - 1))
    flat = mix(1.0, retro / 2, fi) * mix(1.0, retro / 2, fo)
    return mix(lambert, 1.25 * (flat * (1 / (ni + no) - 0.5) + 0.5), flatness)


def hue_of(color: torch.Tensor) -> torch.Tensor:
    """Colours (N, C) at luminance 1; black counts as white."""
    bright = luminance(color)[:, None]
    return torch.where(bright > 0, color / torch.where(bright > 0, bright, 1.0), 1.0)


class OfBurley(Bsdf):
    """The parameters that both principled models have."""

    scalars = "roughness spec_trans spec_tint sheen sheen_tint flatness"
    roughness: torch.Tensor
    spec_trans: torch.Tensor
    spec_tint: torch.Tensor
    sheen: torch.Tensor
    sheen_tint: torch.Tensor
    flatness: torch.Tensor

    @classmethod
    def oriented(cls, record: Record) -> bool:
        return record.field["anisotropic"] >= 0

    def read(self, color: Color, number: Color) -> None:
        self.color = color("base_color")
        for name in self.scalars.split():
            setattr(self, name, self.scalar(name))
        self.anisotropic = self.scalar("anisotropic") if self.oriented(self.record) else None

    def microfacets_of(self, roughness: torch.Tensor) -> Microfacets:
        """2012, 5.4."""
        alpha = roughness.square()
        if self.anisotropic is None:
            return Microfacets(alpha, True)
        aspect = torch.sqrt(at_least(1 - 0.9 * self.anisotropic, 0.1))
        alpha = reattach(torch.maximum(alpha, LEAST_ALPHA / aspect).detach(), alpha)
        return Microfacets(alpha / aspect, True, alpha * aspect)


class Principled(OfBurley):
    """Dielectric, metal, diffuse base, sheen and clear coat: 2012, and 2015, 5.1."""

    scalars = OfBurley.scalars + " metallic clearcoat clearcoat_gloss"
    metallic: torch.Tensor
    clearcoat: torch.Tensor
    clearcoat_gloss: torch.Tensor

    def read(self, color: Color, number: Color) -> None:
        super().read(color, number)
        eta, low = number("eta"), root(0.08 * number("specular"))
        self.eta = clamp_eta(torch.where(eta > 0, eta, 2 / (1 - low) - 1))
        self.microfacets = self.microfacets_of(self.roughness)
        self.soft = Microfacets(self.color.new_tensor(COAT_ALPHA), True)
        self.rates = [number(f"{name}_sampling_rate") for name in ("main_specular", "diffuse_reflectance", "clearcoat")]

    def coat_density(self, cos2: torch.Tensor) -> torch.Tensor:
        """2012, equation 4 with exponent 1."""
        a2 = mix(0.1, 0.001, self.clearcoat_gloss).square()
        return (a2 - 1) / (math.pi * torch.log(a2) * (1 + (a2 - 1) * cos2))

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        f = DielectricMicrofacet(self.eta, wi, wo)
        common, eta, fresnel = f.value(self.microfacets), f.eta, f.fresnel
        dielectric, ni, no, d = 1 - self.metallic, f.wi[:, 2].abs(), f.wo[:, 2].abs(), 0.5 * (f.i + f.o).abs()
        clear, opaque = dielectric * self.spec_trans, dielectric * (1 - self.spec_trans)
        hue = hue_of(self.color)

        # what microfacets reflect above the surface: dielectric, metal, tinted dielectric
        inside = root(1 - (1 - d.square()) / eta.square())
        weight = schlick(torch.where(eta > 1, d, inside))[:, None]
        r0 = ((eta - 1) / (eta + 1)).square()[:, None]
        reflected = (dielectric * (1 - self.spec_tint) * fresnel)[:, None]
        reflected = reflected + self.metallic[:, None] * mix(self.color, 1.0, weight)
        reflected = reflected + (dielectric * self.spec_tint)[:, None] * mix(hue * r0, 1.0, weight)
        front = reflected * (common / 4)[:, None]

        # diffuse base, sheen and clear coat
        base = opaque * no * diffuse(ni, no, d, self.roughness, self.flatness) / math.pi
        front = front + self.color * base[:, None]
        tint = mix(1.0, hue, self.sheen_tint[:, None])
        front = front + tint * (self.sheen * dielectric * schlick(d) * no)[:, None]
        coat = 0.25 * self.clearcoat * mix(0.04, 1.0, schlick(d)) * self.coat_density(f.h[:, 2].square())
        front = front + (coat * self.soft.masking(f.wi) * self.soft.masking(f.wo) * no)[:, None]

        back = (clear * fresnel * common / 4)[:, None]
        below = root(self.color) * (clear * (1 - fresnel) * common * f.stretch)[:, None]
        value = torch.where((f.outside & f.reflects)[:, None], front, torch.where(f.reflects[:, None], back, below))
        return torch.where(f.possible[:, None], value, 0.0)

    def lobe_probabilities(self, outside: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Of interface, base and clear coat; and the share of microfacets' light that may get through."""
        clear, dielectric = self.spec_trans.clamp(0, 1), 1 - self.metallic.clamp(0, 1)
        main, base, coat = self.rates
        base = dielectric * (1 - clear) * base
        coat = 0.25 * self.clearcoat.clamp(0, 1) * coat
        total = main + base + coat
        some = outside & (total > 0)
        total = torch.where(some, total, 1.0)
        shares = (torch.where(some, x / total, y) for x, y in ((main, 1.0), (base, 0.0), (coat, 0.0)))
        return *(s.detach() for s in shares), (dielectric * clear).detach()

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        f = DielectricMicrofacet(self.eta, wi, wo)
        main, base, coat, clear = self.lobe_probabilities(f.outside)
        mirrors = torch.where(f.outside, 1 - clear * (1 - f.fresnel), f.fresnel)
        visible = main * self.microfacets.density(f.h) * self.microfacets.masking(f.wi) / f.wi[:, 2].abs()
        refracted = visible * (1 - mirrors) * f.eta.square() * f.stretch
        mirrored = visible * mirrors / 4
        front = mirrored + base * f.wo[:, 2].abs() / math.pi
        front = front + coat * self.coat_density(f.h[:, 2].square()) * f.h[:, 2].abs() / (4 * f.o.abs())
        density = torch.where(f.reflects, torch.where(f.outside, front, mirrored), refracted)
        return torch.where(f.possible, density, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        outside = wi[:, 2] >= 0
        side = torch.where(outside, 1.0, -1.0).to(wi)[:, None]
        main, base, _, clear = self.lobe_probabilities(outside)
        diffuse, coated = (u[:, 0] >= main) & (u[:, 0] < main + base), u[:, 0] >= main + base
        m = torch.where(coated[:, None], self.coat_normal(u), self.microfacets.visible_normal(wi * side, u)) * side
        i = dot(wi, m)
        fresnel, cos_t, eta_it, eta_ti = fresnel_dielectric(i.abs() * side[:, 0], self.eta)
        mirrors = torch.where(outside, 1 - clear * (1 - fresnel), fresnel)
        reflects = diffuse | coated | (u[:, 0] < main * mirrors)
        along = wi - i[:, None] * m
        bent = m * torch.where(reflects, i, -cos_t.abs())[:, None]
        bent = normalize(bent - along * torch.where(reflects, 1.0, eta_ti)[:, None])
        wo = torch.where(diffuse[:, None], cosine_hemisphere(u[:, 1], u[:, 2]), bent)
        right_side = ((wo[:, 2] * wi[:, 2] > 0) == reflects) & (diffuse | (i > 0))
        return one_lobe(wo, torch.where(right_side, self.pdf(wi, wo), 0.0), torch.where(reflects, 1.0, eta_it))

    def coat_normal(self, u: torch.Tensor) -> torch.Tensor:
        a2 = mix(0.1, 0.001, self.clearcoat_gloss).square()
        sin2 = ((a2 ** u[:, 2] - a2) / (1 - a2)).clamp(0.0, 1.0)
        phi, sine = 2 * math.pi * u[:, 1], root(sin2)
        return torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), root(1 - sin2)], 1)


class PrincipledThin(OfBurley):
    """A thin sheet, which light passes without being refracted: 2015, 5.3."""

    scalars = OfBurley.scalars + " eta diff_trans"
    eta: torch.Tensor
    diff_trans: torch.Tensor

    def read(self, color: Color, number: Color) -> None:
        super().read(color, number)
        self.eta = self.eta.clamp(min=1e-3)
        names = (f"{a}_{b}_sampling_rate" for a in ("specular", "diffuse") for b in ("reflectance", "transmittance"))
        self.rates = [number(name) for name in names]

    def microfacets(self, through: torch.Tensor) -> Microfacets:
        """Those seen through the sheet are as rough as if they refracted: 2015, 5.3."""
        return self.microfacets_of(self.roughness * torch.where(through, 0.65 * self.eta - 0.35, 1.0))

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        through = wi[:, 2] * wo[:, 2] < 0
        wi, wo = upper(wi), upper(wo)
        r = MicrofacetReflection(self.microfacets(through), wi, wo)
        d, shiny = r.cosine, self.spec_trans * r.value
        fresnel = fresnel_dielectric(d, self.eta)[0]
        hue, weight, r0 = hue_of(self.color), schlick(d)[:, None], ((self.eta - 1) / (self.eta + 1)).square()[:, None]
        reflected = mix(fresnel[:, None], mix(hue * r0, 1.0, weight), self.spec_tint[:, None]) * shiny[:, None]
        # light comes out only where the far side of the facet is seen, although it is a mirror that sends it there
        seen = dot(wo * wo.new_tensor([1.0, 1.0, -1.0]), wi + wo) < 0
        transmitted = torch.where(seen, (1 - fresnel) * shiny, 0.0)

        ni, no = (torch.where(r.possible, v[:, 2], 1.0) for v in (wi, wo))
        matt, part = (1 - self.spec_trans) * no, 0.5 * self.diff_trans
        front = matt * (1 - part)
        sheen = mix(1.0, hue, self.sheen_tint[:, None]) * (self.sheen * front * schlick(d))[:, None]
        front = front * diffuse(ni, no, d, self.roughness, self.flatness) / math.pi
        above = self.color * front[:, None] + sheen + reflected
        below = self.color * (matt * part / math.pi + transmitted)[:, None]
        return torch.where(r.possible[:, None], torch.where(through[:, None], below, above), 0.0)

    def lobe_probabilities(self, wi: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Of reflection and transmission by microfacets, and of both diffusely."""
        r = fresnel_dielectric(wi[:, 2].abs(), self.eta)[0].clamp(0.1, 0.9)
        shiny, part = self.spec_trans.clamp(0, 1), 0.5 * self.diff_trans.clamp(0, 2)
        shares = (shiny * r, shiny * (1 - r), (1 - shiny) * (1 - part), (1 - shiny) * part)
        weights = [s * rate for s, rate in zip(shares, self.rates, strict=True)]
        total = torch.stack(weights).sum(0)
        some = total > 0
        total = torch.where(some, total, 1.0)
        nothing = (0.0, 0.0, 1.0, 0.0)
        return tuple(torch.where(some, w / total, x).detach() for w, x in zip(weights, nothing, strict=True))

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        mirrored, transmitted, reflected, passed = self.lobe_probabilities(wi)
        through = wi[:, 2] * wo[:, 2] < 0
        r = MicrofacetReflection(self.microfacets(through), upper(wi), upper(wo))
        shiny, matt = torch.where(through, transmitted, mirrored), torch.where(through, passed, reflected)
        return torch.where(r.possible, shiny * r.pdf + matt * wo[:, 2].abs() / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        mirrored, transmitted, reflected, _ = self.lobe_probabilities(wi)
        shiny = u[:, 0] < mirrored + transmitted
        through = (shiny & (u[:, 0] >= mirrored)) | (u[:, 0] >= mirrored + transmitted + reflected)
        cosine = cosine_hemisphere(u[:, 1], u[:, 2])
        wo = torch.where(shiny[:, None], reflect(self.microfacets(through), wi, u), cosine)
        above = wo[:, 2] > 0
        z = torch.where(through, -wo[:, 2], wo[:, 2]) * torch.where(wi[:, 2] < 0, -1.0, 1.0).to(wi)
        wo = torch.cat([wo[:, :2], z[:, None]], 1)
        return one_lobe(wo, torch.where(above, self.pdf(wi, wo), 0.0))
