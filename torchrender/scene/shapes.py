"""What all shapes share, and the analytic ones."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .context import Context
from .plugin import Plugin
from .registry import builder, plugin_class, register

ON_SHAPES = ("area", "directionalarea")
"""Emitters that are surfaces of shapes."""

# Sampling of silhouettes: no derivative of moving edges exists yet, so its weight changes nothing.
SILHOUETTE: dict[str, tuple[Any, ...]] = {"silhouette_sampling_weight": ()}


class Shape(Plugin):
    """What all shapes share: a BSDF, possibly an area light, and media on both sides.

    If no BSDF is given it is diffuse, of reflectance 0.5, or 0 where the shape emits. The medium `interior` is on the
    side that normals point away from, `exterior` on the other.
    """

    category = "shape"
    renames: ClassVar[dict[str, str]] = {"interior": "interior_medium", "exterior": "exterior_medium"}
    aliases: ClassVar[dict[str, str]] = {"interior": "interior_medium", "exterior": "exterior_medium"}
    inert: ClassVar[dict[str, tuple[Any, ...]]] = SILHOUETTE

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        # Unnamed references are resolved later; if one turns out to be a BSDF it takes the place of this default.
        if self._child("bsdf") is None and not self._waits_for(None, "bsdf"):
            self._modules["bsdf"] = self._default_bsdf(ctx)

    def _default_bsdf(self, ctx: Context) -> Plugin:
        """Grey; black on a shape that emits, which then reflects nothing."""
        reflectance = 0.5 if self._child("emitter") is None else 0.0
        return plugin_class("bsdf", "diffuse")(reflectance=reflectance, _context=ctx.at("bsdf"))

    def resolve(self, lookup: Any, ctx: Context) -> None:
        super().resolve(lookup, ctx)
        if self._child("bsdf") is None:
            self._modules["bsdf"] = self._default_bsdf(ctx)

    def adopt(self, child: Plugin, ctx: Context) -> None:
        if child.category == "medium":
            ctx.error("a medium of a shape goes by the name 'interior' or 'exterior'")
        super().adopt(child, ctx)

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        emitter = self._child("emitter")
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
class Cylinder(Shape):
    """The side of a cylinder around the segment from `p0` to `p1`, open at both ends.

    `to_world` acts on it after these and may turn, move and scale it, along its axis by another factor.
    Texture coordinates are the azimuth and the place along the axis, both from 0 to 1.

    Args:
        p0: (3,), where the axis begins, default the origin.
        p1: (3,), where it ends, default (0, 0, 1).
        radius: default 1.
        to_world: 4x4 matrix.
        flip_normals: normals point inside.
        bsdf, emitter: material and area light.
        interior, exterior: media inside and outside.
    """

    type = "cylinder"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "radius" in properties and not float(values.number(properties["radius"], ctx.at("radius")).detach()) > 0:
            ctx.at("radius").error(f"expected a positive number, got {describe(properties['radius'])}")
        return {"p1": [0.0, 0.0, 1.0], **properties}

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if bool((self.p0.detach() == self.p1.detach()).all()):
            ctx.at("p1").error("expected a point apart from p0, got the same point")

    def bounds(self) -> torch.Tensor:
        matrix = self.to_world.detach()
        ends = torch.stack([self.p0.detach(), self.p1.detach()])
        axis = ends[1] - ends[0]
        axis = axis / torch.linalg.vector_norm(axis)
        ends = ends @ matrix[:3, :3].T + matrix[:3, 3]
        # of the disks at the ends: rows of the matrix without what lies along the axis
        across = matrix[:3, :3] - (matrix[:3, :3] @ axis)[:, None] * axis
        extent = torch.linalg.vector_norm(across, dim=1) * self.radius.detach().abs()
        return torch.stack([ends.amin(0) - extent, ends.amax(0) + extent])


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


@builder("shapegroup", "shape", ("shape",))
def _shapegroup(_properties: dict[str, Any], ctx: Context) -> Plugin:
    ctx.error("a shapegroup stands at the top of the dict or file that a scene is loaded from, for its instances")


@builder("merge", "shape")
def _merge(_properties: dict[str, Any], ctx: Context) -> Plugin:
    ctx.error("a merge stands at the top of the dict or file that a scene is loaded from, or in a shapegroup there")


@builder("instance", "shape", ("shapegroup", "to_world"))
def _instance(_properties: dict[str, Any], ctx: Context) -> Plugin:
    ctx.error(
        "an instance stands at the top of the dict or file that a scene is loaded from, which makes copies of its "
        "shapegroup's shapes; assign such a copy itself"
    )
