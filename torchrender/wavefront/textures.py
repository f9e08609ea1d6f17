"""Textures: functions of the world, the texture's record and surface points, to colours (N, C)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from .world import At, Record, World


def constant(world: World, record: Record, at: At) -> torch.Tensor:
    return world.tensor("texture", record, "value").expand(len(at), world.channels)


def image_coordinates(world: World, record: Record, at: At) -> torch.Tensor:
    """`to_uv` applied to texture coordinates: (N, 2)."""
    matrix = world.tensor("texture", record, "to_uv")
    return (matrix[:2, :2] * at.uv[:, None]).sum(2) + matrix[:2, 2]


def wrap(i: torch.Tensor, n: int, mode: int) -> torch.Tensor:
    """Texel indices in range: repeated, mirrored or clamped."""
    if mode == 2:
        return i.clamp(0, n - 1)
    if mode == 0:
        return i % n
    r = i % (2 * n)
    return torch.where(r >= n, 2 * n - 1 - r, r)


def texels(data: torch.Tensor, row: torch.Tensor, column: torch.Tensor) -> torch.Tensor:
    """``data[row, column]`` for data (H, W, C): one gather, whose adjoint is one sum."""
    flat = data.reshape(-1, data.shape[-1])
    return flat.index_select(0, (row * data.shape[1] + column).flatten()).reshape(*row.shape, data.shape[-1])


def bilinear(
    data: torch.Tensor, rows: tuple, columns: tuple, a: torch.Tensor, b: torch.Tensor, channels: int
) -> torch.Tensor:
    """Texels between two rows and two columns, at the fractions a (across) and b (down): (N, C)."""
    (y0, y1), (x0, x1), a, b = rows, columns, a[:, None], b[:, None]
    corner = texels(data, torch.stack([y0, y0, y1, y1]), torch.stack([x0, x1, x0, x1]))
    upper = corner[0] * (1 - a) + corner[1] * a
    lower = corner[2] * (1 - a) + corner[3] * a
    return (upper * (1 - b) + lower * b).expand(-1, channels)


def bitmap(world: World, record: Record, at: At) -> torch.Tensor:
    data = world.tensor("texture", record, "data")
    height, width = data.shape[:2]
    mode = record.field["wrap_mode"]
    uv = image_coordinates(world, record, at)
    if record.field["filter_type"] == 1:  # nearest
        x, y = torch.floor(uv[:, 0].detach() * width).long(), torch.floor(uv[:, 1].detach() * height).long()
        return texels(data, wrap(y, height, mode), wrap(x, width, mode)).expand(-1, world.channels)
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    columns = tuple(wrap(left.long() + k, width, mode) for k in (0, 1))
    rows = tuple(wrap(top.long() + k, height, mode) for k in (0, 1))
    return bilinear(data, rows, columns, x - left, y - top, world.channels)


def checkerboard(world: World, record: Record, at: At) -> torch.Tensor:
    uv = image_coordinates(world, record, at).detach()
    right, lower = (uv - torch.floor(uv) > 0.5).unbind(1)
    first = world.color("texture", record, "color0", at)
    second = world.color("texture", record, "color1", at)
    return torch.where((right ^ lower)[:, None], second, first)


def mesh_attribute(world: World, record: Record, at: At) -> torch.Tensor:
    scale = world.tensor("texture", record, "scale")
    result = torch.zeros(len(at), world.channels, dtype=world.dtype)
    for attribute in world.records["attribute"]:
        if attribute.field["name"] != record.field["name"]:
            continue
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
        result = result.index_put((rows,), (value * scale).expand(-1, world.channels))
    return result


TEXTURES: dict[str, Callable[[World, Record, At], torch.Tensor]] = {
    "constant": constant,
    "bitmap": bitmap,
    "checkerboard": checkerboard,
    "mesh_attribute": mesh_attribute,
}
