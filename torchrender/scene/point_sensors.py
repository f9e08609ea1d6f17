"""Sensors of one pixel: the radiance along a ray, and what leaves a scene in one direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from ..errors import describe
from ..transform import as_matrix
from . import values
from .camera import Camera
from .camera_rays import Rays, distant_rays, radiancemeter_rays
from .context import Context
from .film import Film
from .plugin import Plugin
from .registry import builder, register


class DirectedSensor(Camera):
    """A film of one pixel that looks along one direction."""

    def take_film(self, properties: dict[str, Any], ctx: Context) -> None:
        super().take_film(properties, ctx)
        film = self.film
        if (film.height, film.width) == (Film().height, Film().width):
            self.__dict__["film"] = film = Film(1, 1, filter=film.filter, formats=film.formats)
        if (film.height, film.width) != (1, 1):
            ctx.error(f"{self.type}: has one pixel, but its film is {film.height} x {film.width}")

    def take_direction(self, origin: Any, properties: dict[str, Any], ctx: Context) -> None:
        """Replace `direction` by a matrix at `origin` whose z axis that is."""
        if "to_world" in properties:
            ctx.error(f"{self.type}: to_world and direction are both given; give one of them")
        direction = values.vector(properties.pop("direction"), ctx.at("direction"))
        if not float(torch.linalg.vector_norm(direction.detach())) > 0:
            ctx.at("direction").error("expected a vector of some length")
        given = direction.double()
        z = given / torch.linalg.vector_norm(given)
        across = torch.zeros_like(z)
        across[int(z.detach().abs().argmin())] = 1.0
        x = torch.linalg.cross(across, z)
        x = x / torch.linalg.vector_norm(x)
        columns = torch.stack([x, torch.linalg.cross(z, x), z, origin.double()], 1)
        matrix = torch.cat([columns, columns.new_tensor([[0.0, 0.0, 0.0, 1.0]])])
        properties["to_world"] = values.rounded(as_matrix(matrix, 4, ctx.where), direction, ctx)

    def count(self, positions: Any) -> int:
        """How many rays are asked for."""
        return len(self.positions(positions))


@builder("batch", "sensor")
def _batch(_properties: dict[str, Any], ctx: Context) -> Plugin:
    ctx.error("a batch stands at the top of the dict or file that a scene is loaded from, which takes its cameras")


@register
class RadianceMeter(DirectedSensor):
    """The radiance along one ray; its film has one pixel.

    Args:
        to_world: 4x4 matrix: the ray starts at the frame's origin and goes along its z axis.
        origin, direction: (3,) in place of it, in world space.
        film, sampler: dicts or objects.
        medium: the medium that the ray starts in, if it starts in one.
    """

    type = "radiancemeter"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["origin", "direction", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        if ("origin" in properties) != ("direction" in properties):
            ctx.error("radiancemeter: origin and direction belong together")
        if "direction" in properties:
            self.take_direction(values.vector(properties.pop("origin"), ctx.at("origin")), properties, ctx)
        return super().prepare(properties, ctx)

    def rays(self, positions: Any = None) -> Rays:
        """The ray, once for each of `positions` (N, 2), whose values do not matter; differentiable in `to_world`."""
        return radiancemeter_rays(self.to_world, self.count(positions))


@register
class DistantSensor(DirectedSensor):
    """Radiance that leaves the scene in one direction, from far away; its film has one pixel.

    Without a target it is the average over the cross section of a ball around the scene, with one it is what leaves
    along the ray through that point.

    Args:
        to_world: 4x4 matrix whose z axis is the direction in which rays travel into the scene.
        direction: (3,) in place of it, in world space.
        target: (3,) a point that all rays meet. (A shape as target is not supported.)
        film, sampler: dicts or objects.
    """

    type = "distant"

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["direction", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        for name, value in properties.items():
            if getattr(value, "category", None) == "shape" or (
                isinstance(value, Mapping) and name not in ("film", "sampler") and name == "target"
            ):
                ctx.at(name).error(f"expected a point, got {describe(value)}; shapes are not supported as targets")
        if "direction" in properties:
            self.take_direction(torch.zeros(3), properties, ctx)
        return super().prepare(properties, ctx)

    def convert_tensor(self, field: Any, value: Any, ctx: Context) -> torch.Tensor:
        return values.vector(value, ctx).contiguous()

    def required(self) -> dict[str, Any]:
        return {} if self.target is None else {"target": [0.0, 0.0, 0.0]}

    def rays(self, positions: Any = None, lens: Any = None, *, bounds: Any) -> Rays:
        """Rays, differentiable in `to_world` and `target`.

        Args:
            positions: (N, 2) on the film, whose values do not matter.
            lens: (N, 2) in the unit square, which is mapped onto the ball's cross section; None: its middle.
            bounds: (2, 3) lower and upper corner of the scene, as of `Scene.bounding_box`.
        """
        count = self.count(positions)
        return distant_rays(
            self.to_world, self.target, torch.as_tensor(bounds).to(self.to_world), self.on_lens(lens, count)
        )
