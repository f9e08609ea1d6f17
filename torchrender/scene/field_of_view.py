"""Fields of view: along which axis of the film, from focal lengths, and how they go with the film's width."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch

from . import values
from .context import Context

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")
# The diagonal of the 36 mm x 24 mm frame that focal lengths refer to.
FRAME_DIAGONAL = math.hypot(36.0, 24.0)


def along_x(axis: str, aspect: float) -> float:
    """How many times as wide as along `axis` a film is; `aspect` is width / height."""
    if axis in ("smaller", "larger"):
        axis = "x" if (aspect > 1) == (axis == "larger") else "y"
    return {"x": 1.0, "y": aspect, "diagonal": aspect / math.hypot(1.0, aspect)}[axis]


def scale_tangent(fov: torch.Tensor, factor: float) -> torch.Tensor:
    """The field of view, in degrees, of a film that is `factor` times as wide, without distortion."""
    if factor == 1:
        return fov
    return torch.rad2deg(2 * torch.atan(torch.tan(torch.deg2rad(fov) / 2) * factor))


def scale_angle(fov: torch.Tensor, factor: float) -> torch.Tensor:
    """The same for a lens whose image grows with the angle."""
    return fov * factor


def take_fov(
    owner: str,
    properties: dict[str, Any],
    aspect: float,
    ctx: Context,
    most: float = 180.0,
    scale: Callable[[torch.Tensor, float], torch.Tensor] = scale_tangent,
    otherwise: str | None = "50mm",
) -> None:
    """Replace `fov` with `fov_axis`, or `focal_length`, in `properties` by `x_fov`.

    `aspect` is width / height; `scale` is how fields of view, which are less than `most`, go with the film's width;
    without any the focal length is `otherwise`.
    """
    axis = properties.pop("fov_axis", "x")
    values.choice(axis, FOV_AXES, ctx.at("fov_axis"))
    ways = [n for n in ("fov", "focal_length", "x_fov") if n in properties]
    if len(ways) > 1:
        ctx.error(f"{owner}: give one of fov, focal_length and x_fov, not {' and '.join(ways)}")
    if "fov" in properties:
        given = properties.pop("fov")
        fov = scale(_angle(given, ctx.at("fov"), most), along_x(axis, aspect))
        properties["x_fov"] = values.rounded(fov, given, ctx)
    elif "x_fov" in properties:
        _angle(properties["x_fov"], ctx.at("x_fov"), most)
    elif otherwise is not None:
        given = properties.pop("focal_length", otherwise)
        millimetres = _millimetres(given, ctx.at("focal_length"))
        diagonal = torch.rad2deg(2 * torch.atan(FRAME_DIAGONAL / (2 * millimetres)))
        properties["x_fov"] = values.rounded(scale_tangent(diagonal, along_x("diagonal", aspect)), given, ctx)


def _angle(value: Any, ctx: Context, most: float = 180.0) -> torch.Tensor:
    angle = values.double(value, ctx)
    if not 0 < float(angle.detach()) < most:
        ctx.error(f"expected an angle between 0 and {most:g} degrees, got {float(angle.detach()):g}")
    return angle


def _millimetres(value: Any, ctx: Context) -> torch.Tensor:
    if isinstance(value, str):
        text = value.strip()
        try:
            value = float(text[:-2] if text.endswith("mm") else text)
        except ValueError:
            ctx.error(f"expected a length like '50mm', got {value!r}")
    length = values.double(value, ctx)
    if not 0 < float(length.detach()) < float("inf"):
        ctx.error(f"expected a positive length, got {float(length.detach()):g}")
    return length
