"""Emitters that need more than their declaration."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from . import values
from .context import Context
from .declaration import Field
from .plugin import Plugin
from .registry import register
from .textures import load_texels


@register
class EnvironmentMap(Plugin):
    """Light from infinitely far away, given by an image in latitude-longitude parametrisation.

    Args:
        filename, data, bitmap: the image (H, W, C), linear radiance; row 0 looks along +y, u = 0 along -z.
        scale: a factor of the radiance.
        to_world: rotation of the map.
        sampling_weight: relative number of emitter samples.
    """

    category, type = "emitter", "envmap"
    unsupported: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", "bitmap", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if values.boolean(properties.pop("mis_compensation", False), ctx.at("mis_compensation")):
            ctx.error("envmap: mis_compensation=True is not supported by this version")
        self._check_names({k: v for k, v in properties.items() if k not in ("filename", "bitmap")}, ctx)
        texels = load_texels(properties, ctx, raw=False)
        return {**properties, "data": texels}

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        texels = values.image(value, ctx)
        if texels.shape[0] < 2 or texels.shape[1] < 2:
            ctx.error(f"an environment map has at least 2x2 texels, got {tuple(texels.shape)}")
        return texels


@register
class PointLight(Plugin):
    """A point that emits equally in all directions.

    Args:
        intensity: radiant intensity (colour), power per solid angle.
        position: where it is (3,).
        to_world: in place of `position`: a transform whose translation is the position.
        sampling_weight: relative number of emitter samples.
    """

    category, type = "emitter", "point"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return [*super().parameter_names(), "to_world"]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "to_world" in properties:
            if "position" in properties:
                ctx.error("point: give position or to_world, but not both")
            properties["position"] = values.matrix(properties.pop("to_world"), 4, ctx.at("to_world"))[:3, 3]
        properties.setdefault("position", [0.0, 0.0, 0.0])
        return properties
