"""Edges of all meshes of a scene, and which faces meet at each."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..scene.hashing import hash_places


@dataclass
class Edges:
    """E edges with K faces each; of an edge that has fewer the first ones stand there again.

    Attributes:
        v0, v1, third: (E, K) indices of vertices: both ends as each face has them, and its third corner.
        face: (E, K) faces. count: (E,) how many there are.
    """

    v0: torch.Tensor
    v1: torch.Tensor
    third: torch.Tensor
    face: torch.Tensor
    count: torch.Tensor

    def __len__(self) -> int:
        return len(self.count)

    def rows(self, wanted: torch.Tensor) -> Edges:
        return Edges(self.v0[wanted], self.v1[wanted], self.third[wanted], self.face[wanted], self.count[wanted])


@dataclass
class EdgeTable:
    """Edges with up to two faces, and those with more. Valid while the vertices that were in one place still are."""

    plain: Edges
    fans: Edges
    copies: torch.Tensor  # (D, 2) vertices in one place

    def holds(self, positions: torch.Tensor) -> bool:
        return bool((positions[self.copies[:, 0]] == positions[self.copies[:, 1]]).all())


def weld(positions: torch.Tensor) -> torch.Tensor:
    """For each vertex (V, 3) the first one that is in the same place, by hashes."""
    key = hash_places(positions)
    order = torch.argsort(key, stable=True)
    ordered = key[order]
    first = torch.ones_like(ordered, dtype=torch.bool)
    first[1:] = ordered[1:] != ordered[:-1]
    leader = order[first][torch.cumsum(first, 0) - 1]
    return torch.empty_like(order).index_copy_(0, order, leader)


def edge_table(faces: torch.Tensor, positions: torch.Tensor) -> EdgeTable:
    """The edges of faces (F, 3) between vertices (V, 3), welded where these are in one place.

    Faces without an area have no part in it.
    """
    positions = positions.detach()
    where = weld(positions)
    corner = positions[faces]
    area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).abs().amax(1)
    whole = (area > 0).nonzero()[:, 0]
    v0, v1, third = (faces[whole].roll(-k, 1).flatten() for k in range(3))
    face = whole.repeat_interleave(3)
    a, b = where[v0], where[v1]
    low, high = torch.minimum(a, b), torch.maximum(a, b)
    turned = (a != low)[:, None]
    ends = torch.where(turned, torch.stack([v1, v0], 1), torch.stack([v0, v1], 1))  # from `low` to `high` in all faces
    key = low * (len(positions) + 1) + high
    order = torch.argsort(key, stable=True)
    _, count = torch.unique_consecutive(key[order], return_counts=True)
    begin = torch.cumsum(count, 0) - count

    def gather(wanted: torch.Tensor, width: int) -> Edges:
        step = torch.arange(width, device=count.device)
        own = torch.where(step < count[wanted, None], step, torch.zeros_like(step))
        half = order[begin[wanted, None] + own]
        return Edges(ends[half, 0], ends[half, 1], third[half], face[half], count[wanted])

    copied = (where != torch.arange(len(where), device=where.device)).nonzero()[:, 0]
    more = count > 2
    return EdgeTable(
        gather((~more).nonzero()[:, 0], 2),
        gather(more.nonzero()[:, 0], int(count.max()) if bool(more.any()) else 2),
        torch.stack([copied, where[copied]], 1),
    )
