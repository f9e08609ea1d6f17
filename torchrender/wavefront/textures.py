"""Textures: functions of the world, the texture's record and surface points, to values (N, K).

K is the number of channels that the texture has: one, the scene's, or three components of normals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from ..heightfield import evaluate as evaluate_heights
from ..sdfgrid import place as place_on_grid
from ..surface import CYLINDER, DISK, MESH, SPHERE, transform_point
from . import volumes
from .color import luminance
from .texels import Pair, bilinear, texels, wrap

if TYPE_CHECKING:
    from ..scene.packing import Record
    from .world import At, World


def constant(world: World, record: Record, at: At) -> torch.Tensor:
    """One colour."""
    return world.tensor("texture", record, "value").reshape(1, -1).expand(len(at), -1)


def image_coordinates(world: World, record: Record, at: At) -> torch.Tensor:
    """`to_uv` applied to texture coordinates: (N, 2)."""
    matrix = world.tensor("texture", record, "to_uv")
    return (matrix[:2, :2] * at.uv[:, None]).sum(2) + matrix[:2, 2]


def cell(
    world: World, record: Record, at: At, height: int, width: int
) -> tuple[Pair, Pair, torch.Tensor, torch.Tensor]:
    """Of a bitmap of this size the two rows and two columns around points, and fractions across and down between."""
    uv, mode = image_coordinates(world, record, at), record.field["wrap_mode"]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    columns = wrap(left.long(), width, mode), wrap(left.long() + 1, width, mode)
    rows = wrap(top.long(), height, mode), wrap(top.long() + 1, height, mode)
    return rows, columns, x - left, y - top


def bitmap(world: World, record: Record, at: At) -> torch.Tensor:
    """An image, nearest or bilinear."""
    return interpolated(world, record, world.tensor("texture", record, "data"), at)


def interpolated(world: World, record: Record, data: torch.Tensor, at: At) -> torch.Tensor:
    """What a bitmap with the texels (H, W, K) shows."""
    height, width = data.shape[:2]
    if record.field["filter_type"] == 1:  # nearest
        uv, mode = image_coordinates(world, record, at), record.field["wrap_mode"]
        x, y = torch.floor(uv[:, 0].detach() * width).long(), torch.floor(uv[:, 1].detach() * height).long()
        return texels(data, wrap(y, height, mode), wrap(x, width, mode))
    rows, columns, a, b = cell(world, record, at, height, width)
    return bilinear(data, rows, columns, a, b, data.shape[2])


def slopes(world: World, record: Record, at: At) -> torch.Tensor:
    """The derivatives (N, 2) of a bilinear bitmap's luminance by the texture coordinates; of others, zero."""
    if record.type != "bitmap" or record.field["filter_type"] == 1:
        return torch.zeros(len(at), 2, dtype=world.dtype)
    data = luminance(world.tensor("texture", record, "data").expand(-1, -1, 3))
    height, width = data.shape
    (y0, y1), (x0, x1), a, b = cell(world, record, at, height, width)
    corner = texels(data[..., None], torch.stack([y0, y0, y1, y1]), torch.stack([x0, x1, x0, x1]))[..., 0]
    across = ((1 - b) * (corner[1] - corner[0]) + b * (corner[3] - corner[2])) * width
    down = ((1 - a) * (corner[2] - corner[0]) + a * (corner[3] - corner[1])) * height
    matrix = world.tensor("texture", record, "to_uv")[:2, :2]
    return across[:, None] * matrix[0] + down[:, None] * matrix[1]


def checkerboard(world: World, record: Record, at: At) -> torch.Tensor:
    """Two textures in alternating squares."""
    uv = image_coordinates(world, record, at).detach()
    right, lower = (uv - torch.floor(uv) > 0.5).unbind(1)
    first, second = (world.look_up("texture", record, name, at) for name in ("color0", "color1"))
    return torch.where((right ^ lower)[:, None], second, first)


