"""The derivatives of a surface's position by its texture coordinates: csrc/core/shape/partials.h."""

from __future__ import annotations

import math

import torch

from ..heightfield import evaluate
from ..surface import CURVE, CYLINDER, HEIGHT_FIELD, MESH, SDF_GRID, SPHERE, inverse_linear, transform_vector
from .world import At, World


def partials(world: World, at: At, p: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """dp/du and dp/dv (N, 3) at points p (N, 3); zero on grids of distances, which have no coordinates."""
    surfaces = world.surfaces
    kind = surfaces.kind[at.shape]
    other = (kind == MESH) | (kind == HEIGHT_FIELD) | (kind == CURVE) | (kind == SDF_GRID)
    flat, curved = (kind == MESH).nonzero()[:, 0], (~other).nonzero()[:, 0]
    pieces = [(flat, _along_triangles(world, at[flat])), (curved, _along_quadrics(world, at.shape[curved], p[curved]))]
    for index in surfaces.heights:
        rows = (at.shape == index).nonzero()[:, 0]
        pieces.append((rows, _along_heights(world, index, at.barycentric[rows])))
    for index, (*_, segments, _straight) in surfaces.curves.items():
        rows = (at.shape == index).nonzero()[:, 0]
        here = at[rows]
        _, along, around = surfaces.segments(index, here.primitive).evaluate(*here.barycentric.unbind(1))
        pieces.append((rows, (around, along * len(segments))))
    du = dv = torch.zeros_like(p)
    for rows, (u, v) in pieces:
        du, dv = du.index_put((rows,), u), dv.index_put((rows,), v)
    return du, dv


def _along_triangles(world: World, at: At) -> tuple[torch.Tensor, torch.Tensor]:
    """Along the edges where there are no texture coordinates; zero where these do not vary."""
    surfaces = world.surfaces
    corner = surfaces.faces[surfaces.first_face[at.shape] + at.primitive]
    p, uv = surfaces.positions[corner], surfaces.texcoords[corner]
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    u1, v1 = (uv[:, 1] - uv[:, 0]).unbind(1)
    u2, v2 = (uv[:, 2] - uv[:, 0]).unbind(1)
    determinant = u1 * v2 - u2 * v1
    usable, textured = determinant != 0, surfaces.textured[at.shape][:, None]
    inverse = torch.where(usable, 1 / torch.where(usable, determinant, 1.0), 0.0)[:, None]
    du, dv = (e1 * v2[:, None] - e2 * v1[:, None]) * inverse, (e2 * u1[:, None] - e1 * u2[:, None]) * inverse
    return torch.where(textured, du, e1), torch.where(textured, dv, e2)


def _along_quadrics(world: World, shape: torch.Tensor, p: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Azimuth and polar angle of a sphere, radius and azimuth of a disk, azimuth and height of a cylinder."""
    matrix, kind = world.surfaces.to_world[shape], world.surfaces.kind[shape][:, None]
    x, y, z = transform_vector(inverse_linear(matrix), p - matrix[:, :3, 3]).unbind(1)
    zero, pole = torch.zeros_like(x), (x == 0) & (y == 0)
    x = torch.where(pole, 1e-15, x)  # where azimuths jump, that of the x axis
    r = torch.sqrt(x * x + y * y)
    around = 2 * math.pi * torch.stack([-y, x, zero], 1)
    out = torch.stack([x / r, y / r, zero], 1)
    down = math.pi * torch.stack([z * x / r, z * y / r, -r], 1)
    axis = torch.stack([zero, zero, zero + 1], 1)
    du = torch.where((kind == SPHERE) | (kind == CYLINDER), around, out)
    dv = torch.where(kind == SPHERE, down, torch.where(kind == CYLINDER, axis, around))
    return transform_vector(matrix, du), transform_vector(matrix, dv)


def _along_heights(world: World, index: int, uv: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    heights, interpolation = world.surfaces.heights[index]
    _, z_u, z_v = evaluate(heights, uv, interpolation)
    zero, two, matrix = torch.zeros_like(z_u), torch.full_like(z_u, 2.0), world.surfaces.to_world[index]
    u, v = torch.stack([two, zero, z_u], 1), torch.stack([zero, two, z_v], 1)
    return transform_vector(matrix, u), transform_vector(matrix, v)
