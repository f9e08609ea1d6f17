"""Hair. Chiang, Bitterli, Tappan and Burley, "A Practical and Controllable Hair and Fur Model for Production Path
Tracing", EGSR 2016; d'Eon, Francois, Hill, Letteri and Aubry, "An Energy-Conserving Hair Reflectance Model", EGSR 2011.
"""

from __future__ import annotations

import math

import torch

from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe
from torchrender.wavefront.geometry import reattach, root

from .common import at_least, fresnel_dielectric

TILTS, WIDTHS = (-2.0, 1.0, 4.0, 0.0), (1.0, 0.25, 4.0, 4.0)
LEAST_ROUGHNESS = 1e-3


def within(x: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """Numbers that count as the nearer end where they are out of a range, with the derivative there."""
    return reattach(x.detach().clamp(low, high), x)


def logistic(x: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
    """The logistic density of the deviation s, wrapped and normalised over (-pi, pi)."""
    x = x - (2 * math.pi * torch.round(x / (2 * math.pi))).detach()
    return 1 / (4 * s * torch.cosh(0.5 * x / s).square() * torch.tanh(0.5 * math.pi / s))


class Hair(Bsdf):
    """A fibre along y: reflected off it, through it, reflected inside once, and more often."""

    @classmethod
    def oriented(cls, record: object) -> bool:
        return True

    def read(self, color: Color, number: Color) -> None:
        pigments = [self.scalar(name)[:, None] * color(f"{name}_absorption") for name in ("eumelanin", "pheomelanin")]
        self.absorption = at_least(number("scale") * color("sigma_a") + pigments[0] + pigments[1], 0.0)
        self.eta = within(number("eta"), 1.0, 1e3)
        along = within(number("longitudinal_roughness"), LEAST_ROUGHNESS, 1.0)
        across = within(number("azimuthal_roughness"), LEAST_ROUGHNESS, 1.0)
        variance = (0.726 * along + 0.812 * along**2 + 3.7 * along**20).square()
        self.variances = [variance * width for width in WIDTHS]
        self.deviation = math.sqrt(math.pi / 8) * (0.265 * across + 1.194 * across**2 + 5.372 * across**22)
        self.tilts = [torch.deg2rad(number("scale_tilt")) * tilt for tilt in TILTS]

    def bessel(self, x: torch.Tensor) -> torch.Tensor:
        """exp(-x) I_0(x)."""
        return torch.special.i0e(x)

    def tilted(self, wi: torch.Tensor, tilt: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Sine and cosine of the inclination."""
        sine, cosine = wi[:, 1], root(wi[:, 0].square() + wi[:, 2].square())
        return (
            sine * torch.cos(tilt) + cosine * torch.sin(tilt),
            (cosine * torch.cos(tilt) - sine * torch.sin(tilt)).abs(),
        )

    def refracted(self, wi: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Azimuth inside, length of the way through, and what is reflected, each (N,)."""
        x, y, z = wi.unbind(1)
        bravais2 = self.eta.square() - y.square()
        height = root(bravais2 - x.square())
        return torch.atan2(x, height), 2 * self.eta * height / bravais2, fresnel_dielectric(z.abs(), self.eta)[0]

    def attenuations(self, t: torch.Tensor, reflected: torch.Tensor) -> list[torch.Tensor]:
        """Of the lobes; the last is all that is left."""
        once = (1 - reflected).square() * t
        twice = once * t * reflected
        return [reflected.expand_as(t), once, twice, twice * t * reflected / (1 - t * reflected)]

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        gamma, path, reflected = self.refracted(wi)
        parts = self.attenuations(torch.exp(-path[:, None] * self.absorption), reflected[:, None])
        phi = torch.atan2(wi[:, 0], wi[:, 2]) + torch.atan2(wo[:, 0], wo[:, 2])
        sine, cosine = wo[:, 1], root(wo[:, 0].square() + wo[:, 2].square())
        result = torch.zeros_like(parts[1])
        for p, (part, v, tilt) in enumerate(zip(parts, self.variances, self.tilts, strict=True)):
            sin_p, cos_p = self.tilted(wi, tilt)
            # the exponent of exp(-sin sin / v) / (2 v sinh(1 / v)) and of the scaled Bessel function together
            exponent = -((sin_p + sine).square() + (cos_p - cosine).square()) / (2 * v)
            along = self.bessel(cos_p * cosine / v) * torch.exp(exponent) / (v * -torch.expm1(-2 / v))
            around = 1 / (2 * math.pi) if p == 3 else logistic(phi - p * (2 * gamma + math.pi), self.deviation)
            result = result + part * (along * around)[:, None]
        return result

    def chances(self, wi: torch.Tensor) -> list[torch.Tensor]:
        """Attenuations of the component that is absorbed least."""
        _, path, reflected = self.refracted(wi)
        return self.attenuations(torch.exp(-path * self.absorption.amin(1)), reflected)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        value = self.eval(wi, wo, torch.zeros(len(wi), dtype=torch.int64))
        return (value.amax(1) / torch.stack(self.chances(wi)).sum(0)).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        wi = wi.detach()
        shares = torch.stack(self.chances(wi)).detach()
        ends = shares.cumsum(0)
        at = u[:, 0] * ends[-1]
        lobe = (at >= ends[:-1]).sum(0)

        def of_lobe(values: list[torch.Tensor]) -> torch.Tensor:
            return torch.stack([v.detach() for v in values])[lobe]

        rest = ((at - (ends - shares).gather(0, lobe[None])[0]) / shares.gather(0, lobe[None])[0]).clamp(0, 1)
        sin_p, cos_p = self.tilted(wi, of_lobe(self.tilts))
        v, s, gamma = of_lobe(self.variances), self.deviation.detach(), self.refracted(wi)[0].detach()
        least = torch.exp(-2 / v)
        cosine = (1 + v * torch.log(u[:, 1] * (1 - least) + least)).clamp(min=-1)
        sine = root(1 - cosine.square()) * torch.cos(2 * math.pi * u[:, 2]) * cos_p - cosine * sin_p
        end = torch.exp(-math.pi / s)
        x = s * torch.log((end + rest * (1 - end)) / (1 - rest * (1 - end)))
        x = torch.where(lobe == 3, 2 * math.pi * rest, x + lobe * (2 * gamma + math.pi))
        x = x - torch.atan2(wi[:, 0], wi[:, 2])
        across = root(1 - sine.square())
        wo = torch.stack([across * torch.sin(x), sine, across * torch.cos(x)], 1)
        return one_lobe(wo, self.pdf(wi, wo))
