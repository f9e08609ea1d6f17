"""What the models of BSDFs have in common, besides what `torchrender.wavefront.bsdf` has."""

from __future__ import annotations

from typing import TypeAlias

import torch

from torchrender.wavefront.bsdf import Bsdf
from torchrender.wavefront.geometry import reattach, root

Polarised: TypeAlias = "tuple[torch.Tensor, torch.Tensor]"
Part: TypeAlias = "tuple[torch.Tensor, torch.Tensor, torch.Tensor]"


class Delta(Bsdf):
    """One of delta lobes only."""

    smooth, delta = False, True


class Polarising:
    """What polarises, as `polarised` or as `parts` say; all others scatter unpolarised light."""

    def polarised(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> Polarised:
        """Axes (N, 3), whose parts across both directions are meant, and Mueller matrices (N or 1, C or 1, 4, 4).

        Of those only the ratios of their entries matter.
        """
        raise NotImplementedError

    def parts(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> list[Part]:
        """The same of lobes that go the same ways, each behind its share (N, C) of what is scattered."""
        return [(torch.ones(1, 1, dtype=wi.dtype), *self.polarised(wi, wo, lobe))]


def above(wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
    """Where both directions are above the surface."""
    return (wi[:, 2] > 0) & (wo[:, 2] > 0)


def upper(v: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3), those from below mirrored."""
    return torch.cat([v[:, :2], v[:, 2:].abs()], 1)


def mirrored(wi: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3) of the mirror reflection."""
    return wi * wi.new_tensor([-1.0, -1.0, 1.0])


def upright(usable: torch.Tensor, *vectors: torch.Tensor) -> list[torch.Tensor]:
    """Vectors (N, 3) that are +z where they are not usable (N,), whose functions have derivatives that are finite."""
    up = vectors[0].new_tensor([0.0, 0.0, 1.0])
    return [torch.where(usable[:, None], v, up) for v in vectors]


def at_least(x: torch.Tensor, low: float) -> torch.Tensor:
    """Numbers that count as `low` where they are smaller, with the derivative there."""
    return reattach(x.detach().clamp(min=low), x)


def fresnel_dielectric(cos_i: torch.Tensor, eta: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Reflectance, signed cosine of refraction, relative index along the ray and its inverse, each (N,)."""
    outside = cos_i >= 0
    eta_it, eta_ti = torch.where(outside, eta, 1 / eta), torch.where(outside, 1 / eta, eta)
    ci, ct = cos_i.abs(), root(1 - eta_ti * eta_ti * (1 - cos_i * cos_i))
    matched, grazing = (eta == 1).expand_as(ci), ci == 0
    usable = ~(matched | grazing)
    safe_ci, safe_ct = torch.where(usable, ci, 1.0), torch.where(usable, ct, 1.0)
    r = torch.where(usable, reflectance(safe_ci, safe_ct, eta_it), torch.where(matched, 0.0, 1.0).to(ci))
    cos_t = torch.where(matched, -cos_i, torch.where(outside, -ct, ct))
    return r, cos_t, eta_it, eta_ti


def reflectance(ci: torch.Tensor, ct: torch.Tensor, eta: torch.Tensor) -> torch.Tensor:
    """Fresnel's, from the cosines of both directions and the index of refraction along the ray."""
    senkrecht = (ci - eta * ct) / (ci + eta * ct)
    parallel = (ct - eta * ci) / (ct + eta * ci)
    return 0.5 * (senkrecht * senkrecht + parallel * parallel)


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
