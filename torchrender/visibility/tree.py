"""Choice of outlines from points: the tree of csrc/host/outline_tree.h."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from ..wavefront.geometry import Rows

EDGE, ALWAYS, CREASE, ROUND = range(4)  # kinds of elements
ELEMENT = 17  # 32-bit numbers of an element, the last three of which are integers


def elements(
    a: torch.Tensor,
    b: torch.Tensor,
    n0: torch.Tensor,
    n1: torch.Tensor,
    weight: torch.Tensor,
    bend: torch.Tensor,
    kind: torch.Tensor,
    shape: torch.Tensor,
) -> torch.Tensor:
    """Rows of `OutlineElement` (E, 17), as 32-bit numbers; their last column is to be their numbers."""
    numbers = torch.cat([a, b, n0, n1, weight[:, None], bend[:, None]], 1).detach().float()
    whole = torch.stack([kind, shape, torch.zeros_like(kind)], 1).to(torch.int32).view(torch.float32)
    return torch.cat([numbers, whole], 1)


@dataclass
class Anchors(Rows):
    """Where outlines are looked for from: points (N, 3), or directions.

    Light is scattered from there towards d about like (1 - share) max(0, n.d) + share exp(k (axis.d - 1)), with normals
    and axes (N, 3), sharpness and share (N,); a normal of zero: alike in all directions. `own` (N,): a curved shape
    that they are on, or -1.
    """

    point: torch.Tensor
    normal: torch.Tensor
    axis: torch.Tensor
    k: torch.Tensor
    share: torch.Tensor
    own: torch.Tensor

    @classmethod
    def plain(cls, point: torch.Tensor, normal: torch.Tensor, own: int) -> Anchors:
        zero = torch.zeros_like(point[:, 0])
        return cls(point, normal, normal, zero, zero, torch.full_like(zero, own))


class OutlineTree:
    """Over elements (E, 17) of :func:`elements`.

    Args:
        core: the compiled module.
        order: what was found for as many elements before, or None.
    """

    def __init__(self, core: Any, rows: torch.Tensor, order: torch.Tensor | None) -> None:
        rows = rows.contiguous()
        rows.view(torch.int32)[:, -1] = torch.arange(len(rows), dtype=torch.int32)
        known = order is not None and len(order) == len(rows)
        self.order = order = order if known and order is not None else torch.empty(len(rows), dtype=torch.int32)
        if not known:
            places = (0.5 * (rows[:, :3] + rows[:, 3:6])).contiguous()
            core.morton_order(places.data_ptr(), len(rows), order.data_ptr())
        self.tree = core.OutlineTree(rows.data_ptr(), len(rows), order.data_ptr())

    def choose(
        self, anchors: Anchors, parallel: bool, seed: int, threads: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """(N,) each: an element or -1, a place in [0, 1) along it, and one over the density of both.

        Anchors are directions if `parallel`, else points.
        """
        a = anchors
        columns = [a.point, a.normal, a.axis, a.k[:, None], a.share[:, None]]
        rows = torch.cat([c.detach().float() for c in columns], 1)
        whole = torch.stack([torch.full_like(a.own, float(parallel)), a.own], 1).to(torch.int32).view(torch.float32)
        rows = torch.cat([rows, whole], 1).contiguous()
        found = torch.empty(len(rows), 3, dtype=torch.float32)
        self.tree.choose(rows.data_ptr(), len(rows), seed, threads, found.data_ptr())
        real = a.point.dtype
        return found.view(torch.int32)[:, 0].long(), found[:, 1].to(real), found[:, 2].to(real)
