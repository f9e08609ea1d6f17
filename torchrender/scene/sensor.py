"""What all sensors share, and the one that is no camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, cast

import torch
from torch.utils.data._utils.collate import default_collate_fn_map

from .bands import response
from .context import Context
from .film import SAMPLERS, Film, Sampler, film_from, sampler_from
from .plugin import Plugin
from .registry import DOCUMENTED, plugin_class, register

_SIZE = "the size is that of its film, {'type': 'hdrfilm', 'width': 640, 'height': 480}, or render(..., size=(H, W))"
_SAMPLES = "their number is that of its sampler, {'type': 'independent', 'sample_count': 64}, or render(..., spp=64)"
_POSE = "where it is and looks is its 'to_world', tr.Transform.look_at(origin, target, up)"


class Sensor(Plugin):
    """A film, and how it is sampled."""

    category = "sensor"
    elsewhere: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("width", "height", "size", "resolution"), _SIZE),
        **dict.fromkeys(("spp", "samples", "sample_count"), _SAMPLES),
        **dict.fromkeys(("look_at", "lookat", "origin", "target", "up", "position"), _POSE),
    }

    film: Film
    sampler: Sampler | None
    srf: torch.Tensor | None  # by what the film's responses are multiplied, a table (471,)

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["film", "sampler", "srf", *super().parameter_names()]

    def take_film(self, properties: dict[str, Any], ctx: Context) -> None:
        """Take film and sampler, by whichever name they go, out of `properties`."""
        film, sampler = Film(), None
        for name in list(properties):
            value = properties[name]
            kind = value.get("type") if isinstance(value, Mapping) else None
            kind = kind if isinstance(kind, str) else ""
            if name == "film" or isinstance(value, Film) or kind.endswith("film"):
                film = film_from(properties.pop(name), ctx.at(name))
            elif name == "sampler" or isinstance(value, Sampler) or kind in (*SAMPLERS, *DOCUMENTED["sampler"]):
                sampler = sampler_from(properties.pop(name), ctx.at(name))
        srf = properties.pop("srf", None)
        if srf is not None and ctx.color not in (None, "spectral"):
            ctx.at("srf").error(f"needs wavelengths: a scene of the variant 'spectral', not {ctx.color!r}")
        self.__dict__["film"] = film
        self.__dict__["sampler"] = sampler
        self.__dict__["srf"] = None if srf is None else response(srf, ctx.at("srf"))

    def hint(self, name: str) -> str:
        if name in Film.__dataclass_fields__:
            return f"it is one of its film: film.{name}"
        return super().hint(name)

    def __setattr__(self, name: str, value: Any) -> None:
        convert = {"film": film_from, "sampler": sampler_from, "srf": response}.get(name)
        if convert is not None and not (name != "film" and value is None):
            value = convert(value, Context(path=(type(self).__name__, name)))
        super().__setattr__(name, value)

    def required(self) -> dict[str, Any]:
        """Properties of the least sensor that is packed as this one is."""
        return {}

    def placeholder(self, ctx: Context) -> Sensor:
        """A sensor that is packed as this one is: this one is rendered in its place."""
        cls = cast("type[Sensor]", plugin_class("sensor", self.type))
        return cls(film=Film(1, 1), _context=ctx, **self.required())

    def kind(self) -> tuple[str, ...]:
        """Equal for sensors that can be rendered in place of each other."""
        return (self.type, *self.required())

    def extra_repr(self) -> str:
        film = self.film
        crop = f", crop={film.crop}" if film.crop is not None else ""
        sampler = self.sampler
        count = f", {sampler.sample_count} {sampler.type} samples a pixel" if sampler is not None else ""
        return f"{film.height} x {film.width} pixels, {film.filter.type} filter{crop}{count}"


@register
class IrradianceMeter(Sensor):
    """Irradiance on a surface, per texel: power that arrives on its front, per area, measured by `ParticleTracer`.

    The film covers the square of the surface's texture coordinates, row 0 at v = 0 and column 0 at u = 0; the image is
    (H, W, C), in the unit of radiance times steradians. The surface's BSDF does not matter; with `null` light passes
    on through it. In a scene dict it stands beside the shape and names it, or inside of the shape.

    Args:
        shape: a rectangle, or a mesh with texture coordinates that cover no point of the square twice: the object, or
            a reference to it.
        film, sampler: dicts or objects.
    """

    type = "irradiancemeter"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        self.take_film(properties, ctx)
        return properties

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if self._child("shape") is None and not self._references:
            ctx.error("irradiancemeter: 'shape' is missing: the surface that it lies on")


def default_sampler(camera: Sensor) -> Sampler:
    """Number and kind of samples when nothing is said: the camera's own, else those of `Sampler()`.

    ValueError for one that an edit has made wrong.
    """
    sampler = camera.sampler
    if sampler is None:
        return Sampler()
    sampler.check(Context(path=("sampler",)))
    return sampler


# So that a Dataset may return cameras: a batch of them is a list, which `render` takes.
default_collate_fn_map[Sensor] = lambda batch, *, collate_fn_map=None: list(batch)
