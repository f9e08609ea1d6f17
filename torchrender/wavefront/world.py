"""A packed scene with this call's tensors: rows of fields by category, and the surfaces that rays meet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from ..queries import Hits, attached, find_hits, occlusion
from ..scene.camera_rays import Rays
from ..scene.declaration import models
from ..scene.native import NativeScene
from ..scene.packing import Layout, Record, records
from ..scene.scene import Scene
from ..surface import OFFSET, Surfaces
from .geometry import Rows
from .sensors import SENSORS
from .textures import TEXTURES

VALUES = ("spectrum", "float", "point", "tensor")  # kinds of fields that are tensors and place nothing


@dataclass
class At(Rows):
    """Surface points: shape and primitive (N,), barycentric and texture coordinates (N, 2), which may be attached."""

    shape: torch.Tensor
    primitive: torch.Tensor
    barycentric: torch.Tensor
    uv: torch.Tensor


class World:
    """What paths are traced through.

    Args:
        scene, layout, native: the scene as it is packed and built.
        tensors: one for each slot; those that require gradients get them.
        moving: rays, hits and coordinates are attached, too.
    """

    def __init__(
        self, scene: Scene, layout: Layout, native: NativeScene, tensors: Sequence[torch.Tensor], moving: bool = False
    ) -> None:
        self.layout, self.native, self.moving = layout, native, moving
        self.dtype, self.channels = native.dtype, native.channels
        self.tensors = list(tensors)
        self.plain = [t.detach() for t in tensors]
        self.scene = scene
        self.records = {category: records(layout, category) for category in layout.objects}
        self.torch_bsdfs = layout.torch_bsdfs
        self.kept: dict[Any, Any] = {}  # what is computed once, without a graph
        self.nonfinite_where = ""  # the first place where a number was not finite
        self.begin()

    def begin(self) -> None:
        """Before every chunk: what is computed of the tensors, whose graph the chunk before has used up."""
        if self.moving or not hasattr(self, "surfaces"):
            self.surfaces = Surfaces.of(self.scene, self.layout, self.tensors if self.moving else self.plain)

    def tensor(self, category: str, record: Record, name: str) -> torch.Tensor:
        """The tensor of a field, its declared default where none was given."""
        slot = record.field[name]
        if slot >= 0:
            return self.tensors[slot]
        field = next(f for f in models()[category, record.type].fields if f.name == name)
        if field.kind in ("transform", "transform2"):
            return torch.eye(4 if field.kind == "transform" else 3, dtype=self.dtype)
        shape = (3,) if field.kind in ("point", "vector") else ()
        return torch.full(shape, 0.0 if field.default is None else field.default, dtype=self.dtype)

    def color(self, category: str, record: Record, name: str, at: At, channels: int = 0) -> torch.Tensor:
        """A textured field at surface points: (N, C), of the scene's channels if nothing is said."""
        return self.look_up(category, record, name, at).expand(len(at), channels or self.channels)

    def look_up(self, category: str, record: Record, name: str, at: At) -> torch.Tensor:
        """The same with the channels that the texture has."""
        index = record.field[name]
        if index < 0:
            field = next(f for f in models()[category, record.type].fields if f.name == name)
            default = 0.0 if field.default is None else field.default
            return torch.full((len(at), 1), default, dtype=self.dtype)
        texture = self.records["texture"][index]
        return TEXTURES[texture.type](self, texture, at)

    def needs_grad(self, category: str, index: int) -> bool:
        """Whether a value of an object, or of its textures, requires gradients."""
        record = self.records[category][index]
        if record.type == "torch":
            return True
        numbers = []
        for f in models()[category, record.type].fields:
            number = record.field[f.name]
            if f.kind in VALUES and number >= 0:
                numbers.append(number)
            nested = {"texture": "texture", "scalar": "texture", "volume": "volume"}.get(f.kind)
            if nested is not None and number >= 0 and self.needs_grad(nested, number):
                return True
        if record.type == "mesh_attribute":
            same = (a for a in self.records["attribute"] if a.field["name"] == record.field["name"])
            numbers += [a.field["data"] for a in same]
        return any(self.tensors[n].requires_grad for n in numbers)

    def intersect(self, o: torch.Tensor, d: torch.Tensor, tmax: torch.Tensor | None = None) -> Hits:
        """What rays (N, 3) hit; attached to rays and surfaces if those are."""
        limits = torch.full((len(o),), math.inf, dtype=self.dtype) if tmax is None else tmax
        hits = find_hits(self.native, self.plain, o, d, limits)
        hits = hits._replace(shape_id=hits.shape_id.long(), prim_id=hits.prim_id.long())
        return attached(hits, self.surfaces, o, d) if self.moving else hits

    def camera_rays(self, sensor: int, size: tuple[int, int], positions: torch.Tensor, lens: torch.Tensor) -> Rays:
        """Of the camera of this number, through places on its film of this size, from places on its lens (N, 2)."""
        record = self.records["sensor"][sensor]
        return SENSORS[record.type](self, record, size, positions.to(self.dtype), lens.to(self.dtype))

    def first_hits(self, rays: Rays, hide_emitters: bool) -> Hits:
        """What camera rays hit, which may look through shapes that emit."""
        o, d, length = rays
        hits = self.intersect(o, d, length)
        emitter = self.shape_field("emitter") if hide_emitters else None
        while emitter is not None:
            lit = hits.valid & (emitter[hits.shape_id] >= 0)
            if not bool(lit.any()):
                break
            behind = o + d * torch.where(lit, hits.t.detach(), 0.0)[:, None]
            step = torch.where(lit, (1 + behind.detach().abs().amax(1)) * OFFSET, 0.0)
            o = behind + d * step[:, None]
            length = length - torch.where(lit, hits.t.detach() + step, 0.0)
            hits = self.intersect(o, d, length)
        return hits

    def occluded(self, o: torch.Tensor, d: torch.Tensor, tmax: torch.Tensor) -> torch.Tensor:
        return occlusion(self.native, self.plain, o.detach(), d.detach(), tmax.detach())

    def shape_field(self, name: str) -> torch.Tensor:
        """An integer field of every shape: (S,)."""
        return torch.tensor([r.field[name] for r in self.records["shape"]], dtype=torch.int64)

    def note_nonfinite(self, where: str) -> None:
        self.nonfinite_where = self.nonfinite_where or where
