"""BSDFs at points of a wavefront: native models once more as tensor operations, and those that users write.

Directions are local, +z along the shading normal, and point away from the surface; values include the cosine. Of a
smooth model a detached direction is sampled; a delta model's direction is an attached function of `wi` and of the
model's parameters, and its `eval` is the attached weight of the lobe that was chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from ..errors import describe
from ..scene.torch_bsdf import SurfaceInteraction, TorchBSDF
from ..surface import dot, normalize
from .geometry import root
from .numbers import cosine_hemisphere
from .world import At, Record, World

Color = Callable[[str], torch.Tensor]
LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass
class BsdfSample:
    """Directions (N, 3), their density or the probability of the lobe (N,), 0 where there is none; the relative index
    of refraction along the new ray; the number of the lobe."""

    wo: torch.Tensor
    pdf: torch.Tensor
    eta: torch.Tensor
    lobe: torch.Tensor


class Bsdf:
    """A BSDF with its parameters at N points. Of `si` only models take notice that are written by users."""

    delta: ClassVar[bool] = False  # has delta lobes, else a density

    def __init__(self, world: World, record: Record, at: At, si: SurfaceInteraction) -> None:
        self.world, self.record, self.channels = world, record, world.channels

        def color(name: str) -> torch.Tensor:
            return world.color("bsdf", record, name, at)

        self.read(color, lambda name: world.tensor("bsdf", record, name))

    def read(self, color: Color, number: Color) -> None:
        """Take the parameters: colours at the points (N, C), single numbers ()."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(wi), dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        raise NotImplementedError


def luminance(color: torch.Tensor) -> torch.Tensor:
    """Of colours (N, C): (N,)."""
    return color[:, 0] if color.shape[1] == 1 else (color * color.new_tensor(LUMINANCE)).sum(1)


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
    larger = root(0.5 * (length + a.abs()))
    # The smaller of two numbers whose product is eta k and whose squares differ by a: differentiable at eta = 0.
    real = torch.where(a < 0, eta * k / torch.where(a < 0, larger, 1.0), larger)
    first, second = length + c2, 2 * cos_i * real
    senkrecht = (first - second) / (first + second)
    third, fourth = length * c2 + s2 * s2, second * s2
    return 0.5 * (senkrecht + senkrecht * (third - fourth) / (third + fourth))


def one_lobe(wo: torch.Tensor, pdf: torch.Tensor) -> BsdfSample:
    """Samples that are all of lobe 0 and go through no interface."""
    return BsdfSample(wo, pdf, torch.ones_like(pdf), torch.zeros(len(wo), dtype=torch.int64))


