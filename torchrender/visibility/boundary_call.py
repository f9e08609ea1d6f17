"""Which derivatives of moving outlines a rendering has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ..first_hit_call import FirstHitCall
from ..render_call import RenderCall
from ..scene.declaration import models
from ..scene.gather import has_derivative
from ..scene.packing import Layout

PLACING = ("transform", "float", "point", "tensor")  # kinds of fields that may place something
# Of the last two outlines are found that points on surfaces and lights see; the last but one has them in view, too.
SENSORS = ("perspective", "thinlens", "orthographic", "fisheye", "panorama", "distant", "radiancemeter")
STILL = "distant"  # where a ray of it begins is not a function of the film's place
NORMALS, SHADING = ("normals",), ("normals", "texcoords")  # fields of meshes that place nothing
MOVING_LIGHTS = ("point", "spot", "projector", "directional")  # what may move of others are shapes


@dataclass
class BoundaryCall:
    """The boundary term of one rendering.

    `spp` samples a wanted pixel of outlines that the camera sees, and of others, may be fractions; `moves`
    says which shapes may move, all if the camera does. With `by_length` short outlines get fewer samples. `outputs`:
    it is that of outputs besides radiance. `glued`: it is that of light paths, whose points move with their surfaces.
    """

    call: RenderCall
    spp: tuple[float, float]
    moves: torch.Tensor
    by_length: bool
    outputs: FirstHitCall | None = None
    glued: bool = False


def placing_slots(layout: Layout, category: str) -> list[tuple[str, list[int]]]:
    """The types of all objects of a category, and the slots of what may place them."""
    found = []
    for kind, numbers, _ in layout.objects[category]:
        fields = models()[category, kind].fields
        named = [(f.name, n) for n, f in zip(numbers, fields, strict=True) if f.kind in PLACING and n >= 0]
        found.append((kind, [n for name, n in named if name not in SHADING]))
    return found


def normal_slots(layout: Layout) -> list[list[int]]:
    """The slots of the normals of each shape, which move their rims."""
    found = []
    for kind, numbers, _ in layout.objects["shape"]:
        fields = models()["shape", kind].fields
        found.append([n for n, f in zip(numbers, fields, strict=True) if f.name in NORMALS and n >= 0])
    return found


def all_placing_slots(layout: Layout) -> set[int]:
    """The slots of what may place shapes, rims, cameras and lights, but for cameras whose motion has no such term."""
    categories = ("shape", "sensor", "emitter")
    placing = [found for c in categories for found in placing_slots(layout, c)]
    normals = {slot for slots in normal_slots(layout) for slot in slots}
    return normals | {slot for kind, slots in placing if kind != STILL for slot in slots}


def boundary_of(
    call: RenderCall, tensors: Sequence[torch.Tensor], outputs: FirstHitCall | None = None
) -> BoundaryCall | None:
    """The boundary term of a rendering with these tensors; None if nothing that has one may be differentiated."""
    spp = call.spp_visibility
    kind, slots = placing_slots(call.layout, "sensor")[call.config["sensor"]]
    if kind not in SENSORS or spp == (0, 0):
        return None

    def asked(slots: Sequence[int]) -> bool:
        return any(has_derivative(tensors[n]) for n in slots)

    camera = kind != STILL and asked(slots)
    moves = [camera or asked(slots) for _, slots in placing_slots(call.layout, "shape")]
    lights = any(asked(slots) for k, slots in placing_slots(call.layout, "emitter") if k in MOVING_LIGHTS)
    turned = [asked(slots) for slots in normal_slots(call.layout)]
    if not any(moves) and not lights and not any(turned):
        return None
    usual = call.spp_grad / 4, call.spp_grad / 16  # the derivative takes about twice as long
    # of those that the camera sees alone
    if (call.config.get("volumetric") and outputs is None) or not (any(moves) or lights):
        if not any(moves) and not any(turned):
            return None
        usual = usual[0], 0.0
        spp = spp and (spp[0], 0.0)
    glued = outputs is None and call.config["integrator"] == "ptracer"
    moving = torch.tensor(moves, dtype=torch.bool) | torch.tensor(turned, dtype=torch.bool)
    return BoundaryCall(of_light(call) if glued else call, spp or usual, moving, spp is None, outputs, glued)


def of_light(call: RenderCall) -> RenderCall:
    """Paths from the camera that find what light paths bring it: light counts beyond the film's edge, too."""
    y0, x0, height, width = call.config["crop"]
    margin = max(0, math.ceil(call.film.filter.reach - 0.5))
    window = (y0 - margin, x0 - margin, height + 2 * margin, width + 2 * margin)
    return replace(call, config={**call.config, "integrator": "path", "window": window, "glued": True})
