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
from .allotment import ALONE, OF_SKIES, REFLECTIONS, SEEN, SHADOWS

PLACING = ("transform", "float", "point", "tensor")  # kinds of fields that may place something
# Of the last two outlines are found that points on surfaces and lights see; the last but one has them in view, too.
SENSORS = ("perspective", "thinlens", "orthographic", "fisheye", "panorama", "distant", "radiancemeter")
NORMALS = "normals"
SHADING = (NORMALS, "texcoords")  # fields of meshes that place nothing
MOVING_LIGHTS = ("point", "spot", "projector", "directional")  # what may move of others are shapes
SKIES = ("constant", "envmap")


@dataclass
class BoundaryCall:
    """The boundary term of one rendering.

    `spp` samples a wanted pixel of outlines that the camera, lights and vertices see, may be fractions; `moves`
    says which shapes may move, all if the camera does. With `by_length` short outlines get fewer samples. `outputs`:
    it is that of outputs besides radiance. `glued`: it is that of light paths, whose points move with their surfaces.
    """

    call: RenderCall
    spp: tuple[float, float, float]
    moves: torch.Tensor
    by_length: bool
    outputs: FirstHitCall | None = None
    glued: bool = False


def placing_slots(layout: Layout, category: str) -> list[tuple[str, list[int], list[int]]]:
    """Of all objects of a category: type, slots of what may place them, and of their normals, which move their rims.

    Tensors of lights are what they show.
    """
    kinds = [kind for kind in PLACING if (category, kind) != ("emitter", "tensor")]
    found = []
    for kind, numbers, _ in layout.objects[category]:
        fields = models()[category, kind].fields
        given = [(f.name, n) for n, f in zip(numbers, fields, strict=True) if f.kind in kinds and n >= 0]
        placing = [n for name, n in given if name not in SHADING]
        found.append((kind, placing, [n for name, n in given if name == NORMALS]))
    return found


def all_placing_slots(layout: Layout) -> set[int]:
    """The slots of what may place shapes, rims, cameras and lights."""
    found = [row for category in ("shape", "sensor", "emitter") for row in placing_slots(layout, category)]
    return {slot for _, placing, normals in found for slot in placing + normals}


def boundary_of(
    call: RenderCall, tensors: Sequence[torch.Tensor], outputs: FirstHitCall | None = None
) -> BoundaryCall | None:
    """The boundary term of a rendering with these tensors; None if nothing that has one may be differentiated."""
    spp = call.spp_visibility
    kind, slots, _ = placing_slots(call.layout, "sensor")[call.config["sensor"]]
    if kind not in SENSORS or spp == (0, 0):
        return None

    def asked(slots: Sequence[int]) -> bool:
        return any(has_derivative(tensors[n]) for n in slots)

    camera = asked(slots)
    shapes = placing_slots(call.layout, "shape")
    placed = [camera or asked(placing) for _, placing, _ in shapes]
    moves = [p or asked(normals) for p, (_, _, normals) in zip(placed, shapes, strict=True)]
    emitters = placing_slots(call.layout, "emitter")
    lights = any(asked(slots) for k, slots, _ in emitters if k in MOVING_LIGHTS)
    # of those that the camera sees alone: of rims there are no others; beside media others have no such term
    limited = call.config.get("volumetric") or call.layout.bending
    seen_alone = (bool(limited) and outputs is None) or not (any(placed) or lights)
    if seen_alone and not any(moves):
        return None
    alone = seen_alone or outputs is not None or 0 <= call.config["max_depth"] < 2
    seen, others = spp or (call.spp_grad * (ALONE if alone else SEEN), call.spp_grad)
    shadows = OF_SKIES if any(k in SKIES for k, _, _ in emitters) else SHADOWS
    of_lights, of_vertices = (others, others) if spp else (others * shadows, others * REFLECTIONS)
    counts = (seen, 0.0, 0.0) if alone else (seen, of_lights, of_vertices)
    glued = outputs is None and call.config["integrator"] == "ptracer"
    moving = torch.tensor(moves, dtype=torch.bool)
    return BoundaryCall(of_light(call) if glued else call, counts, moving, spp is None, outputs, glued)


def of_light(call: RenderCall) -> RenderCall:
    """Paths from the camera that find what light paths bring it: light counts beyond the film's edge, too."""
    y0, x0, height, width = call.config["crop"]
    margin = max(0, math.ceil(call.film.filter.reach - 0.5))
    window = (y0 - margin, x0 - margin, height + 2 * margin, width + 2 * margin)
    return replace(call, config={**call.config, "integrator": "path", "window": window, "glued": True})
