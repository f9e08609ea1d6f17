"""Media that bend light and touch, overlap or are nested: refused before anything is rendered, if certain.

Rays find points of both boundaries where their boxes overlap. A point a little outside of one of them that is in the
other medium, as several rays from it agree on, is certain.
"""

from __future__ import annotations

import torch

from ..queries import find_hits
from ..scene.native import NativeScene
from ..scene.packing import Layout, Record, records
from ..scene.plugin import Plugin
from ..scene.scene import Scene
from .around import MOST_SURFACES, after, media_around

RAYS = 256  # for each two shapes whose boxes overlap
DIRECTIONS = 3  # from a point


def check_apart(scene: Scene, layout: Layout, native: NativeScene, tensors: list[torch.Tensor]) -> None:
    """ValueError, naming both shapes, where the medium of one is certainly in that of another, or touches it."""
    shapes = records(layout, "shape")
    bending = [row for row, shape in enumerate(shapes) if shape.field["interior"] in layout.bending]
    if len({shapes[row].field["interior"] for row in bending}) < 2:
        return
    boxes = torch.stack([_box(scene, shapes[row]).to(native.dtype) for row in bending])
    slack = 1e-4 * (1 + boxes.abs().amax())
    low = torch.maximum(boxes[:, None, 0], boxes[None, :, 0]) - slack
    high = torch.minimum(boxes[:, None, 1], boxes[None, :, 1]) + slack
    for i, j in (low <= high).all(2).triu(1).nonzero().tolist():
        pair = bending[i], bending[j]
        if shapes[pair[0]].field["interior"] == shapes[pair[1]].field["interior"]:
            continue
        both = torch.stack([boxes[[i, j], 0].amin(0), boxes[[i, j], 1].amax(0)])
        found = _inside(layout, native, tensors, shapes, pair, torch.stack([low[i, j], high[i, j]]), both)
        if found is not None:
            inner, outer = found
            raise ValueError(
                f"render: {inner}: touches the gradientindex medium of {outer}, or is in it: such media must be apart, "
                "since light leaves them into what does not bend it; one medium, whose grid has both, is rendered"
            )


def _box(scene: Scene, shape: Record) -> torch.Tensor:
    module = scene._modules[shape.path]
    assert isinstance(module, Plugin)
    return module.bounds()


def _inside(
    layout: Layout,
    native: NativeScene,
    tensors: list[torch.Tensor],
    shapes: list[Record],
    pair: tuple[int, int],
    common: torch.Tensor,
    both: torch.Tensor,
) -> tuple[str, str] | None:
    """Of two shapes the one whose outside is in the other's medium somewhere, and that one.

    `common`, `both` (2, 3): the boxes that they share, and that has both in it.
    """
    generator = torch.Generator().manual_seed(0)
    random = torch.rand(RAYS, 6, generator=generator, dtype=torch.float64).to(native.dtype)
    d = torch.nn.functional.normalize(random[:, 3:] - 0.5, dim=1)
    o = common[0] + random[:, :3] * (common[1] - common[0]) - d * (both[1] - both[0]).norm()
    met = []
    for _ in range(MOST_SURFACES):
        hits = find_hits(native, tensors, o, d, o.new_full((len(o),), torch.inf))
        met.append((hits.shape_id, hits.position, hits.normal))
        o, d = after(hits.position, d)[hits.valid], d[hits.valid]
        if not len(o):
            break
    rows, positions, normals = (torch.cat(parts) for parts in zip(*met, strict=True))
    for row in pair:
        here = (rows == row).nonzero()[:, 0].repeat(DIRECTIONS)
        turned = torch.rand(len(here), 3, generator=generator, dtype=torch.float64).to(native.dtype) - 0.5
        away = torch.nn.functional.normalize(normals[here] + turned, dim=1)
        points = after(positions[here], normals[here])
        found = media_around(layout, native, tensors, points, away, shapes[row].field["interior"])
        count = len(here) // DIRECTIONS
        for around, *others in zip(*(found[k * count : (k + 1) * count] for k in range(DIRECTIONS)), strict=True):
            if around is not None and all(other == around for other in others):
                return shapes[row].path, around
    return None