def mesh_attribute(world: World, record: Record, at: At) -> torch.Tensor:
    """Colours of meshes, interpolated or constant on faces; zero on shapes that have none of the name."""
    scale = world.tensor("texture", record, "scale")
    found = [a for a in world.records["attribute"] if a.field["name"] == record.field["name"]]
    widths = [world.tensor("attribute", a, "data").shape[1] for a in found]
    result = torch.zeros(len(at), max(widths, default=1), dtype=world.dtype)
    for attribute in found:
        rows = (at.shape == attribute.field["shape"]).nonzero()[:, 0]
        shape, primitive = at.shape[rows], at.primitive[rows]
        data = world.tensor("attribute", attribute, "data")
        if attribute.field["per_face"]:
            value = data.index_select(0, primitive)
        else:
            corner = world.surfaces.faces[world.surfaces.first_face[shape] + primitive]
            corner = corner - world.surfaces.first_vertex[shape][:, None]
            b1, b2 = at.barycentric[rows].unbind(1)
            weight = torch.stack([1 - b1 - b2, b1, b2], 1)[..., None]
            value = (data.index_select(0, corner.flatten()).reshape(*corner.shape, data.shape[-1]) * weight).sum(1)
        result = result.index_put((rows,), (value * scale).expand(-1, result.shape[1]))
    return result


def surface_position(world: World, at: At) -> torch.Tensor:
    """Where points are in the world (N, 3), from their coordinates."""
    surfaces = world.surfaces
    kind, matrix = surfaces.kind[at.shape], surfaces.to_world[at.shape]
    result = torch.zeros(len(at), 3, dtype=world.dtype)
    flat = (kind == MESH).nonzero()[:, 0]
    if len(flat):
        corner = surfaces.faces[surfaces.first_face[at.shape[flat]] + at.primitive[flat]]
        b = at.barycentric[flat]
        weight = torch.cat([1 - b.sum(1, keepdim=True), b], 1)[..., None]
        result = result.index_put((flat,), (surfaces.positions[corner] * weight).sum(1))
    u, v = at.barycentric.unbind(1)
    phi, theta = 2 * math.pi * u, math.pi * v
    local = {
        SPHERE: [torch.sin(theta) * torch.cos(phi), torch.sin(theta) * torch.sin(phi), torch.cos(theta)],
        CYLINDER: [torch.cos(phi), torch.sin(phi), v],
        DISK: [u * torch.cos(2 * math.pi * v), u * torch.sin(2 * math.pi * v), 0 * u],
    }
    for number, p in local.items():
        rows = (kind == number).nonzero()[:, 0]
        result = result.index_put((rows,), transform_point(matrix[rows], torch.stack(p, 1)[rows]))
    for index, (heights, interpolation) in surfaces.heights.items():
        rows = (at.shape == index).nonzero()[:, 0]
        z = evaluate_heights(heights, at.barycentric[rows], interpolation)[0]
        p = torch.cat([2 * at.barycentric[rows] - 1, z[:, None]], 1)
        result = result.index_put((rows,), transform_point(matrix[rows], p))
    for index in surfaces.curves:
        rows = (at.shape == index).nonzero()[:, 0]
        here = at[rows]
        p, _, _ = surfaces.segments(index, here.primitive).evaluate(*here.barycentric.unbind(1))
        result = result.index_put((rows,), p)
    for index, (grid, _) in surfaces.grids.items():
        rows = (at.shape == index).nonzero()[:, 0]
        p = place_on_grid(grid, at.primitive[rows], at.barycentric[rows])
        result = result.index_put((rows,), transform_point(matrix[rows], p))
    return result


def volume(world: World, record: Record, at: At) -> torch.Tensor:
    """A volume at the places of the surface points in the world."""
    return volumes.evaluate(world, record.field["volume"], surface_position(world, at))


TEXTURES: dict[str, Callable[[World, Record, At], torch.Tensor]] = {
    "constant": constant,
    "bitmap": bitmap,
    "checkerboard": checkerboard,
    "mesh_attribute": mesh_attribute,
    "volume": volume,
}
