"""Light from a map around the scene."""

from __future__ import annotations

import math

import torch

from ..scene.packing import Record
from ..surface import inverse_linear, normalize, transform_vector
from . import numbers
from .color import luminance
from .emitter import Emitter, Light, endless
from .geometry import reattach
from .texels import bilinear


class EnvironmentMap(Emitter):
    """An environment given by an image, sampled in proportion to luminance and solid angle."""

    environment = True

    def prepare(self, record: Record) -> None:
        self.data = self.world.tensor("emitter", record, "data")
        self.scale = self.world.tensor("emitter", record, "scale")
        self.matrix = self.world.tensor("emitter", record, "to_world")
        texels = self.data.detach()
        height = texels.shape[0]
        importance = luminance(texels).clamp(min=0.0)
        pairs = importance + importance.roll(-1, 1)
        rows = max(height - 1, 1)
        cells = 0.25 * (pairs[:rows] + pairs[-rows:])
        if not bool(importance.any()):
            cells = torch.ones_like(cells)
        sine = torch.sin((torch.arange(rows, dtype=texels.dtype) + 0.5) / rows * math.pi)
        marginal = numbers.cumulative(cells.double().sum(1).to(texels.dtype) * sine)
        self.cells = numbers.Cells(marginal, numbers.cumulative(cells))
        self.rows, self.columns = cells.shape

    def coordinates(self, d: torch.Tensor) -> torch.Tensor:
        """World directions to (u, v) of the map: (N, 2)."""
        inverse = inverse_linear(self.matrix)
        x, y, z = normalize((inverse * d[:, None]).sum(2)).unbind(1)
        u = torch.atan2(x, -z) / (2 * math.pi)
        return torch.stack([u - torch.floor(u.detach()), torch.acos(y.clamp(-1.0, 1.0)) / math.pi], 1)

    def at(self, uv: torch.Tensor) -> torch.Tensor:
        """Radiance (N, C) at coordinates of the map."""
        height, width = self.data.shape[:2]
        x, y = uv[:, 0] * width - 0.5, uv[:, 1] * (height - 1)
        left, top = torch.floor(x.detach()), torch.floor(y.detach()).clamp(0, max(height - 2, 0))
        columns = (left.long() % width, (left.long() + 1) % width)
        rows = (top.long(), (top.long() + 1).clamp(max=height - 1))
        return bilinear(self.data, rows, columns, x - left, y - top, self.world.channels) * self.scale

    def density(self, mass: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        sine = torch.sin(v * math.pi)
        usable = sine > 1e-6
        per_area = mass * self.rows * self.columns / (2 * math.pi**2 * torch.where(usable, sine, 1.0))
        return torch.where(usable, per_area, 0.0)

    def escaped(self, d: torch.Tensor) -> torch.Tensor:
        return self.at(self.coordinates(d))

    def escaped_pdf(self, d: torch.Tensor) -> torch.Tensor:
        u, v = self.coordinates(d).detach().unbind(1)
        j = torch.floor(u * self.columns - 0.5).long() % self.columns
        i = torch.floor(v * self.rows).long().clamp(0, self.rows - 1)
        return self.density(self.cells.mass(i, j), v)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        i, j, down, across, mass = self.cells.sample(u[:, 1], u[:, 2])
        azimuth = (j + 0.5 + across) / self.columns
        azimuth = azimuth - torch.floor(azimuth)
        v = (i + down) / self.rows
        phi, theta = azimuth * (2 * math.pi), v * math.pi
        sine = torch.sin(theta)
        local = torch.stack([sine * torch.sin(phi), torch.cos(theta), -sine * torch.cos(phi)], 1)
        d = normalize(transform_vector(self.matrix.detach(), local))
        # the direction stays where it is while the map turns
        uv = torch.stack([azimuth, v], 1)
        value = self.at(reattach(uv, self.coordinates(d)) if self.world.moving else uv)
        return endless(d, self.density(mass, v), value)
