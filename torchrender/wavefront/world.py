"""A packed scene with this call's tensors: rows of fields by category, and the surfaces that rays meet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from ..queries import Hits, nearest_hits, occlusion
from ..scene.declaration import models
from ..scene.native import NativeScene
from ..scene.packing import Layout
from ..surface import Surfaces
from .geometry import Rows
from .textures import TEXTURES

if TYPE_CHECKING:
    from ..scene.scene import Scene


@dataclass
class At(Rows):
    """Surface points: shape and primitive (N,), barycentric and texture coordinates (N, 2), which may be attached."""

    shape: torch.Tensor
    primitive: torch.Tensor
    barycentric: torch.Tensor
    uv: torch.Tensor


@dataclass(frozen=True)
class Record:
    """An object of a scene: its type, and for each field a slot, an index of another object, or a number."""

    type: str
    field: dict[str, int]
    path: str


def records(layout: Layout, category: str) -> list[Record]:
    """All objects of a category; a BSDF that is written in PyTorch has the type ``"torch"``."""
    found = []
    for row, (kind, numbers, path) in enumerate(layout.objects[category]):
        if category == "bsdf" and row in layout.torch_bsdfs:
            found.append(Record("torch", {"row": row}, path))
            continue
        names = [f.name for f in models()[category, kind].fields]
        found.append(Record(kind, dict(zip(names, numbers, strict=True)), path))
    return found


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

    def color(self, category: str, record: Record, name: str, at: At) -> torch.Tensor:
        """A textured field at surface points: (N, C)."""
        index = record.field[name]
        if index < 0:
            field = next(f for f in models()[category, record.type].fields if f.name == name)
            default = 0.0 if field.default is None else field.default
            return torch.full((len(at), self.channels), default, dtype=self.dtype)
        texture = self.records["texture"][index]
        return TEXTURES[texture.type](self, texture, at)

    def intersect(self, o: torch.Tensor, d: torch.Tensor, tmax: torch.Tensor | None = None) -> Hits:
        """What rays (N, 3) hit; attached to rays and surfaces if those are."""
        limits = torch.full((len(o),), math.inf, dtype=self.dtype) if tmax is None else tmax
        hits = nearest_hits(self.native, self.plain, o.detach(), d.detach(), limits)
        hits = hits._replace(shape_id=hits.shape_id.long(), prim_id=hits.prim_id.long())
        if not self.moving:
            return hits
        rows = hits.valid.nonzero()[:, 0]
        points = self.surfaces.meet(hits.shape_id[rows], hits.prim_id[rows], o[rows], d[rows], hits.t[rows])
        attached: dict[str, torch.Tensor] = {}
        for name in Hits._fields[:6]:
            value, point = getattr(hits, name), getattr(points, name)
            attached[name] = value.index_put((rows,), value[rows] + (point - point.detach()))
        return hits._replace(**attached)

    def occluded(self, o: torch.Tensor, d: torch.Tensor, tmax: torch.Tensor) -> torch.Tensor:
        return occlusion(self.native, self.plain, o.detach(), d.detach(), tmax.detach())

    def shape_field(self, name: str) -> torch.Tensor:
        """An integer field of every shape: (S,)."""
        return torch.tensor([r.field[name] for r in self.records["shape"]], dtype=torch.int64)

    def note_nonfinite(self, where: str) -> None:
        self.nonfinite_where = self.nonfinite_where or where


def check_light_shapes(layout: Layout, shapes: Mapping[str, Any]) -> None:
    """ValueError for the first shape, by its path, that emits and is none of these."""
    for record in records(layout, "shape"):
        if record.field.get("emitter", -1) >= 0 and record.type not in shapes:
            raise ValueError(
                f"render: integrator: {record.path}: WavefrontPathTracer has no light on a {record.type}; "
                f"it has {', '.join(shapes)}"
            )


def check_supported(layout: Layout, tables: dict[str, Any]) -> None:
    """ValueError for the first object, by its path, of a type that has no entry in the `tables` by category."""
    for category, table in tables.items():
        for record in records(layout, category):
            if record.type not in table:
                raise ValueError(
                    f"render: integrator: {record.path}: WavefrontPathTracer has no {category} of type "
                    f"{record.type!r}; it has {', '.join(table)}"
                )
