"""Lights that show an image, and the cells by which points on them are chosen: csrc/host/scene_light_cells.cpp."""

from __future__ import annotations

import math

import torch

from ..scene.packing import Record
from . import numbers
from .textures import interpolated
from .world import At, World

LARGEST, UNIFORM_SHARE = 256, 0.25  # cells along a side; what cells keep of the mean


def barycentric(square: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Face (N,) and barycentric coordinates (N, 2) on two triangles of points (N, 2) of the unit square."""
    x, y = square.unbind(1)
    second = y > x
    return second.long(), torch.stack([torch.where(second, x, x - y), torch.where(second, y - x, y)], 1)


class LightCells:
    """Cells over a rectangle that shows a bitmap, with the weights of what is shown there and of its mean."""

    def __init__(self, world: World, shape: int, texture: Record) -> None:
        self.world, self.shape, self.texture = world, shape, texture
        height, width = world.tensor("texture", texture, "data").shape[:2]
        matrix = world.tensor("texture", texture, "to_uv").detach()[:2, :2].double()
        corners = self._at(torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=world.dtype)).uv.double()
        sides = [(matrix @ (corner - corners[0])).abs() for corner in corners[1:]]
        across, down = (max(float(side[0]) * width, float(side[1]) * height) for side in sides)
        self.columns, self.rows = (min(max(math.ceil(n - 1e-3), 1), LARGEST) for n in (across, down))
        x, y = self._places(across, self.columns), self._places(down, self.rows)
        points = torch.stack(torch.meshgrid(y, x, indexing="ij"), -1).flip(-1).reshape(-1, 2)
        shown = self._brightness(self._at(points)).reshape(self.rows, len(y) // self.rows, self.columns, -1)
        weights = shown.double().sum((1, 3))
        self.used = bool(weights.sum() > 0)
        weights = weights * ((1 - UNIFORM_SHARE) * weights.numel() / weights.sum()) + UNIFORM_SHARE
        marginal, conditional = (numbers.cumulative(w).to(world.dtype) for w in (weights.sum(1), weights))
        self.cells = numbers.Cells(marginal, conditional)

    @classmethod
    def of(cls, world: World, shape: int, texture: int) -> LightCells | None:
        """None where a light is no pair of triangles of one size, or shows no image."""
        surfaces, records = world.surfaces, world.records
        if texture < 0 or records["texture"][texture].type != "bitmap":
            return None
        record = records["shape"][shape]
        if record.type not in ("rectangle", "mesh"):
            return None
        if record.type == "mesh" and len(world.layout.indices(record.field["faces"])) != 2:
            return None
        first = int(surfaces.first_face[shape])
        p0, p1, p2 = surfaces.positions.detach().double()[surfaces.faces[first : first + 2]].unbind(1)
        one, two = torch.linalg.vector_norm(torch.linalg.cross(p1 - p0, p2 - p0), dim=1).tolist()
        if not one + two > 0 or not abs(one / (one + two) - 0.5) < 1e-5:
            return None
        found = cls(world, shape, records["texture"][texture])
        return found if found.used else None

    def _places(self, texels: float, cells: int) -> torch.Tensor:
        points = min(max(math.ceil(texels / cells), 2), 8)
        return (torch.arange(cells * points, dtype=self.world.dtype) + 0.5) / (cells * points)

    def _at(self, square: torch.Tensor) -> At:
        surfaces = self.world.surfaces
        face, b = barycentric(square)
        corners = surfaces.faces[int(surfaces.first_face[self.shape]) + face]
        uv = b
        if bool(surfaces.textured[self.shape]):
            weight = torch.cat([1 - b.sum(1, keepdim=True), b], 1)
            uv = (surfaces.texcoords.detach()[corners] * weight[..., None]).sum(1)
        return At(torch.full_like(face, self.shape), face, b, uv)

    def _brightness(self, at: At) -> torch.Tensor:
        """Of the largest channel of texels, interpolated."""
        texels = self.world.tensor("texture", self.texture, "data").detach()
        return interpolated(self.world, self.texture, texels.abs().amax(-1, keepdim=True), at)[:, 0].detach()

    def sample(self, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Points of the square (N, 2) for two numbers each, and their densities (N,)."""
        i, j, down, across, mass = self.cells.sample(u[:, 1], u[:, 0])
        return torch.stack([(j + across) / self.columns, (i + down) / self.rows], 1), mass * (self.rows * self.columns)

    def density(self, face: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """With which that chooses points with these faces (N,) and barycentric coordinates (N, 2)."""
        both, first = b.sum(1), face == 0
        x, y = torch.where(first, both, b[:, 0]), torch.where(first, b[:, 1], both)
        i = torch.floor(y * self.rows).long().clamp(0, self.rows - 1)
        j = torch.floor(x * self.columns).long().clamp(0, self.columns - 1)
        return self.cells.mass(i, j) * (self.rows * self.columns)
