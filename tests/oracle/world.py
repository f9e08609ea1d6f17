"""A scene as the native renderer gets it: rows of fields by category, and the tensors that they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

import torchrender as tr
from torchrender.scene.declaration import models
from torchrender.scene.gather import gather
from torchrender.surface import Surfaces

from .geometry import Rows


@dataclass
class At(Rows):
    """Surface points: shape and primitive (N,), barycentric and texture coordinates (N, 2), which may be attached."""

    shape: torch.Tensor
    primitive: torch.Tensor
    barycentric: torch.Tensor
    uv: torch.Tensor


@dataclass
class Record:
    """An object of a scene: its type, and for each field a slot, an index of another object, or a number."""

    type: str
    field: dict[str, int]
    path: str


class World:
    """A packed scene with tensors in its slots, those of `params` in place of its own."""

    def __init__(self, scene: tr.Scene, params: Mapping[str, torch.Tensor] | None = None) -> None:
        self.scene, self.params, self.channels = scene, params, scene.channels
        self.layout = scene.layout()
        self.tensors = gather(scene, self.layout, params)
        self.surfaces = Surfaces.of(scene, self.layout, self.tensors)
        self.records = {category: self._records(category) for category in self.layout.objects}

    def _records(self, category: str) -> list[Record]:
        found = []
        for kind, numbers, path in self.layout.objects[category]:
            names = [f.name for f in models()[category, kind].fields]
            found.append(Record(kind, dict(zip(names, numbers, strict=True)), path))
        return found

    def tensor(self, category: str, record: Record, name: str) -> torch.Tensor:
        """The tensor of a field, its declared default where none was given."""
        slot = record.field[name]
        if slot >= 0:
            return self.tensors[slot]
        field = next(f for f in models()[category, record.type].fields if f.name == name)
        if field.kind in ("transform", "transform2"):
            return torch.eye(4 if field.kind == "transform" else 3, dtype=self.scene.dtype)
        shape = (3,) if field.kind == "point" else ()
        return torch.full(shape, field.default, dtype=self.scene.dtype)

    def color(self, category: str, record: Record, name: str, at: At) -> torch.Tensor:
        """A textured field at surface points: (N, C)."""
        from .textures import TEXTURES

        index = record.field[name]
        if index < 0:
            field = next(f for f in models()[category, record.type].fields if f.name == name)
            return torch.full((len(at), self.channels), field.default, dtype=self.scene.dtype)
        texture = self.records["texture"][index]
        return TEXTURES[texture.type](self, texture, at)

    def intersect(self, o: torch.Tensor, d: torch.Tensor, tmax: Any = None) -> tr.queries.Hits:
        return tr.ray_intersect(self.scene, o, d, tmax, params=self.params)

    def occluded(self, o: torch.Tensor, d: torch.Tensor, tmax: torch.Tensor) -> torch.Tensor:
        return tr.ray_occluded(self.scene, o.detach(), d.detach(), tmax.detach(), params=self.params)

    def shape_field(self, name: str) -> torch.Tensor:
        """An integer field of every shape: (S,)."""
        return torch.tensor([r.field[name] for r in self.records["shape"]], dtype=torch.int64)
