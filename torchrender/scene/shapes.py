"""What all shapes share, and the analytic ones."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .context import Context
from .plugin import Plugin
from .registry import plugin_class, register

ON_SHAPES = ("area", "directionalarea")
"""Emitters that are surfaces of shapes."""

# Sampling of silhouettes: no derivative of moving edges exists yet, so its weight changes nothing.
SILHOUETTE: dict[str, tuple[Any, ...]] = {"silhouette_sampling_weight": ()}


class Shape(Plugin):
    """What all shapes share: a BSDF (if none is given diffuse 0.5, or 0 where it emits), possibly an area light, and
    media on its two sides: `interior` on the one that normals point away from, `exterior` on the other.
    """

    category = "shape"
    renames: ClassVar[dict[str, str]] = {"interior": "interior_medium", "exterior": "exterior_medium"}
    aliases: ClassVar[dict[str, str]] = {"interior": "interior_medium", "exterior": "exterior_medium"}
    inert: ClassVar[dict[str, tuple[Any, ...]]] = SILHOUETTE

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        # Unnamed references are resolved later; if one turns out to be a BSDF it takes the place of this default.
        if self._modules.get("bsdf") is None and not any(name in (None, "bsdf") for name, _ in self._references):
            self._modules["bsdf"] = self._default_bsdf(ctx)

    def _default_bsdf(self, ctx: Context) -> Plugin:
        """Grey; black on a shape that emits, which then reflects nothing."""
        reflectance = 0.5 if self._modules.get("emitter") is None else 0.0
        return plugin_class("bsdf", "diffuse")(reflectance=reflectance, _context=ctx.at("bsdf"))

    def resolve(self, lookup: Any, ctx: Context) -> None:
        super().resolve(lookup, ctx)
        if self._modules.get("bsdf") is None:
            self._modules["bsdf"] = self._default_bsdf(ctx)

    def adopt(self, child: Plugin, ctx: Context) -> None:
        if child.category == "medium":
            ctx.error("a medium of a shape goes by the name 'interior' or 'exterior'")
        super().adopt(child, ctx)

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        emitter = self._modules.get("emitter")
        if emitter is not None and emitter.type not in ON_SHAPES:
            ctx.at("emitter").error(f"only {' or '.join(ON_SHAPES)} can sit on a shape, got {emitter.type!r}")


@register
class Rectangle(Shape):
    """The square [-1, 1] x [-1, 1] at z = 0 with normal +z, under `to_world`.

    Args:
        to_world: 4x4 matrix.
        flip_normals: the normal points to -z.
        bsdf, emitter: material and area light.
        interior, exterior: media behind and in front of it.
    """

    type = "rectangle"

    def corners(self) -> torch.Tensor:
        matrix = self.to_world.detach()
        square = matrix.new_tensor([[-1.0, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]])
        return (square @ matrix.T)[:, :3]

    def bounds(self) -> torch.Tensor:
        points = self.corners()
        return torch.stack([points.amin(0), points.amax(0)])


@register
class Disk(Shape):
    """The unit disk at z = 0 with normal +z, under `to_world`.

    Args:
        to_world: 4x4 matrix.
        flip_normals: the normal points to -z.
        bsdf, emitter: material and area light.
        interior, exterior: media behind and in front of it.
    """

    type = "disk"

    def bounds(self) -> torch.Tensor:
        matrix = self.to_world.detach()
        extent = torch.linalg.vector_norm(matrix[:3, :2], dim=1)
        return torch.stack([matrix[:3, 3] - extent, matrix[:3, 3] + extent])


@register
class Sphere(Shape):
    """A sphere; `to_world` acts on it after `center` and `radius`.

    Args:
        center: (3,), default the origin.
        radius: default 1.
        to_world: 4x4 matrix.
        flip_normals: normals point inside.
        bsdf, emitter: material and area light.
        interior, exterior: media inside and outside.
    """

    type = "sphere"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "radius" in properties and not float(values.number(properties["radius"], ctx.at("radius")).detach()) > 0:
            ctx.at("radius").error(f"expected a positive number, got {describe(properties['radius'])}")
        return properties

    def bounds(self) -> torch.Tensor:
        matrix = self.to_world.detach()
        middle = matrix[:3, :3] @ self.center.detach() + matrix[:3, 3]
        extent = torch.linalg.vector_norm(matrix[:3, :3], dim=1) * self.radius.detach().abs()
        return torch.stack([middle - extent, middle + extent])
