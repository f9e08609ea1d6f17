"""Textures: functions of the world, the texture's record and surface points, to colours (N, C)."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from torchrender.heightfield import evaluate as evaluate_heights
from torchrender.surface import CYLINDER, DISK, MESH, SPHERE, transform_point

from .world import At, Record, World


def constant(world: World, record: Record, at: At) -> torch.Tensor:
    return world.tensor("texture", record, "value").expand(len(at), world.channels)


def image_coordinates(world: World, record: Record, at: At) -> torch.Tensor:
    """`to_uv` applied to texture coordinates: (N, 2)."""
    matrix = world.tensor("texture", record, "to_uv")
    return at.uv @ matrix[:2, :2].T + matrix[:2, 2]


def wrap(i: torch.Tensor, n: int, mode: int) -> torch.Tensor:
    """Texel indices in range: repeated, mirrored or clamped."""
    if mode == 2:
        return i.clamp(0, n - 1)
    if mode == 0:
        return i % n
    r = i % (2 * n)
    return torch.where(r >= n, 2 * n - 1 - r, r)


def bilinear(
    data: torch.Tensor, rows: tuple, columns: tuple, a: torch.Tensor, b: torch.Tensor, channels: int
) -> torch.Tensor:
    """Texels between two rows and two columns, at the fractions a (across) and b (down): (N, C)."""
    (y0, y1), (x0, x1), a, b = rows, columns, a[:, None], b[:, None]
    upper = data[y0, x0] * (1 - a) + data[y0, x1] * a
    lower = data[y1, x0] * (1 - a) + data[y1, x1] * a
    return (upper * (1 - b) + lower * b).expand(-1, channels)


def bitmap(world: World, record: Record, at: At) -> torch.Tensor:
    data = world.tensor("texture", record, "data")
    height, width = data.shape[:2]
    mode = record.field["wrap_mode"]
    uv = image_coordinates(world, record, at)
    if record.field["filter_type"] == 1:  # nearest
        x, y = torch.floor(uv[:, 0].detach() * width).long(), torch.floor(uv[:, 1].detach() * height).long()
        return data[wrap(y, height, mode), wrap(x, width, mode)].expand(-1, world.channels)
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    columns = tuple(wrap(left.long() + k, width, mode) for k in (0, 1))
    rows = tuple(wrap(top.long() + k, height, mode) for k in (0, 1))
    return bilinear(data, rows, columns, x - left, y - top, world.channels)


def slopes(world: World, record: Record, at: At) -> torch.Tensor:
    """The derivatives (N, 2) of a bilinear bitmap's luminance by the texture coordinates; of others, zero."""
    if record.type != "bitmap" or record.field["filter_type"] == 1:
        return torch.zeros(len(at), 2, dtype=torch.float64)
    data = world.tensor("texture", record, "data").expand(-1, -1, 3)
    data = (data * data.new_tensor([0.2126, 0.7152, 0.0722])).sum(2)
    height, width = data.shape
    mode = record.field["wrap_mode"]
    uv = image_coordinates(world, record, at)
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    (x0, x1), (y0, y1) = ([wrap(i.long() + k, n, mode) for k in (0, 1)] for i, n in ((left, width), (top, height)))
    a, b = x - left, y - top
    across = ((1 - b) * (data[y0, x1] - data[y0, x0]) + b * (data[y1, x1] - data[y1, x0])) * width
    down = ((1 - a) * (data[y1, x0] - data[y0, x0]) + a * (data[y1, x1] - data[y0, x1])) * height
    matrix = world.tensor("texture", record, "to_uv")[:2, :2]
    return across[:, None] * matrix[0] + down[:, None] * matrix[1]


def checkerboard(world: World, record: Record, at: At) -> torch.Tensor:
    uv = image_coordinates(world, record, at).detach()
    right, lower = (uv - torch.floor(uv) > 0.5).unbind(1)
    first = world.color("texture", record, "color0", at)
    second = world.color("texture", record, "color1", at)
    return torch.where((right ^ lower)[:, None], second, first)


def mesh_attribute(world: World, record: Record, at: At) -> torch.Tensor:
    scale = world.tensor("texture", record, "scale")
    result = torch.zeros(len(at), world.channels, dtype=world.scene.dtype)
    for attribute in world.records["attribute"]:
        if attribute.field["name"] != record.field["name"]:
            continue
        rows = (at.shape == attribute.field["shape"]).nonzero()[:, 0]
        shape, primitive = at.shape[rows], at.primitive[rows]
        data = world.tensor("attribute", attribute, "data")
        if attribute.field["per_face"]:
            value = data[primitive]
        else:
            corner = world.surfaces.faces[world.surfaces.first_face[shape] + primitive]
            corner = corner - world.surfaces.first_vertex[shape][:, None]
            b1, b2 = at.barycentric[rows].unbind(1)
            value = (data[corner] * torch.stack([1 - b1 - b2, b1, b2], 1)[..., None]).sum(1)
        result = result.index_put((rows,), (value * scale).expand(-1, world.channels))
    return result


def surface_position(world: World, at: At) -> torch.Tensor:
    """Where points are in the world (N, 3), from their coordinates."""
    surfaces = world.surfaces
    kind, matrix = surfaces.kind[at.shape], surfaces.to_world[at.shape]
    result = torch.zeros(len(at), 3, dtype=world.scene.dtype)
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
    return result


def volume(world: World, record: Record, at: At) -> torch.Tensor:
    from . import volumes

    return volumes.evaluate(world, record.field["volume"], surface_position(world, at))


TEXTURES: dict[str, Callable[[World, Record, At], torch.Tensor]] = {
    "constant": constant,
    "bitmap": bitmap,
    "checkerboard": checkerboard,
    "mesh_attribute": mesh_attribute,
    "volume": volume,
}