class Diffuse(Bsdf):
    def read(self, color: Color, number: Color) -> None:
        self.reflectance = color("reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return self.reflectance * torch.where(above, wo[:, 2] / math.pi, 0.0)[:, None]

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.where((wi[:, 2] > 0) & (wo[:, 2] > 0), wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wo = cosine_hemisphere(u[:, 1], u[:, 2])
        return one_lobe(wo, torch.where(wi[:, 2] > 0, wo[:, 2] / math.pi, 0.0))


class Conductor(Bsdf):
    delta = True

    def read(self, color: Color, number: Color) -> None:
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.reflectance * fresnel_conductor(wi[:, 2:].clamp(min=0.0), self.eta, self.k)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(wi * wi.new_tensor([-1.0, -1.0, 1.0]), torch.where(wi[:, 2] > 0, 1.0, 0.0).to(wi))


class Facets:
    """Microscopic facets of the roughness alpha (N,). Walter et al., "Microfacet Models for Refraction through Rough
    Surfaces", EGSR 2007."""

    BISECTIONS = 40

    def __init__(self, alpha: torch.Tensor, ggx: bool) -> None:
        self.alpha, self.ggx = alpha, ggx

    def density(self, h: torch.Tensor) -> torch.Tensor:
        """D(h), equations 33 and 25."""
        cos2, a2 = h[:, 2].square(), self.alpha.square()
        tan2 = (1 - cos2).clamp(min=0.0) / cos2
        if self.ggx:
            return a2 / (math.pi * cos2.square() * (a2 + tan2).square())
        return torch.exp(-tan2 / a2) / (math.pi * a2 * cos2.square())

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """G1(v), equations 34 and 26."""
        sine = root((v[:, :2] * v[:, :2]).sum(1)).clamp(min=1e-7)
        a = v[:, 2].abs() / (sine * self.alpha)
        if self.ggx:
            return 2 / (1 + torch.sqrt(1 + 1 / a.square()))
        return 2 / (2 + torch.exp(-a * a) / (a * math.sqrt(math.pi)) - torch.erfc(a))

    def visible_normal(self, wi: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """GGX: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023. Beckmann: Heitz and
        d'Eon, "Importance Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals", EGSR 2014,
        inverted by bisection."""
        stretch = torch.stack([self.alpha, self.alpha, torch.ones_like(self.alpha)], -1)
        w = normalize(wi * stretch)
        if self.ggx:
            phi, z = 2 * math.pi * u[:, 1], (1 - u[:, 2]) * (1 + w[:, 2]) - w[:, 2]
            r = root(1 - z * z)
            return normalize((torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1) + w) * stretch)
        sine, cosine = root((w[:, :2] * w[:, :2]).sum(1)).clamp(min=1e-7), w[:, 2]

        def visible_below(x: torch.Tensor) -> torch.Tensor:
            return math.sqrt(math.pi) * cosine * torch.erfc(-x) + sine * torch.exp(-x * x)

        low, high = torch.full_like(sine, -7.0), (cosine / sine).clamp(max=7.0)
        target = u[:, 1] * visible_below(high)
        for _ in range(self.BISECTIONS):
            middle = 0.5 * (low + high)
            below = visible_below(middle) < target
            low, high = torch.where(below, middle, low), torch.where(below, high, middle)
        across = torch.erfinv((2 * u[:, 2] - 1).clamp(-1 + 1e-7, 1 - 1e-7))
        c, s = (w[:, :2] / sine[:, None]).unbind(1)
        x, y = c * low - s * across, s * low + c * across
        return normalize(torch.stack([-self.alpha * x, -self.alpha * y, torch.ones_like(x)], 1))


class RoughConductor(Bsdf):
    def read(self, color: Color, number: Color) -> None:
        self.facets = Facets(luminance(color("alpha")).clamp(min=1e-3), self.record.field["distribution"] == 1)
        self.eta, self.k, self.reflectance = color("eta"), color("k"), color("specular_reflectance")

    def lit(self, wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Where both directions are above the surface; and directions that are so everywhere, with derivatives that are
        finite."""
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        up = wi.new_tensor([0.0, 0.0, 1.0])
        return above, torch.where(above[:, None], wi, up), torch.where(above[:, None], wo, up)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        """Equation 20."""
        above, wi, wo = self.lit(wi, wo)
        masking = self.facets.masking(wi) * self.facets.masking(wo)
        value = self.facets.density(normalize(wi + wo)) * masking / (4 * wi[:, 2])
        cosine = 0.5 * torch.linalg.vector_norm(wi + wo, dim=1, keepdim=True)
        fresnel = fresnel_conductor(cosine.clamp(max=1.0), self.eta, self.k)
        return torch.where(above[:, None], self.reflectance * fresnel * value[:, None], 0.0)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        above, wi, wo = self.lit(wi, wo)
        density = self.facets.density(normalize(wi + wo)) * self.facets.masking(wi) / (4 * wi[:, 2])
        return torch.where(above, density, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        seen = torch.cat([wi[:, :2], wi[:, 2:].abs()], 1)
        m = self.facets.visible_normal(seen, u)
        wo = 2 * dot(seen, m)[:, None] * m - seen
        return one_lobe(wo, self.pdf(wi, wo))


class Dielectric(Bsdf):
    """Lobe 0 reflects, lobe 1 refracts."""

    delta = True

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
        x, y, z = wi.unbind(1)
        mirrored = torch.stack([-x, -y, z], 1)
        refracted = torch.stack([-eta_ti * x, -eta_ti * y, cos_t], 1)
        return BsdfSample(
            torch.where(reflects[:, None], mirrored, refracted),
            torch.where(reflects, r, 1 - r).detach(),
            torch.where(reflects, 1.0, eta_it).detach(),
            (~reflects).long(),
        )


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
        mirrored, straight = wi.new_tensor([-1.0, -1.0, 1.0]), wi.new_tensor([-1.0, -1.0, -1.0])
        wo = wi * torch.where(reflects[:, None], mirrored, straight)
        return BsdfSample(wo, torch.where(reflects, r, 1 - r), torch.ones_like(r), (~reflects).long())


class Null(Bsdf):
    delta = True

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(wi), self.channels, dtype=wi.dtype)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        return one_lobe(-wi, torch.ones_like(wi[:, 2]))


class Written(Bsdf):
    """A `TorchBSDF`, what it returns looked at."""

    def __init__(self, world: World, record: Record, at: At, si: SurfaceInteraction) -> None:
        self.world, self.path, self.si, self.channels = world, record.path, si, world.channels
        self.module: TorchBSDF = world.torch_bsdfs[record.field["row"]]

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        value = self._checked("eval", self.module.eval(self.si, wi, wo), (len(wi), self.channels))
        if not bool(torch.isfinite(value.detach()).all()):
            self.world.note_nonfinite(f"{self.path}: eval")
        return value

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return self._density("pdf", self.module.pdf(self._plain(), wi.detach(), wo.detach()), len(wi))

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        with torch.no_grad():
            found: Any = self.module.sample(self._plain(), wi.detach(), u[:, :3])
            if not isinstance(found, tuple) or len(found) != 2:
                raise TypeError(f"{self.path}: sample: expected a pair (wo, pdf) of tensors, got {describe(found)}")
            wo = self._checked("sample: wo", found[0], (len(wi), 3))
            pdf = self._density("sample: pdf", found[1], len(wi))
            off = torch.where(pdf > 0, (dot(wo, wo) - 1).abs(), 0.0)
            if bool((off > 1e-3).any()):
                length = float(torch.linalg.vector_norm(wo[off.argmax()]))
                raise ValueError(f"{self.path}: sample: wo: expected unit vectors, got one of length {length:.4g}")
            return one_lobe(wo, pdf)

    def _plain(self) -> SurfaceInteraction:
        return SurfaceInteraction(*(t.detach() for t in self.si))

    def _checked(self, what: str, found: Any, shape: tuple[int, ...]) -> torch.Tensor:
        if not isinstance(found, torch.Tensor):
            raise TypeError(f"{self.path}: {what}: expected a tensor of shape {shape}, got {describe(found)}")
        if tuple(found.shape) != shape or not found.is_floating_point():
            raise ValueError(
                f"{self.path}: {what}: expected floating-point numbers of shape {shape}, got {describe(found)}"
            )
        return found.to(self.world.dtype)

    def _density(self, what: str, found: Any, n: int) -> torch.Tensor:
        pdf = self._checked(what, found, (n,))
        if not bool(torch.isfinite(pdf).all()):
            self.world.note_nonfinite(f"{self.path}: {what}")
            return torch.where(torch.isfinite(pdf), pdf, math.nan)
        if bool((pdf < 0).any()):
            raise ValueError(
                f"{self.path}: {what}: expected densities that are not negative, got {float(pdf.min()):.4g}"
            )
        return pdf


class TwoSided(Bsdf):
    """Another BSDF on either side; seen from behind, directions are mirrored. See `resolve`."""


BSDFS: dict[str, type[Bsdf]] = {
    "diffuse": Diffuse,
    "conductor": Conductor,
    "roughconductor": RoughConductor,
    "dielectric": Dielectric,
    "thindielectric": ThinDielectric,
    "null": Null,
    "twosided": TwoSided,
    "torch": Written,
}


def resolve(world: World, bsdf: torch.Tensor, behind: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers of BSDFs (N,) with `twosided` replaced by what it holds; and where directions are mirrored."""
    leaf, mirrored = bsdf.clone(), torch.zeros_like(behind)
    for i, record in enumerate(world.records["bsdf"]):
        if record.type == "twosided":
            front, back = record.field["brdf_0"], record.field["brdf_1"]
            here = bsdf == i
            leaf = torch.where(here & behind, front if back < 0 else back, torch.where(here, front, leaf))
            mirrored = mirrored | (here & behind)
        elif record.type == "torch" and world.torch_bsdfs[i].two_sided:
            mirrored = mirrored | ((bsdf == i) & behind)
    return leaf, mirrored
