"""Which medium that bends light a point is in.

One ray from it tells: the first boundary of such a medium that it meets, whatever else is on the way, it meets from
inside or from outside.
"""

from __future__ import annotations

import torch

from ..queries import find_hits
from ..scene.native import NativeScene
from ..scene.packing import Layout, records

MOST_SURFACES = 64  # on the way of one


def after(position: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Points (N, 3) off surfaces at `position`, along unit vectors."""
    return position + 1e-4 * (1 + position.abs().amax(1, True)) * direction


def media_around(
    layout: Layout,
    native: NativeScene,
    tensors: list[torch.Tensor],
    points: torch.Tensor,
    directions: torch.Tensor,
    but: int = -1,
) -> list[str | None]:
    """For each point (N, 3) the shape whose medium it is in, None where that does not bend light.

    `directions`: unit vectors (N, 3), of the rays; `but`: the number of a medium whose boundaries do not count.
    """
    bending = {
        row: shape.path
        for row, shape in enumerate(records(layout, "shape"))
        if shape.field["interior"] in layout.bending and shape.field["interior"] != but
    }
    found: list[str | None] = [None] * len(points)
    rows, o, d = torch.arange(len(points)), points, directions
    for _ in range(MOST_SURFACES):
        if not len(rows):
            break
        hits = find_hits(native, tensors, o, d, o.new_full((len(o),), torch.inf))
        behind = ((hits.normal * d).sum(1) > 0).tolist()
        shapes = hits.shape_id.tolist()
        for row, shape, leaves in zip(rows.tolist(), shapes, behind, strict=True):
            if leaves:
                found[row] = bending.get(shape)
        on = torch.tensor([shape >= 0 and shape not in bending for shape in shapes], dtype=torch.bool)
        rows, o, d = rows[on], after(hits.position, d)[on], d[on]
    return found
