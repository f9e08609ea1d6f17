"""Outlines that points on surfaces, or lights, see: one is chosen for each of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .outlines import OutlinePoints, Pieces
from .sampling import Boundary
from .tree import Anchors, OutlineTree

STILL = 0.1  # weight of outlines that rest: they count where what sees them moves


@dataclass
class Chosen:
    """Of those anchors, `rows` (M,), that see something: points on outlines, and one over their density by length."""

    rows: torch.Tensor
    point: OutlinePoints
    inverse: torch.Tensor


class Choice:
    """All outlines of a scene, and a tree of them."""

    def __init__(self, scene: Boundary) -> None:
        self.scene, outlines, given = scene, scene.outlines, scene.given
        with torch.no_grad():
            self.edges, rows = outlines.all()
            round_ = outlines.quadrics()
            moves = given.moves[outlines.shape_of_face[self.edges.face]].any(1)
            shapes = torch.tensor([shape for shape, _ in outlines.curves], dtype=torch.int64)
            moves = torch.cat([moves, given.moves[shapes]])
            rows = torch.cat([rows, round_.to(rows)])
            rows[:, 12] *= torch.where(moves, 1.0, STILL)
            layout = scene.call.layout
            key, table, *known = layout.edges
            self.tree = OutlineTree(scene.call.native.core, rows, known[0] if known else None)
            layout.edges = (key, table, self.tree.order)

    def __len__(self) -> int:
        return len(self.edges) + len(self.scene.outlines.curves)

    def draw(self, anchors: Anchors, seed: int, parallel: bool = False) -> Chosen:
        """For points, or for directions if `parallel`."""
        with torch.no_grad():
            element, s, inverse = self.tree.choose(anchors, parallel, seed, self.scene.threads)
            rows = ((element >= 0) & (inverse > 0)).nonzero()[:, 0]
            element, s, inverse, origin = element[rows], s[rows], inverse[rows], anchors.point[rows].detach()
            count, none = len(self.edges), torch.zeros_like(s)
            on_edge = element < count
            curves = torch.tensor([*self.scene.outlines.curves, (-1, -1)])
            shape, curve = curves[torch.where(on_edge, -1, element - count)].T
            pieces = Pieces(torch.where(on_edge, element, -1), shape, curve, none, none, none)
        found = self.scene.outlines.points(self.edges, pieces, s, origin, parallel)
        with torch.no_grad():
            length = torch.linalg.vector_norm(found.along, dim=1)
            kept = (found.valid & (length > 0)).nonzero()[:, 0]
        return Chosen(rows[kept], found[kept], inverse[kept] * length[kept])
