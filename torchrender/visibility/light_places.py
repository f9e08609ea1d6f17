"""Places on lights, from which outlines are looked for."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..surface import normalize
from ..wavefront.emitter import Emitter
from ..wavefront.emitters import Area, Constant, Directional, Lights, Oriented, Point
from ..wavefront.envmap import EnvironmentMap
from ..wavefront.geometry import glue
from ..wavefront.world import At, World


@dataclass
class Places:
    """Places on one light, or directions of one that is infinitely far away (`far`).

    Attributes:
        at: (N, 3) where places are; unit directions with the light.
        moving: the same, attached; None where it is at rest.
        normal: (N, 3) of shapes, else zero.
        weight: (N,) one over the density of the place.
        surface: of shapes, where they are on them.
    """

    light: Emitter
    at: torch.Tensor
    moving: torch.Tensor | None
    normal: torch.Tensor
    weight: torch.Tensor
    surface: At | None = None

    @property
    def far(self) -> bool:
        return self.light.environment or isinstance(self.light, Directional)

    def arriving(
        self, lights: Lights, rows: torch.Tensor, s: torch.Tensor, d: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """What the places of these rows send to points s (N, 3), which see them in directions d (N, 3).

        (N, C) radiance, of points intensity, of parallel light irradiance across it; and the density (N,) of d for the
        path tracer's emitter samples, 0 where no ray finds the light by itself.
        """
        light = self.light
        chance = lights.pmf[light.index]
        if isinstance(light, Area) and self.surface is not None:
            towards = self.at[rows] - s
            distance = torch.linalg.vector_norm(towards, dim=1)
            density = light.geometry.pdf(s, self.normal[rows], normalize(towards), distance)
            return light.radiance(self.surface[rows]), density * chance
        if isinstance(light, (Constant, EnvironmentMap)):
            return light.escaped(d), light.escaped_pdf(d) * chance
        sample = light.sample(s, s.new_zeros(len(s), 4))
        square = 1.0 if self.far else sample.distance[:, None] ** 2
        return sample.value * square, torch.zeros_like(d[:, 0])


def light_places(world: World, light: Emitter, u: torch.Tensor) -> Places:
    """N places on a light, from numbers u (N, 3); on shapes uniform by area."""
    n, zero, one = len(u), u.new_zeros(len(u), 3), torch.ones_like(u[:, 0])
    if isinstance(light, Area):
        surfaces = world.surfaces
        with torch.no_grad():
            centre = surfaces.to_world[light.shape, :3, 3].detach().expand(n, 3)  # from where a sphere is uniform, too
            point = light.geometry.sample(centre, u[:, [2, 0, 1]])
            shape, area = torch.full((n,), light.shape), light.geometry.area.expand(n)
        glued = glue(surfaces, shape, point.primitive, point.barycentric, point.position, point.barycentric)
        surface = At(shape, point.primitive, point.barycentric, glued.uv.detach())
        return Places(light, point.position, glued.position, point.normal, area, surface)
    if isinstance(light, (Point, Oriented)):
        place = light.number("position") if isinstance(light, Point) else light.number("to_world")[:3, 3]
        return Places(light, place.detach().expand(n, 3), place.expand(n, 3), zero, one)
    if isinstance(light, Directional):
        direction = normalize(light.number("to_world")[:3, 2][None]).expand(n, 3)
        return Places(light, direction.detach(), direction, zero, one)
    with torch.no_grad():
        sample = light.sample(zero, torch.cat([u[:, 2:3], u], 1))
        weight = torch.where(sample.pdf > 0, 1 / sample.pdf, 0.0)
    return Places(light, -sample.direction.detach(), None, zero, weight)
