"""The material of redner."""

from __future__ import annotations

import math

import torch

from .bsdf import Bsdf, BsdfSample, dot
from .numbers import cosine_hemisphere


class RednerMaterial(Bsdf):
    smooth, delta = True, False
    albedo = "diffuse_reflectance"

    def read(self, color, number) -> None:
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")
        self.roughness = self.scalar("roughness")

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """Walter et al., EGSR 2007, section 5.2, with alpha^2 = roughness."""
        a = v[:, 2].abs() / (v[:, :2].norm(dim=1) * self.roughness.sqrt())
        return torch.where(a < 1.6, (3.535 * a + 2.181 * a * a) / (1 + 2.276 * a + 2.577 * a * a), 1.0)

    def split(self, wi: torch.Tensor, wo: torch.Tensor):
        """Whether both directions are above; the density of the facet between them, its cosine with wi, its own."""
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        h = wi + torch.where(above[:, None], wo, wi)
        length = h.norm(dim=1)
        cosine = h[:, 2] / length
        exponent = 2 / self.roughness - 2
        return above, (exponent + 2) / (2 * math.pi) * cosine.abs() ** exponent, length / 2, cosine

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        above, density, d, _ = self.split(wi, wo)
        facets = density * self.masking(wi) * self.masking(wo) / (4 * wi[:, 2])
        fresnel = self.specular + (1 - self.specular) * ((1 - d).clamp(min=0.0) ** 5)[:, None]
        value = self.diffuse * (wo[:, 2] / math.pi)[:, None] + fresnel * facets[:, None]
        return torch.where(above[:, None], value, 0.0)

    def chance(self) -> torch.Tensor:
        """Of facets."""
        coat, base = self.specular.abs().amax(1), self.diffuse.abs().amax(1)
        return torch.where(coat + base > 0, coat / (coat + base), 0.5).clamp(0.1, 0.9).detach()

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        above, density, d, cosine = self.split(wi, wo)
        p = self.chance()
        return torch.where(above, p * density * cosine / (4 * d) + (1 - p) * wo[:, 2] / math.pi, 0.0).detach()

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        facets = u[:, 0] < self.chance()
        cos2 = (1 - u[:, 2]) ** self.roughness.detach()
        phi, sine = 2 * math.pi * u[:, 1], (1 - cos2).clamp(min=0.0).sqrt()
        m = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), cos2.sqrt()], 1)
        i = dot(wi.detach(), m)
        wo = torch.where(facets[:, None], 2 * i[:, None] * m - wi.detach(), cosine_hemisphere(u[:, 1], u[:, 2]))
        pdf = torch.where(~facets | (i > 0), self.pdf(wi, wo), 0.0)
        return BsdfSample(wo, pdf, torch.ones_like(pdf), torch.zeros(len(wi)).long())
