"""Points that are glued to a surface: they keep their barycentric coordinates, or their place on the unit shape."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from torchrender.heightfield import evaluate
from torchrender.surface import (
    CYLINDER,
    HEIGHT_FIELD,
    MESH,
    SPHERE,
    Surfaces,
    inverse_linear,
    transform_normal,
    transform_point,
)

from .geometry import Rows, dot, normalize


@dataclass
class Glued(Rows):
    """Positions and unit normals (N, 3), texture coordinates (N, 2), and area vectors (N, 3): normals whose length is
    the area on the surface of a fixed area of the coordinates, up to a constant."""

    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    uv: torch.Tensor
    area: torch.Tensor

    def solid_angle(self, x: torch.Tensor) -> torch.Tensor:
        """J / det(J), with J the solid angle at x (N, 3) of the piece of surface."""
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
    """The points of these coordinates, attached to the surfaces alone. Curved shapes take `position` and `uv`."""
    b, position, uv = barycentric.detach(), position.detach(), uv.detach()
    kind = surfaces.kind[shape]
    on_mesh, on_field = kind == MESH, kind == HEIGHT_FIELD
    flat, curved = on_mesh.nonzero()[:, 0], (~on_mesh & ~on_field).nonzero()[:, 0]
    rows = [flat, curved]
    pieces = [
        _on_triangles(surfaces, shape[flat], primitive[flat], b[flat]),
        _on_quadrics(surfaces, shape[curved], position[curved], uv[curved]),
    ]
    for index in surfaces.heights:
        rows.append((shape == index).nonzero()[:, 0])
        pieces.append(_on_height_field(surfaces, index, uv[rows[-1]]))
    return Glued.cat(pieces)[torch.argsort(torch.cat(rows))]


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
    local = (inverse @ (position - matrix[:, :3, 3])[..., None])[..., 0].detach()
    sphere, cylinder = ((surfaces.kind[shape] == kind)[:, None] for kind in (SPHERE, CYLINDER))
    across = local * local.new_tensor([1.0, 1.0, 0.0])
    up = torch.where(sphere, normalize(local), torch.where(cylinder, normalize(across), local.new_tensor([0.0, 0, 1])))
    local = torch.where(sphere, up, torch.where(cylinder, up + (local - across), across))
    up = transform_normal(inverse, up)
    sign = torch.where(surfaces.flip[shape], -1.0, 1.0).to(local)[:, None]
    normal = normalize(up) * sign
    area = up * torch.linalg.det(matrix[:, :3, :3])[:, None]
    return Glued(transform_point(matrix, local), normal, normal, uv, area)


def _on_height_field(surfaces: Surfaces, index: int, uv: torch.Tensor) -> Glued:
    matrix, (heights, interpolation) = surfaces.to_world[index], surfaces.heights[index]
    z, z_u, z_v = evaluate(heights, uv, interpolation)
    local = torch.cat([2 * uv - 1, z[:, None]], 1)
    up = transform_normal(inverse_linear(matrix), torch.stack([-z_u / 2, -z_v / 2, torch.ones_like(z)], 1))
    normal = normalize(up) * (-1.0 if bool(surfaces.flip[index]) else 1.0)
    area = up * torch.linalg.det(matrix[:3, :3])
    return Glued(transform_point(matrix, local), normal, normal, uv, area)
