"""The material of redner."""

from __future__ import annotations

import math

import torch

from torchrender.surface import dot, normalize
from torchrender.warp import cosine_hemisphere
from torchrender.wavefront.bsdf import Bsdf, BsdfSample, Color, one_lobe

from .coated import specular_sampling_weight
from .common import above, at_least, upright


class RednerMaterial(Bsdf):
    """A diffuse lobe and one of microfacets with Blinn's and Phong's density."""

    def read(self, color: Color, number: Color) -> None:
        self.diffuse, self.specular = color("diffuse_reflectance"), color("specular_reflectance")
        self.roughness = at_least(self.scalar("roughness"), 1e-5)

    def masking(self, v: torch.Tensor) -> torch.Tensor:
        """Walter et al., EGSR 2007, section 5.2, with alpha^2 = roughness."""
        sine2 = (v[:, :2] * v[:, :2]).sum(1)
        tilted = sine2 > 1e-12
        a = v[:, 2].abs() / torch.sqrt(torch.where(tilted, sine2 * self.roughness, 1.0))
        steep = tilted & (a < 1.6)
        a = torch.where(steep, a, 1.0)
        return torch.where(steep, (3.535 * a + 2.181 * a * a) / (1 + 2.276 * a + 2.577 * a * a), 1.0)

    def split(self, wi: torch.Tensor, wo: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """The microfacets between both directions.

        Whether there are any; their density, their cosine with wi and with the normal; and the directions, upright
        where there are none.
        """
        h = wi + wo
        possible = above(wi, wo) & (dot(h, h) > 1e-20)
        wi, wo = upright(possible, wi, wo)
        h = wi + wo
        length = torch.sqrt(dot(h, h))
        cosine = h[:, 2] / length
        density = torch.exp((1 / self.roughness - 1) * 2 * torch.log(cosine)) / (self.roughness * math.pi)
        return possible, density, length / 2, cosine, wi, wo

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        possible, density, d, _, wi, wo = self.split(wi, wo)
        microfacets = density * self.masking(wi) * self.masking(wo) / (4 * wi[:, 2])
        fresnel = self.specular + (1 - self.specular) * ((1 - d).clamp(min=0.0) ** 5)[:, None]
        value = self.diffuse * (wo[:, 2] / math.pi)[:, None] + fresnel * microfacets[:, None]
        return torch.where(possible[:, None], value, 0.0)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        possible, density, d, cosine, wi, wo = self.split(wi, wo)
        p = specular_sampling_weight(0.5, self.specular, self.diffuse)
        return torch.where(possible, p * density * cosine / (4 * d) + (1 - p) * wo[:, 2] / math.pi, 0.0)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        mirrors = u[:, 0] < specular_sampling_weight(0.5, self.specular, self.diffuse)
        cos2 = (1 - u[:, 2]) ** self.roughness
        phi, sine = 2 * math.pi * u[:, 1], torch.sqrt((1 - cos2).clamp(min=0.0))
        m = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), torch.sqrt(cos2)], 1)
        i = dot(wi, m)
        wo = torch.where(mirrors[:, None], normalize(2 * i[:, None] * m - wi), cosine_hemisphere(u[:, 1], u[:, 2]))
        return one_lobe(wo, torch.where(~mirrors | (i > 0), self.pdf(wi, wo), 0.0))
