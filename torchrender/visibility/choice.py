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
            self.curves, round_ = outlines.quadrics()
            moves = given.moves[outlines.shape_of_face[self.edges.face]].any(1)
            shapes = torch.tensor([shape for shape, _ in self.curves], dtype=torch.int64)
            moves = torch.cat([moves, given.moves[shapes]])
            rows = torch.cat([rows, round_.to(rows)])
            rows[:, 12] *= torch.where(moves, 1.0, STILL)
            layout = scene.call.layout
            key, table, *known = layout.edges
            self.tree = OutlineTree(scene.call.native.core, rows, known[0] if known else None)
            layout.edges = (key, table, self.tree.order)

    def __len__(self) -> int:
        return len(self.edges) + len(self.curves)

    def draw(self, anchors: Anchors, seed: int) -> Chosen:
        with torch.no_grad():
            element, s, inverse = self.tree.choose(anchors, seed, self.scene.threads)
            rows = ((element >= 0) & (inverse > 0)).nonzero()[:, 0]
            element, s, inverse, origin = element[rows], s[rows], inverse[rows], anchors.point[rows].detach()
            parallel = anchors.parallel[rows] != 0
        found = self._points(element, s, origin, parallel)
        with torch.no_grad():
            length = torch.linalg.vector_norm(found.along, dim=1)
            kept = (found.valid & (length > 0)).nonzero()[:, 0]
        point = OutlinePoints(*(getattr(found, n)[kept] for n in OutlinePoints.__dataclass_fields__))
        return Chosen(rows[kept], point, inverse[kept] * length[kept])

    def _points(
        self, element: torch.Tensor, s: torch.Tensor, origin: torch.Tensor, parallel: torch.Tensor
    ) -> OutlinePoints:
        count = len(self.edges)
        on_edge = element < count
        quadric = torch.tensor([*self.curves, (-1, -1)])[torch.where(on_edge, -1, element - count)]
        none = torch.zeros_like(s)
        pieces = Pieces(torch.where(on_edge, element, -1), quadric[:, 0], quadric[:, 1], none, none, none)
        kinds = [(rows.nonzero()[:, 0], way) for rows, way in ((~parallel, False), (parallel, True))]
        found, order = [], []
        for rows, way in kinds:
            if len(rows):
                found.append(self.scene.outlines.points(self.edges, pieces[rows], s[rows], origin[rows], way))
                order.append(rows)
        if len(found) == 1:
            return found[0]
        back = torch.argsort(torch.cat(order)) if order else none.long()
        if not found:
            return self.scene.outlines.points(self.edges, pieces, s, origin, False)
        return OutlinePoints(
            *(torch.cat([getattr(f, n) for f in found])[back] for n in OutlinePoints.__dataclass_fields__)
        )
