"""Light through a rough coating, by Gaussian quadrature over visible normals: csrc/host/rough_transmittance.cpp."""

from __future__ import annotations

import math

import numpy as np
import torch

from torchrender.wavefront.world import Record, World

from .common import fresnel_dielectric
from .rough import Microfacets, visible_slope

COSINES = 64
COARSE, FINE = (8, 16), (16, 32)  # nodes of the integrals over visible normals


def rough_transmittance(
    world: World, record: Record, eta: torch.Tensor, alpha: torch.Tensor, ggx: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """What is reflected inside of diffuse light (), and what is transmitted at the cosines of the table, attached.

    Derivatives are differences over some percent: those of single nodes are infinite at total reflection.
    """
    key = ("coat", record.path)
    if key not in world.kept:
        with torch.no_grad():
            n, a = eta.double(), alpha.double()
            dn, da = 0.02 * n, 0.05 * a
            found = [
                _rows(n, a, ggx),
                (_rows(n + dn, a, ggx) - _rows(n - dn, a, ggx)) / (2 * dn),
                (_rows(n, a + da, ggx) - _rows(n, a - da, ggx)) / (2 * da),
            ]
            world.kept[key] = [x.to(eta.dtype) for x in found]
    rows, *slopes = world.kept[key]
    for value, slope in zip((eta, alpha), slopes, strict=True):
        rows = rows + (value - value.detach()) * slope
    return rows[0], rows[1:]


def _rows(eta: torch.Tensor, alpha: torch.Tensor, ggx: bool) -> torch.Tensor:
    microfacets = Microfacets(alpha, ggx)
    microfacets.alpha = microfacets.across = alpha  # also below the least that is rendered with
    cosines = torch.linspace(0, 1, COSINES, dtype=torch.float64, device="cpu").clamp(min=1e-6)
    internal = (_averages(microfacets, 1 / eta, cosines, FINE, refracts=False) * cosines).mean() * 2
    return torch.cat([internal[None], _averages(microfacets, eta, cosines, COARSE, refracts=True)])


def _averages(
    microfacets: Microfacets, eta: torch.Tensor, cosine: torch.Tensor, nodes: tuple[int, int], refracts: bool
) -> torch.Tensor:
    """The share of light from each direction that is refracted and goes on below, or is reflected and goes back.

    Walter et al., EGSR 2007, equations 20 and 21 over the density of visible normals.
    """
    m, weight = _visible_normals(microfacets, cosine, nodes)
    wi = torch.stack([(1 - cosine.square()).sqrt(), torch.zeros_like(cosine), cosine], 1)
    i = (m * wi[:, None]).sum(-1)
    fresnel, cos_t, _, eta_ti = (x.reshape(i.shape) for x in fresnel_dielectric(i.flatten(), eta))
    if refracts:
        wo, share = (eta_ti * i + cos_t)[..., None] * m - eta_ti[..., None] * wi[:, None], 1 - fresnel
    else:
        wo, share = 2 * i[..., None] * m - wi[:, None], fresnel
    goes = wo[..., 2] < 0 if refracts else wo[..., 2] > 0
    masking = microfacets.masking(wo.flatten(0, 1)).reshape(i.shape)
    return (torch.where(goes, share * masking, 0.0) * weight).sum(1)


def _visible_normals(
    microfacets: Microfacets, cosine: torch.Tensor, nodes: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Normals (K, M, 3) visible from each direction (sine, 0, cosine) of (K,), and weights (M,) of a mean over them.

    Gauss-Legendre nodes of the numbers that sampling takes, crowded at both ends of the second; half of the azimuths.
    """
    (azimuth, wa), (height, wh) = (
        (torch.from_numpy(0.5 * (x + 1)), torch.from_numpy(0.5 * w))
        for x, w in map(np.polynomial.legendre.leggauss, nodes)
    )
    u = height.square() * (3 - 2 * height)
    weight = wa[:, None] * (wh * 6 * height * (1 - height))
    alpha, sine = microfacets.alpha, (1 - cosine.square()).sqrt()
    length = ((alpha * sine).square() + cosine.square()).sqrt()
    s, c = (alpha * sine / length)[:, None, None], (cosine / length)[:, None, None]
    if microfacets.ggx:
        phi = math.pi * azimuth[:, None]
        z = (1 - u) * (1 + c) - c
        r = (1 - z.square()).sqrt()
        normal = (r * phi.cos() + s, r * phi.sin(), z + c)
    else:
        slope = visible_slope(*(x.flatten() for x in torch.broadcast_tensors(s[:, 0], c[:, 0], u)))
        other = torch.erfinv(azimuth)[:, None]
        normal = (-slope.reshape(len(cosine), 1, -1), -other, torch.ones_like(other))
    m = torch.stack(torch.broadcast_tensors(*normal), -1) * torch.stack([alpha, alpha, torch.ones_like(alpha)])
    return torch.nn.functional.normalize(m, dim=-1).flatten(1, 2), weight.flatten()
