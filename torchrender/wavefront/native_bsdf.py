"""A native BSDF model as the integrator sees BSDFs."""

from __future__ import annotations

from typing import ClassVar

import torch

from ..bsdfs import NativeBSDF, native_bsdf
from ..scene.conversion import decode
from ..scene.declaration import Model
from ..scene.packing import Record
from .bsdf import Bsdf, BsdfSample, Color


class NativeBsdf(Bsdf):
    """A native model; `of` makes the class for one."""

    model: ClassVar[Model]
    native: NativeBSDF
    params: dict[str, torch.Tensor]

    @classmethod
    def of(cls, model: Model) -> type[NativeBsdf]:
        lobes = {"smooth": "has_smooth_lobes" in model.flags, "delta": "has_delta_lobes" in model.flags}
        return type(f"Native{model.type.capitalize()}", (cls,), {"model": model, **lobes})

    @classmethod
    def oriented(cls, record: Record) -> bool:
        given = [record.field[f.name] >= 0 for f in cls.model.fields if "follows_tangent" in f.traits]
        return "follows_tangent" in cls.model.flags and all(given)

    def read(self, color: Color, number: Color) -> None:
        key = ("bsdf", self.record.path)
        if key not in self.world.kept:
            choices = {f.name: decode(f, self.record.field[f.name]) for f in self.model.fields if f.kind == "int"}
            self.world.kept[key] = native_bsdf(self.model.type, channels=self.channels, **choices)
        self.native = self.world.kept[key]
        self.params = {}
        for field in self.model.fields:
            if field.name in self.native.colors:
                self.params[field.name] = color(field.name)
            elif field.kind != "int":
                self.params[field.name] = (number if field.kind == "float" else self.scalar)(field.name)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return self.native.eval(self.params, wi, wo, lobe)

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return self.native.pdf(self.params, wi, wo)

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        s = self.native.sample(self.params, wi, u[:, :3])
        return BsdfSample(s.wo, s.pdf, s.eta, s.lobe)
