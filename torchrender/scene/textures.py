"""Textures that need more than their declaration: bitmaps from files and arrays, mesh attributes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import torch

from ..errors import describe
from ..image import decode_levels
from . import values
from .construction import check_names
from .context import Context
from .declaration import Field
from .plugin import Plugin
from .registry import build, register


def load_texels(properties: dict[str, Any], ctx: Context, raw: bool) -> Any:
    """Take the texels that `filename`, `bitmap` or `data` give out of `properties`."""
    given = [n for n in ("filename", "bitmap", "data") if properties.get(n) is not None]
    if len(given) != 1:
        ctx.error(f"give one of filename, bitmap and data; got {' and '.join(given) or 'none'}")
    name = given[0]
    content = properties.pop(name)
    if name == "filename":
        from .. import io

        path = ctx.at(name).file(content)
        with ctx.at(name).located():
            return io.read_image(path, raw=raw)
    if name == "bitmap" and not hasattr(content, "shape"):
        content = np.asarray(content)
    dtype = str(getattr(content, "dtype", ""))
    if dtype.endswith(("uint8", "uint16")):
        # Integers are encoded images, as a file would hold them.
        content = decode_levels(content.cpu().numpy() if torch.is_tensor(content) else np.asarray(content), raw)
    return content


@register
class Bitmap(Plugin):
    """An image as a texture. Row 0 is at v = 0, texel centres lie at half integers.

    Args:
        filename: image file; colours of 8 and 16 bit files are decoded from sRGB unless `raw`.
        data: texels (H, W, C), C = 1 or 3, or (H, W); floating-point values are taken as they are (linear), bytes and
            16-bit integers as an image file would hold them.
        bitmap: an image object or array, in place of the two.
        raw: do not decode sRGB.
        filter_type: ``"bilinear"`` or ``"nearest"``.
        wrap_mode: ``"repeat"``, ``"mirror"`` or ``"clamp"``.
        to_uv: 3x3 or 4x4 matrix applied to texture coordinates before the look-up.
    """

    category, type = "texture", "bitmap"
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"accel": (True, False), "format": ("variant", "auto", "fp16")}
    words: ClassVar[tuple[str, ...]] = ("filename", "bitmap")

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", "bitmap", "raw", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        raw = values.boolean(properties.pop("raw", False), ctx.at("raw"))
        check_names(self, {k: v for k, v in properties.items() if k not in ("filename", "bitmap")}, ctx)
        texels = load_texels(properties, ctx, raw)
        return {**properties, "data": texels}

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        return values.image(value, ctx)

    def derivative_of(self, field: Field) -> str:
        if field.name == "to_uv" and self.filter_type == "nearest":
            return "none: moves the edges of nearest texels, a discontinuity that is not implemented yet"
        return super().derivative_of(field)


@register
class MeshAttribute(Plugin):
    """Colours stored on a mesh: ``vertex_*`` interpolated over triangles, ``face_*`` constant on each.

    Args:
        name: the attribute's name, beginning with ``vertex_`` or ``face_``.
        scale: a factor.
    """

    category, type = "texture", "mesh_attribute"

    @classmethod
    def fields(cls) -> dict[str, Field]:
        # The name is an integer natively; a scene numbers the names that it uses.
        return {("name" if f.name == "name_id" else f.name): f for f in cls.model().fields}

    def convert_static(self, name: str, value: Any, ctx: Context) -> Any:
        if name != "name":
            return super().convert_static(name, value, ctx)
        if not isinstance(value, str) or not value.startswith(("vertex_", "face_")):
            ctx.error(f"expected a name beginning with 'vertex_' or 'face_', got {describe(value)}")
        return value

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if not isinstance(self.__dict__.get("name"), str):
            ctx.error("mesh_attribute: 'name' is missing")

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        return iter(())


@register
class VolumeTexture(Plugin):
    """A volume as a texture: looked up where the point of the surface is in the world, whatever its coordinates.

    Args:
        volume: a number, a colour or a volume such as a `gridvolume`, default 0.75.
    """

    category, type = "texture", "volume"

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if self._child("volume") is None and not self._references:
            self._modules["volume"] = build(
                {"type": "constvolume", "value": self.fields()["volume"].default}, ctx.at("volume")
            )

    def resolve(self, lookup: Any, ctx: Context) -> None:
        super().resolve(lookup, ctx)
        self._fill(ctx)

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        child = self._child("volume")
        if child is not None:
            for leaf, tensor in child.texels():
                yield f"volume.{leaf}", tensor


@register
class Checkerboard(Plugin):
    """Two textures in alternating squares of half a unit of texture coordinates.

    Args:
        color0: where u and v are in the same half of their unit interval (texture), default 0.4.
        color1: elsewhere (texture), default 0.2.
        to_uv: 3x3 or 4x4 matrix applied to texture coordinates before the look-up.
    """

    category, type = "texture", "checkerboard"

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        for name in ("color0", "color1"):
            child = self._child(name)
            if child is not None:
                for leaf, tensor in child.texels():
                    yield f"{name}.{leaf}", tensor
