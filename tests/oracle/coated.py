"""Diffuse bases under an interface."""

from __future__ import annotations

import math

import numpy as np
import torch

from .bsdf import Bsdf, BsdfSample, dot, fresnel_dielectric
from .numbers import cosine_hemisphere
from .rough import Facets


def diffuse_fresnel(eta: torch.Tensor) -> torch.Tensor:
    """What an interface reflects of diffuse light: Egan and Hilgeman 1973 below 1, d'Eon and Irving 2011 above."""
    below = 0.0636 / eta + 0.6681 + 0.7099 * eta - 1.4399 * eta.square()
    c = (0.919317, -3.4793, 6.75335, -7.80989, 4.98554, -1.36881)
    return torch.where(eta < 1, below, sum(x * eta**-i for i, x in enumerate(c)))


class Plastic(Bsdf):
    """Lobe 0 is the diffuse base, lobe 1 the mirror reflection."""

    smooth = True
    albedo = "diffuse_reflectance"

    def read(self, color, number) -> None:
        self.eta, self.nonlinear = number("eta"), self.record.field["nonlinear"] == 1
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        seen, above = wi[:, 2:] > 0, (wi[:, 2:] > 0) & (wo[:, 2:] > 0)
        reflected = fresnel_dielectric(wi[:, 2], self.eta)[0]
        through = (1 - reflected) * (1 - fresnel_dielectric(wo[:, 2], self.eta)[0])
        internal = diffuse_fresnel(1 / self.eta)
        base = self.diffuse / (1 - (self.diffuse * internal if self.nonlinear else internal))
        base = base * (through * wo[:, 2] / (math.pi * self.eta.square()))[:, None]
        mirrored = torch.where(seen, self.specular * reflected[:, None], 0.0)
        return torch.where((lobe != 0)[:, None], mirrored, torch.where(above, base, 0.0))

    def chance(self, wi: torch.Tensor) -> torch.Tensor:
        """Of the mirror reflection."""
        r = fresnel_dielectric(wi[:, 2], self.eta)[0]
        coat, base = r * self.specular.abs().amax(1), (1 - r) * self.diffuse.abs().amax(1)
        return (coat / (coat + base)).clamp(0.1, 0.9).detach()

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return torch.where(above, (1 - self.chance(wi)) * wo[:, 2] / math.pi, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        p = self.chance(wi)
        mirrors = u[:, 0] < p
        cosine = cosine_hemisphere(u[:, 1], u[:, 2])
        wo = torch.where(mirrors[:, None], wi * wi.new_tensor([-1.0, -1.0, 1.0]), cosine)
        pdf = torch.where(mirrors, p, (1 - p) * cosine[:, 2] / math.pi)
        return BsdfSample(wo, torch.where(wi[:, 2] > 0, pdf, 0.0), torch.ones_like(p), mirrors.long())


COSINES = 64
COARSE, FINE = (8, 16), (16, 32)  # nodes of the integrals over visible normals


def visible_normals(facets: Facets, cosine: torch.Tensor, nodes: tuple[int, int]) -> tuple[torch.Tensor, ...]:
    """Normals (K, M, 3) visible from each direction (sine, 0, cosine) of (K,), and weights (M,) of a
    mean over them. Gauss-Legendre nodes of the numbers that sampling takes; half of the azimuths."""
    (azimuth, wa), (height, wh) = (
        (torch.from_numpy(0.5 * (x + 1)), torch.from_numpy(0.5 * w))
        for x, w in map(np.polynomial.legendre.leggauss, nodes)
    )
    u, phi = height.square() * (3 - 2 * height), math.pi * azimuth
    weight = wa[:, None] * (wh * 6 * height * (1 - height))
    alpha, sine = facets.alpha, (1 - cosine.square()).sqrt()
    length = ((alpha * sine).square() + cosine.square()).sqrt()
    s, c = (alpha * sine / length)[:, None, None], (cosine / length)[:, None, None]
    z = (1 - u) * (1 + c) - c
    r = (1 - z.square()).sqrt()
    h = torch.stack(torch.broadcast_tensors(r * phi.cos()[:, None] + s, r * phi.sin()[:, None], z + c), -1)
    m = torch.nn.functional.normalize(h * torch.stack([alpha, alpha, torch.ones_like(alpha)]), dim=-1)
    return m.flatten(1, 2), weight.flatten()


class RoughPlastic(Bsdf):
    smooth, delta = True, False
    albedo = "diffuse_reflectance"

    def read(self, color, number) -> None:
        self.eta, self.nonlinear = number("eta"), self.record.field["nonlinear"] == 1
        self.facets = Facets(number("alpha"), self.record.field["distribution"] == 1)
        assert self.facets.ggx, "the other facets' normals are found by bisection here, which has no derivative"
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")
        # derivatives by differences over some percent: those of single nodes are infinite at total reflection
        eta, alpha = self.eta.detach(), self.facets.alpha.detach()
        rows = self.rows(eta, alpha)
        for value, now, share in ((self.eta, eta, 0.02), (self.facets.alpha, alpha, 0.05)):
            step = share * now
            high, low = (
                self.rows(eta + sign * step, alpha) if value is self.eta else self.rows(eta, alpha + sign * step)
                for sign in (1, -1)
            )
            rows = rows + (value - now) * (high - low) / (2 * step)
        self.internal, self.table = rows[0], rows[1:]

    def rows(self, eta: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
        """What is reflected inside of diffuse light, and what is transmitted at the cosines of the table."""
        facets = Facets(alpha, self.facets.ggx)
        cosines = torch.linspace(0, 1, COSINES, dtype=torch.float64).clamp(min=1e-6)
        internal = (self.averages(facets, eta, cosines, FINE, refracts=False) * cosines).mean() * 2
        return torch.cat([internal[None], self.averages(facets, eta, cosines, COARSE, refracts=True)])

    def averages(
        self, facets: Facets, eta: torch.Tensor, cosine: torch.Tensor, nodes: tuple[int, int], refracts: bool
    ) -> torch.Tensor:
        """Of light from each direction the share that is refracted and goes on below; or, where light comes from
        below, the share that is reflected and goes back."""
        m, weight = visible_normals(facets, cosine, nodes)
        wi = torch.stack([(1 - cosine.square()).sqrt(), torch.zeros_like(cosine), cosine], 1)
        i = (m * wi[:, None]).sum(-1)
        eta = eta if refracts else 1 / eta
        fresnel, cos_t, _, eta_ti = fresnel_dielectric(i.flatten(), eta)
        fresnel, cos_t, eta_ti = (x.reshape(i.shape) for x in (fresnel, cos_t, eta_ti))
        if refracts:
            wo, share = (eta_ti * i + cos_t)[..., None] * m - eta_ti[..., None] * wi[:, None], 1 - fresnel
        else:
            wo, share = 2 * i[..., None] * m - wi[:, None], fresnel
        goes = wo[..., 2] < 0 if refracts else wo[..., 2] > 0
        masking = facets.masking(wo.flatten(0, 1)).reshape(i.shape)
        return (torch.where(goes, share * masking, 0.0) * weight).sum(1)

    def transmittance(self, cosine: torch.Tensor) -> torch.Tensor:
        x = cosine.clamp(0, 1) * (COSINES - 1)
        cell = x.detach().floor().clamp(max=COSINES - 2).long()
        return self.table[cell] + (x - cell) * (self.table[cell + 1] - self.table[cell])

    def visible(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        h = wi + torch.where(above[:, None], wo, wi)
        h = h / h.norm(dim=1, keepdim=True)
        return torch.where(above, self.facets.density(h) * self.facets.masking(wi) / wi[:, 2], 0.0)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        cosine = 0.5 * (wi + wo).norm(dim=1)
        mirrored = self.visible(wi, wo) * self.facets.masking(wo) / 4 * fresnel_dielectric(cosine, self.eta)[0]
        base = self.diffuse / (1 - (self.diffuse * self.internal if self.nonlinear else self.internal))
        through = self.transmittance(wi[:, 2]) * self.transmittance(wo[:, 2]) * wo[:, 2] / math.pi / self.eta.square()
        above = ((wi[:, 2] > 0) & (wo[:, 2] > 0))[:, None]
        return torch.where(above, self.specular * mirrored[:, None] + base * through[:, None], 0.0)

    def chance(self, wi: torch.Tensor) -> torch.Tensor:
        """Of the coating."""
        t = self.transmittance(wi[:, 2])
        coat, base = (1 - t) * self.specular.abs().amax(1), t * self.diffuse.abs().amax(1)
        return (coat / (coat + base)).clamp(0.1, 0.9).detach()

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        p, above = self.chance(wi), (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return torch.where(above, p * self.visible(wi, wo) / 4 + (1 - p) * wo[:, 2] / math.pi, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        seen = torch.cat([wi[:, :2], wi[:, 2:].abs()], 1).detach()
        m = self.facets.visible_normal(seen, u)
        mirrors = (u[:, 0] < self.chance(wi))[:, None]
        wo = torch.where(mirrors, 2 * dot(seen, m)[:, None] * m - seen, cosine_hemisphere(u[:, 1], u[:, 2]))
        return BsdfSample(wo, self.pdf(wi, wo), torch.ones_like(wo[:, 2]), torch.zeros(len(wi)).long())
