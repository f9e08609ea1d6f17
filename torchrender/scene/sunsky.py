"""`sunsky`: sun and sky of a clear day, an environment map that is computed when a scene is loaded."""

from __future__ import annotations

from typing import Any

import torch

from ..errors import nearest
from . import values
from .camera import check_light
from .construction import substituted
from .context import Context
from .emitters import EnvironmentMap
from .plugin import Plugin
from .registry import builder

# Place and time: default, smallest and largest value.
_PLACE = {"latitude": (35.6894, -90, 90), "longitude": (139.6917, -360, 360), "timezone": (9.0, -24, 24)}
_TIME = {"hour": (15.0, 0, 24), "minute": (0.0, 0, 60), "second": (0.0, 0, 60)}
_DATE = {"year": (2010, 1900, 2100), "month": (7, 1, 12), "day": (10, 1, 31)}
_WHEN = {**_PLACE, **_TIME, **_DATE}
_OTHERS = ("turbidity", "sun_direction", "sun_scale", "sky_scale", "sun_aperture", "to_world", "sampling_weight")
NAMES = (*_OTHERS, *_WHEN, "height")
# Mitsuba's frame has z up, x to the south and y to the west; an environment map's has y up.
_UPRIGHT = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@builder("sunsky", "emitter", (*NAMES, "albedo", "complex_sun"))
def sunsky(properties: dict[str, Any], ctx: Context) -> Plugin:
    """An environment map of Preetham's sky (`torchrender.daylight`) and the sun in it, under the names of Mitsuba.

    Gradients reach tensors given as `turbidity`, `sun_direction`, `sun_scale`, `sky_scale` and `to_world`; afterwards
    the parameters are those of an environment map.

    The parameters `albedo` and `complex_sun` are left out with a warning.

    Args:
        turbidity, sun_direction: as for `tr.sky`, but the direction is in the world; or place and time, which are in
            the emitter's frame (z up): `latitude`, `longitude`, `timezone`, `year`, `month`, `day`, `hour`, `minute`,
            `second`, by default a summer's afternoon in Tokyo.
        sun_scale, sky_scale: factors of the radiance of either.
        sun_aperture: the sun's diameter in degrees; its irradiance does not depend on it.
        to_world: 4x4 matrix that turns; +z of the frame is up.
        height: rows of the map, 2 to 4096, default 512; an addition to Mitsuba's parameters.
    """
    from .. import daylight

    for name in ("albedo", "complex_sun"):
        if properties.pop(name, False) is not False:
            substituted(ctx, f"{name} is left out: the sky is that of Preetham and others, which has none")
    for name in properties:
        if name not in NAMES:
            ctx.error(f"sunsky has no parameter {name!r}; {nearest(name, NAMES)}")
    check_light("sky", properties, ctx)
    to_world = values.matrix(properties.get("to_world", torch.eye(4)), 4, ctx.at("to_world"))
    to_world = to_world @ to_world.new_tensor(_UPRIGHT)
    turbidity = properties.get("turbidity", 3.0)
    direction, turbidity = daylight.checked(_direction(properties, to_world, ctx), turbidity, ctx)
    height = daylight.map_height(properties.get("height", 512), ctx)
    sky_scale, sun_scale = (_scale(properties, name, ctx) for name in ("sky_scale", "sun_scale"))
    with ctx.located():
        irradiance = daylight.sun(direction, turbidity) * sun_scale
        aperture = properties.get("sun_aperture", daylight.SUN_ANGLE)
        disc = daylight.sun_disc(direction, irradiance, height=height, sun_aperture=aperture)
        data = daylight.sky(direction, turbidity, height=height) * sky_scale + disc
    more = {n: properties[n] for n in ("sampling_weight",) if n in properties}
    return EnvironmentMap(data=data, to_world=to_world, **more, _context=ctx)


def _scale(properties: dict[str, Any], name: str, ctx: Context) -> torch.Tensor:
    scale = values.number(properties.get(name, 1.0), ctx.at(name))
    if not 0 <= float(scale.detach()) < float("inf"):
        ctx.at(name).error(f"expected a factor of at least 0, got {float(scale.detach()):g}")
    return scale


def _direction(properties: dict[str, Any], to_world: torch.Tensor, ctx: Context) -> torch.Tensor:
    """Towards the sun in the frame of the map."""
    from .. import daylight

    given = [name for name in _WHEN if name in properties]
    if "sun_direction" in properties:
        if given:
            ctx.error(f"sunsky: give sun_direction, or place and time ({', '.join(given)}), but not both")
        return values.vector(properties["sun_direction"], ctx.at("sun_direction")).to(to_world) @ to_world[:3, :3]
    when = {}
    for name, (default, low, high) in _WHEN.items():
        value = properties.get(name, default)
        at = ctx.at(name)
        if isinstance(value, torch.Tensor) and value.requires_grad:
            at.error("has no derivative; give sun_direction for one")
        when[name] = number = values.integer(value, at) if name in _DATE else float(values.double(value, at))
        if not low <= number <= high:
            at.error(f"expected {low} to {high}, got {number}")
    with ctx.located():
        east, north, up = daylight.sun_position(**when)
    if up <= 0:
        ctx.error(f"sunsky: the sun is below the horizon at this place and time: {up:.3g} is the sine of its height")
    return torch.tensor([-north, up, east], dtype=torch.float64).to(to_world)
