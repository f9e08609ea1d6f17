"""BSDFs around BSDFs: sides, mixtures, holes and turned normals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from . import values
from .context import Context
from .plugin import Plugin
from .registry import register


def _inside(bsdf: Plugin) -> list[Plugin]:
    """`bsdf` and all that is nested in it."""
    return [m for m in bsdf.modules() if isinstance(m, Plugin) and m.category == "bsdf"]


class _Layer(Plugin):
    """A BSDF that cannot be without those it contains."""

    category = "bsdf"

    @classmethod
    def required(cls) -> list[str]:
        return [name for name, field in cls.fields().items() if field.kind == "bsdf"]

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        names = self.required()
        given = [name for name in names if self._child(name) is not None]
        waiting = [name for name, _ in self._references if name is None or name in names]
        if len(given) + len(waiting) < len(names):
            ctx.error(f"{self.type}: a nested BSDF is missing")

    def __setattr__(self, name: str, value: Any) -> None:
        if value is None and self.__dict__.get("_built", False) and name in self.required():
            Context(path=(type(self).__name__, name)).error(f"None removes a part that a {self.type} needs")
        super().__setattr__(name, value)


@register
class TwoSided(_Layer):
    """Reflection from both sides of a surface.

    Args:
        brdf_0: the front's BSDF, and the back's if there is no second. Nested BSDFs may have any name.
        brdf_1: the back's BSDF.
    """

    type = "twosided"

    @classmethod
    def required(cls) -> list[str]:
        return ["brdf_0"]

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        for name in ("brdf_0", "brdf_1"):
            child = self._child(name)
            for inner in _inside(child) if child is not None else []:
                by = [n for n, field in inner.fields().items() if "transmits" in field.traits]  # only where given
                given = [n for n in by if inner._child(n) is not None]
                if inner.type == "twosided" or ("transmits" in inner.model().flags and (given or not by)):
                    what = f"{inner.type} with {given[0]}" if given else inner.type
                    ctx.at(name).error(f"a {what} cannot be made two-sided: only one-sided reflection can")


@register
class BlendBSDF(_Layer):
    """A mixture of two BSDFs of any kind: (1 - weight) of the first and `weight` of the second.

    A path meets one of the two by chance. A weight that is differentiated gives either of them a tenth of the paths of
    the derivative at least, so that weights of 0 and 1 have theirs.

    Args:
        weight: share of the second, 0 to 1 (texture), default 0.5. Beyond that it counts as 0 or 1.
        bsdf_0, bsdf_1: the two. Nested BSDFs may have any name; the first one given is the first.
    """

    type = "blendbsdf"


@register
class Mask(_Layer):
    """A BSDF with holes: where it is not, rays pass unchanged.

    A hole is met by chance. Shadow rays end at a masked surface: light behind it is found by paths that pass.

    Args:
        opacity: 0, nothing is there, to 1 (texture), default 0.5. Beyond that it counts as 0 or 1.
        nested_bsdf: the BSDF of the surface between the holes, under any name.
    """

    type = "mask"


class _Turning(_Layer):
    """What turns the normals of a BSDF."""

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        for name, given in properties.items():
            if isinstance(given, Mapping) and given.get("type") == "bitmap":
                raw = values.boolean(given.get("raw", True), ctx.at(name).at("raw"))
                properties[name] = {**given, "raw": raw}
            elif isinstance(given, (torch.Tensor, np.ndarray)) and given.ndim == 3:
                properties[name] = {"type": "bitmap", "data": given, "raw": True}
        return properties

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        child = self._child("nested_bsdf")
        for inner in _inside(child) if child is not None else []:
            if inner.type in ("normalmap", "bumpmap", "twosided"):
                ctx.at("nested_bsdf").error(f"a {inner.type} stands around a {self.type}, not inside of it")


@register
class NormalMap(_Turning):
    """A BSDF whose shading normals come from an image.

    The normal has coordinates in the frame of the direction in which u grows, made orthogonal to the shading normal, of
    the vector orthogonal to both, and of the shading normal. Derivatives are those with respect to the image and to the
    surface that carries it.

    Args:
        normalmap: red, green and blue are (n + 1) / 2 (texture); a bitmap is read as raw numbers. Normals need not have
            unit length.
        nested_bsdf: what is seen with these normals, under any name.
        flip_invalid_normals: whether the tangential part of normals that face away from the viewer is reversed, default
            True. Paths of light, which do not know the viewer, never do.
        use_shadowing_function: whether light is dimmed near the terminator, as Estevez, Lecocq and Stein do in Ray
            Tracing Gems (2019), chapter 12; default True.
    """

    type = "normalmap"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "normalmap" not in properties:
            ctx.error("normalmap: 'normalmap' is missing, the texture that holds the normals")
        return super().prepare(properties, ctx)

    def context_of(self, name: str, ctx: Context) -> Context:
        """Components of normals are no colour: without colours, too, there are three."""
        return replace(ctx, color="rgb") if name == "normalmap" and ctx.color == "mono" else ctx


@register
class BumpMap(_Turning):
    """A BSDF whose shading normals are those of a surface that a texture lifts.

    Derivatives are those with respect to the heights, and to the surface that carries them; between texels the slopes
    of bilinear heights jump, which is no part of them.

    Args:
        nested_texture: heights in units of the scene (texture), under any name; of colours the luminance. A bitmap is
            read as raw numbers; textures other than bitmaps are flat.
        nested_bsdf: what is seen with these normals, under any name.
        scale: a factor of the heights, default 1.
        flip_invalid_normals, use_shadowing_function: as for `NormalMap`.
    """

    type = "bumpmap"
