"""Vectors, frames, values with the derivative of something else, and points that are glued to surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import torch

from ..surface import (
    CYLINDER,
    MESH,
    SPHERE,
    Surfaces,
    dot,
    inverse_linear,
    normalize,
    transform_normal,
    transform_point,
)

Self = TypeVar("Self", bound="Rows")


@dataclass
class Rows:
    """Base of dataclasses whose members are tensors of N rows."""

    def __getitem__(self: Self, rows: Any) -> Self:
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def take(self: Self, rows: torch.Tensor) -> Self:
        """The rows of these different numbers, which are in order."""
        return self if len(rows) == len(self) else self[rows]

    @classmethod
    def cat(cls: type[Self], pieces: Sequence[Self]) -> Self:
        if len(pieces) == 1:
            return pieces[0]
        return cls(*(torch.cat([getattr(p, f.name) for p in pieces]) for f in fields(cls)))


def reattach(value: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
    """The numbers of the one with the derivative of the other."""
    return value.detach() + (derivative - derivative.detach()) if derivative.requires_grad else value.detach()


def root(x: torch.Tensor) -> torch.Tensor:
    """Square root of what should not be negative, whose derivative at zero is taken as zero."""
    positive = x > 0
    return torch.where(positive, torch.sqrt(torch.where(positive, x, 1.0)), 0.0)


@dataclass
class Frame(Rows):
    """Orthonormal vectors (N, 3) around a normal, as csrc/core/math/vector.h chooses them (Duff et al. 2017)."""

    s: torch.Tensor
    t: torch.Tensor
    n: torch.Tensor

    @classmethod
    def about(cls, n: torch.Tensor) -> Frame:
        x, y, z = n.unbind(1)
        sign = torch.where(z < 0, -1.0, 1.0).to(n)
        a = -1 / (sign + z)
        b = x * y * a
        s = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], 1)
        return cls(s, torch.stack([b, sign + y * y * a, -y], 1), n)

    def along(self, tangent: torch.Tensor) -> Frame:
        """Turned about the normals until s is in the direction of the tangents, where there are such."""
        part = tangent - self.n * dot(self.n, tangent)[:, None]
        usable = dot(part, part) > 1e-12 * dot(tangent, tangent)
        s = torch.where(usable[:, None], normalize(part), self.s)
        return Frame(s, torch.linalg.cross(self.n, s), self.n)

    def to_local(self, v: torch.Tensor) -> torch.Tensor:
        return torch.stack([dot(v, self.s), dot(v, self.t), dot(v, self.n)], 1)

    def to_world(self, v: torch.Tensor) -> torch.Tensor:
        return self.s * v[:, :1] + self.t * v[:, 1:2] + self.n * v[:, 2:]


@dataclass
class Glued(Rows):
    """Points that keep their barycentric coordinates, or their place on the unit shape, when surfaces move.

    Positions and unit normals (N, 3), texture coordinates (N, 2), and area vectors (N, 3): normals whose length is the
    area on the surface of a fixed area of the coordinates, up to a constant.
    """

    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    uv: torch.Tensor
    area: torch.Tensor

    def solid_angle(self, x: torch.Tensor) -> torch.Tensor:
        """J / J', with J the solid angle at x (N, 3) of the piece of surface, and J' its value without derivative.

        The change of variables of Zhang et al., "Path-Space Differentiable Rendering", SIGGRAPH 2020.
        """
        towards = self.position - x
        square = dot(towards, towards)
        cosine = dot(self.area, towards).abs()
        usable = (cosine > 0) & (square > 0)
        j = torch.where(usable, cosine, 1.0) / torch.where(usable, square, 1.0) ** 1.5
        return j / j.detach()


def glue(
    surfaces: Surfaces,
    shape: torch.Tensor,
    primitive: torch.Tensor,
    barycentric: torch.Tensor,
    position: torch.Tensor,
    uv: torch.Tensor,
) -> Glued:
    """Points of these coordinates on shapes that may emit, attached to the surfaces alone.

    Spheres, disks and cylinders take `position` and `uv`.
    """
    b, position, uv = barycentric.detach(), position.detach(), uv.detach()
    on_mesh = surfaces.kind[shape] == MESH
    flat, curved = on_mesh.nonzero()[:, 0], (~on_mesh).nonzero()[:, 0]
    pieces = [
        _on_triangles(surfaces, shape[flat], primitive[flat], b[flat]),
        _on_quadrics(surfaces, shape[curved], position[curved], uv[curved]),
    ]
    return Glued.cat(pieces)[torch.argsort(torch.cat([flat, curved]))]


def _on_triangles(surfaces: Surfaces, shape: torch.Tensor, primitive: torch.Tensor, b: torch.Tensor) -> Glued:
    corner = surfaces.faces[surfaces.first_face[shape] + primitive]
    p = surfaces.positions[corner]
    weight = torch.cat([1 - b.sum(1, keepdim=True), b], 1)[..., None]
    area = torch.linalg.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal = normalize(area)
    smooth = surfaces.smooth[shape][:, None]
    shading = torch.where(smooth, normalize((surfaces.normals[corner] * weight).sum(1), normal), normal)
    uv = torch.where(surfaces.textured[shape][:, None], (surfaces.texcoords[corner] * weight).sum(1), b)
    sign = torch.where(surfaces.flip[shape], -1.0, 1.0).to(p)[:, None]
    return Glued((p * weight).sum(1), normal * sign, shading * sign, uv, area)


def _on_quadrics(surfaces: Surfaces, shape: torch.Tensor, position: torch.Tensor, uv: torch.Tensor) -> Glued:
    matrix = surfaces.to_world[shape]
    inverse = inverse_linear(matrix)
    local = (inverse * (position - matrix[:, :3, 3])[:, None]).sum(2).detach()
    sphere, cylinder = ((surfaces.kind[shape] == kind)[:, None] for kind in (SPHERE, CYLINDER))
    across = local * local.new_tensor([1.0, 1.0, 0.0])
    up = torch.where(sphere, normalize(local), torch.where(cylinder, normalize(across), local.new_tensor([0.0, 0, 1])))
    local = torch.where(sphere, up, torch.where(cylinder, up + (local - across), across))
    up = transform_normal(inverse, up)
    sign = torch.where(surfaces.flip[shape], -1.0, 1.0).to(local)[:, None]
    normal = normalize(up) * sign
    area = up * torch.linalg.det(matrix[:, :3, :3])[:, None]
    return Glued(transform_point(matrix, local), normal, normal, uv, area)
