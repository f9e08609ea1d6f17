"""Emitters that need more than their declaration."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from . import values
from .camera import check_light
from .construction import check_names, child_of
from .context import Context
from .declaration import Field
from .field_of_view import take_fov
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
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"mis_compensation": (False,)}
    noted: ClassVar[dict[str, str]] = {"mis_compensation": "is not there: it changes the noise alone"}
    words: ClassVar[tuple[str, ...]] = ("filename", "bitmap")

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", "bitmap", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        check_names(self, {k: v for k, v in properties.items() if k not in ("filename", "bitmap")}, ctx)
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
        stokes: (Q, U, V) / I of its light (3,), Q along the world's x axis across the ray; 0 without it.
    """

    category, type = "emitter", "point"
    words: ClassVar[tuple[str, ...]] = ("to_world",)

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


@register
class DirectionalLight(Plugin):
    """Parallel light from infinitely far away, such as the sun's.

    Args:
        irradiance: colour, power per area perpendicular to the light.
        direction: where the light travels (3,), of any length.
        to_world: in place of `direction`, and what is kept: the light travels along its +z axis.
        sampling_weight: relative number of emitter samples.
        stokes: (Q, U, V) / I of its light (3,), Q along the x axis of `to_world` across the ray; 0 without it.
    """

    category, type = "emitter", "directional"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return [*super().parameter_names(), "direction"]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if "direction" in properties:
            if "to_world" in properties:
                ctx.error("directional: give direction or to_world, but not both")
            properties["to_world"] = _frame_along(properties.pop("direction"), ctx.at("direction"))
        return properties

    @property
    def direction(self) -> torch.Tensor:
        """Where the light travels, a unit vector (3,); attached to `to_world`. Assigning turns `to_world`."""
        axis = self.to_world[:3, 2]
        return axis / torch.linalg.vector_norm(axis)

    @direction.setter
    def direction(self, value: Any) -> None:
        ctx = Context(dtype=self.to_world.dtype, device=self.to_world.device, path=("DirectionalLight", "direction"))
        self.to_world = _frame_along(value, ctx)


def _frame_along(direction: Any, ctx: Context) -> torch.Tensor:
    """A rotation (4, 4) whose +z axis has this direction; differentiable."""
    given = values.vector(direction, ctx)
    length = torch.linalg.vector_norm(given)
    if not 0 < float(length.detach()) < float("inf"):
        ctx.error(f"expected a direction that is not zero, got {given.tolist()}")
    z = given / length
    other = torch.zeros_like(z)
    other[int(z.detach().abs().argmin())] = 1.0
    x = torch.linalg.cross(other, z)
    x = x / torch.linalg.vector_norm(x)
    columns = torch.stack([x, torch.linalg.cross(z, x), z, torch.zeros_like(z)], dim=1)
    return torch.cat([columns, columns.new_tensor([[0.0, 0.0, 0.0, 1.0]])])


@register
class SpotLight(Plugin):
    """A cone of light from a point, along the +z axis of its frame.

    The intensity is constant up to an angle of `beam_width` from the axis and falls linearly, in the angle, to zero at
    `cutoff_angle`.

    Args:
        intensity: radiant intensity (colour) along the axis, power per solid angle.
        cutoff_angle: degrees, up to 180; default 20.
        beam_width: degrees, at most `cutoff_angle`; default three quarters of it.
        texture: a factor of the intensity (texture). Its square of coordinates is that around the cone, where it meets
            a plane across the axis.
        to_world: 4x4 matrix, the light's frame to the world; a scale, the same in all directions, is left out.
        sampling_weight: relative number of emitter samples.
        stokes: (Q, U, V) / I of its light (3,), Q along the x axis of `to_world` across the ray; 0 without it.
    """

    category, type = "emitter", "spot"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        check_light("spot light", properties, ctx)
        if "beam_width" not in properties:
            cutoff = properties.get("cutoff_angle", self.fields()["cutoff_angle"].default)
            properties["beam_width"] = 0.75 * values.number(cutoff, ctx.at("cutoff_angle")).detach()
        return properties

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        beam, cutoff = (float(getattr(self, n).detach()) for n in ("beam_width", "cutoff_angle"))
        if beam > cutoff:
            ctx.at("beam_width").error(f"expected at most cutoff_angle, which is {cutoff:g}, got {beam:g}")

    def derivative_of(self, field: Field) -> str:
        if field.name in ("cutoff_angle", "beam_width") and bool((self.beam_width < self.cutoff_angle).detach()):
            return "interior"  # the intensity falls to zero continuously: the cone has no edge
        return super().derivative_of(field)


@register
class Projector(Plugin):
    """A light that throws an image along the +z axis of its frame, whose +x axis is left in it and +y up.

    A white diffuse screen across the axis at distance 1 shows `scale` times the image itself.

    Args:
        irradiance: the image (texture), row 0 at the top; its pixels are square.
        scale: a factor.
        to_world: 4x4 matrix, the projector's frame to the world; a scale, the same in all directions, is left out.
        fov: field of view in degrees along `fov_axis` (``x``, ``y``, ``diagonal``, ``smaller``, ``larger``).
        focal_length: in place of `fov`: millimetres on a 36 x 24 mm frame, a number or ``"50mm"``, the default.
        sampling_weight: relative number of emitter samples.
        stokes: (Q, U, V) / I of its light (3,), Q along the x axis of `to_world` across the ray; 0 without it.
    """

    category, type = "emitter", "projector"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["fov", "fov_axis", "focal_length", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        check_light("projector", properties, ctx)
        aspect: float | None = 1.0
        if "irradiance" in properties:
            image = child_of(properties["irradiance"], "texture", ctx.at("irradiance"))
            properties["irradiance"] = image
            aspect = _aspect(image) if isinstance(image, Plugin) else None
        if aspect is None and "x_fov" not in properties and properties.get("fov_axis", "x") != "x":
            ctx.at("fov_axis").error("with a reference to an image elsewhere, only 'x' is known")
        if aspect is None and "x_fov" not in properties and "fov" not in properties:
            ctx.error("projector: with a reference to an image elsewhere, give fov")
        take_fov(self.type, properties, aspect or 1.0, ctx)
        return properties


def _aspect(image: Plugin) -> float:
    """Width over height of a bitmap, 1 of other textures."""
    data = image._parameters.get("data")
    return 1.0 if image.type != "bitmap" or data is None else data.shape[1] / data.shape[0]
