"""Edges of all meshes of a scene, and which faces meet at each."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..scene.hashing import hash_places
from ..surface import CYLINDER, DISK, MESH, SPHERE, Surfaces

# Contour, rim, lower and upper rim, left and right line, as csrc/host/outline_set.h counts them.
CURVES = {SPHERE: (0,), DISK: (1,), CYLINDER: (2, 3, 4, 5)}


@dataclass
class Edges:
    """E edges, of which the faces that meet there have H. Valid while vertices that are in one place still are.

    All int64.

    Attributes:
        halves: (H, 5) the ends, in the same order for all faces of an edge; the third corner; the shape; 1 where the
            face has the ends the other way round.
        begin: (E + 1,) where those of each edge begin.
        copies: (D, 4) two vertices in one place, and their shapes.
        curves: (C, 2) shapes and kinds of what can be an outline of quadrics.
        first_vertex: (S,) of each shape.
    """

    halves: torch.Tensor
    begin: torch.Tensor
    copies: torch.Tensor
    curves: torch.Tensor
    first_vertex: torch.Tensor


def weld(positions: torch.Tensor) -> torch.Tensor:
    """For each vertex (V, 3) the first one that is in the same place, by hashes."""
    key = hash_places(positions)
    order = torch.argsort(key, stable=True)
    ordered = key[order]
    first = torch.ones_like(ordered, dtype=torch.bool)
    first[1:] = ordered[1:] != ordered[:-1]
    leader = order[first][torch.cumsum(first, 0) - 1]
    return torch.empty_like(order).index_copy_(0, order, leader)


def find_edges(surfaces: Surfaces) -> Edges:
    """The edges between vertices, welded where these are in one place; faces without an area have no part in it."""
    faces, positions = surfaces.faces, surfaces.positions.detach()
    meshes = (surfaces.kind == MESH).nonzero()[:, 0]
    count = torch.diff(torch.cat([surfaces.first_face[meshes], torch.tensor([len(faces)])]))
    shape = meshes.repeat_interleave(count)
    where = weld(positions)
    corner = positions[faces]
    area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).abs().amax(1)
    whole = (area > 0).nonzero()[:, 0]
    v0, v1, third = (faces[whole].roll(-k, 1).flatten() for k in range(3))
    a, b = where[v0], where[v1]
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    turned = a != low
    order = torch.argsort(low * (len(positions) + 1) + high, stable=True)
    key = (low * (len(positions) + 1) + high)[order]
    _, number = torch.unique_consecutive(key, return_counts=True)
    ends = [torch.where(turned, v1, v0), torch.where(turned, v0, v1)]
    halves = torch.stack([*ends, third, shape[whole].repeat_interleave(3), turned.long()], 1)[order]
    shape_of_vertex = torch.zeros_like(where)
    shape_of_vertex[faces] = shape[:, None].expand(-1, 3)
    copied = (where != torch.arange(len(where))).nonzero()[:, 0]
    both = [copied, where[copied], shape_of_vertex[copied], shape_of_vertex[where[copied]]]
    curves = [(i, c) for i, kind in enumerate(surfaces.kind.tolist()) for c in CURVES.get(kind, ())]
    return Edges(
        halves=halves,
        begin=torch.cat([torch.zeros(1, dtype=torch.int64), torch.cumsum(number, 0)]),
        copies=torch.stack(both, 1),
        curves=torch.tensor(curves, dtype=torch.int64).reshape(-1, 2),
        first_vertex=surfaces.first_vertex,
    )
