"""Shapes as area lights: points sampled on them, and their densities, all of it detached."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from .. import warp
from ..surface import (
    curved_coordinates,
    dot,
    inverse_linear,
    normalize,
    transform_normal,
    transform_point,
    transform_vector,
)
from . import numbers
from .geometry import Frame, Rows
from .world import World


@dataclass
class LightPoint(Rows):
    """Points on a shape: position and normal (N, 3), primitive (N,), barycentric coordinates (N, 2)."""

    position: torch.Tensor
    normal: torch.Tensor
    primitive: torch.Tensor
    barycentric: torch.Tensor


class LightShape:
    """A shape as a light; `area` is in world space. Without a `sample` of its own density it is uniform by area."""

    area: torch.Tensor

    def __init__(self, world: World, index: int) -> None:
        raise NotImplementedError

    def sample(self, p: torch.Tensor, u: torch.Tensor) -> LightPoint:
        """Points for reference points p (N, 3) from numbers u (N, 4)."""
        raise NotImplementedError

    def pdf(self, p: torch.Tensor, n: torch.Tensor, d: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
        """Density per solid angle at p of a point with the normal n, in direction d."""
        cosine = dot(n, d).abs()
        by_area = distance * distance / (self.area * torch.where(cosine > 0, cosine, 1.0))
        return torch.where(cosine > 0, by_area, 0.0)


class Triangles(LightShape):
    """Mesh and rectangle."""

    def __init__(self, world: World, index: int) -> None:
        surfaces, record = world.surfaces, world.records["shape"][index]
        count = 2 if record.type == "rectangle" else len(world.layout.indices(record.field["faces"]))
        first = int(surfaces.first_face[index])
        p0, p1, p2 = surfaces.positions.detach()[surfaces.faces[first : first + count]].unbind(1)
        self.p0, self.e1, self.e2 = p0, p1 - p0, p2 - p0
        self.cross = torch.linalg.cross(self.e1, self.e2)
        areas = torch.linalg.vector_norm(self.cross, dim=1) / 2
        self.area, self.cdf = areas.double().sum().to(areas.dtype), numbers.cumulative(areas)
        self.sign = -1.0 if bool(surfaces.flip[index]) else 1.0

    def sample(self, p: torch.Tensor, u: torch.Tensor) -> LightPoint:
        face = numbers.search(self.cdf, u[:, 0])[0]
        return self.at(face, warp.triangle(u[:, 1], u[:, 2]))

    def at(self, face: torch.Tensor, b: torch.Tensor) -> LightPoint:
        """Points on these faces (N,) with barycentric coordinates (N, 2)."""
        position = self.p0[face] + self.e1[face] * b[:, :1] + self.e2[face] * b[:, 1:]
        return LightPoint(position, normalize(self.cross)[face] * self.sign, face, b)


class Quadric(LightShape):
    """Sphere, disk and cylinder."""

    def __init__(self, world: World, index: int) -> None:
        self.matrix = world.surfaces.to_world[index].detach()
        self.inverse = inverse_linear(self.matrix)
        self.flipped = bool(world.surfaces.flip[index])
        self.sign = -1.0 if self.flipped else 1.0

    def at(self, local: torch.Tensor, sphere: bool, cylinder: bool = False) -> LightPoint:
        axis = local if sphere else local.new_tensor([0.0, 0.0, 1.0]).expand_as(local)
        if cylinder:
            axis = local * local.new_tensor([1.0, 1.0, 0.0])
        normal = normalize(transform_normal(self.inverse, axis)) * self.sign
        everywhere = torch.full((len(local),), True)
        uv = curved_coordinates(local, everywhere & sphere, everywhere & cylinder)
        return LightPoint(transform_point(self.matrix, local), normal, torch.zeros(len(local)).long(), uv)


class Disk(Quadric):
    """Points at equal density on the disk."""

    def __init__(self, world: World, index: int) -> None:
        super().__init__(world, index)
        self.area = math.pi * torch.linalg.vector_norm(torch.linalg.cross(self.matrix[:3, 0], self.matrix[:3, 1]))

    def sample(self, p: torch.Tensor, u: torch.Tensor) -> LightPoint:
        local = torch.nn.functional.pad(warp.disk(u[:, 1], u[:, 2]), (0, 1))
        return self.at(local, False)


class Sphere(Quadric):
    """From outside, uniform in the cone that the sphere fills."""

    def __init__(self, world: World, index: int) -> None:
        super().__init__(world, index)
        self.radius, self.center = torch.linalg.vector_norm(self.matrix[:3, 0]), self.matrix[:3, 3]
        self.area = 4 * math.pi * self.radius**2

    def cone(self, p: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Where the sphere is seen from outside; distance of its centre; 1 - cos of the half angle of the cone."""
        distance = torch.linalg.vector_norm(self.center - p, dim=1)
        outside = (distance > self.radius * 1.0001) & (not self.flipped)
        sine = torch.where(outside, self.radius / distance, 0.0)
        return outside, distance, sine**2 / (1 + torch.sqrt((1 - sine**2).clamp(min=0.0)))

    def sample(self, p: torch.Tensor, u: torch.Tensor) -> LightPoint:
        uniform = self.at(warp.sphere(u[:, 1], u[:, 2]), True)
        outside, distance, cutoff = self.cone(p)
        local = warp.cone(u[:, 1], u[:, 2], cutoff)
        axis = (self.center - p) / distance[:, None]
        d = Frame.about(axis).to_world(local)
        along = distance * local[:, 2]
        t = along - torch.sqrt((self.radius**2 - (distance**2 - along**2)).clamp(min=0.0))
        normal = normalize(d * t[:, None] - axis * distance[:, None])
        seen = self.at(normalize(transform_vector(self.inverse, normal * self.radius)), True)
        position = torch.where(outside[:, None], self.center + normal * self.radius, uniform.position)
        return LightPoint(
            position,
            torch.where(outside[:, None], normal, uniform.normal),
            uniform.primitive,
            torch.where(outside[:, None], seen.barycentric, uniform.barycentric),
        )

    def pdf(self, p: torch.Tensor, n: torch.Tensor, d: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
        outside, _, cutoff = self.cone(p)
        in_cone = 1 / (2 * math.pi * torch.where(outside, cutoff, 1.0))
        return torch.where(outside, in_cone, super().pdf(p, n, d, distance))


class Cylinder(Quadric):
    """Points at equal density on the side of a cylinder."""

    def __init__(self, world: World, index: int) -> None:
        super().__init__(world, index)
        radius, length = (torch.linalg.vector_norm(self.matrix[:3, i]) for i in (0, 2))
        self.area = 2 * math.pi * radius * length

    def sample(self, p: torch.Tensor, u: torch.Tensor) -> LightPoint:
        phi = 2 * math.pi * u[:, 1]
        return self.at(torch.stack([torch.cos(phi), torch.sin(phi), u[:, 2]], 1), False, True)


LIGHT_SHAPES: dict[str, type[LightShape]] = {
    "mesh": Triangles,
    "rectangle": Triangles,
    "disk": Disk,
    "sphere": Sphere,
    "cylinder": Cylinder,
}
