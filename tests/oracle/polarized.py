"""Images of Stokes vectors as textbooks have them: products of Mueller matrices along the paths of a path tracer.

Each direction has an axis of its own, a function of it alone, as in Mitsuba; matrices of surfaces are turned to the
axes of both directions, and those of a path are multiplied from the camera on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch

import torchrender as tr
from torchrender.scene.camera import Rays
from torchrender.wavefront.emitters import Area
from torchrender.wavefront.path import Paths, Vertices, WavefrontTracer
from torchrender.wavefront.world import World as Traced

from .bsdf import in_pytorch
from .bsdf.common import Part, Polarising
from .film import camera_samples, numbers_of, splat
from .mueller import DEPOLARISER, across, implicit_axis, rotation
from .polarized_lights import PolarizedLights
from .world import World


def on_implicit_axes(parts: list[Part], wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
    """What `Polarising.parts` finds, for light from wo towards wi (N, 3), with a first entry of 1: (N, C, 4, 4)."""

    def turned(axis: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
        after = rotation(wi, across(wi, axis), implicit_axis(wi))
        before = rotation(-wo, implicit_axis(-wo), across(-wo, axis))
        return after @ (matrix / matrix[..., :1, :1]) @ before

    return torch.stack([share[..., None, None] * turned(axis, matrix) for share, axis, matrix in parts]).sum(0)


class PolarizedTracer(WavefrontTracer):
    """Paths whose throughput is a Mueller matrix of each colour, (N, C, 4, 4)."""

    components = (4,)

    def __init__(self, world: Traced, *settings: Any) -> None:
        super().__init__(world, *settings)
        self.lights: PolarizedLights = PolarizedLights(world)

    def first_points(self, rays: Rays) -> Paths:
        paths = super().first_points(rays)
        up = self.world.tensor("sensor", self.world.records["sensor"][self.random.sensor], "to_world")[:3, 1]
        k = -rays.directions
        horizontal = across(k, torch.linalg.cross(up.expand_as(k), k))
        beta = rotation(k, implicit_axis(k), horizontal).expand(-1, self.world.channels, 4, 4)
        return replace(paths, beta=beta)

    def throughput(
        self, number: int, vertices: Vertices, d: torch.Tensor, lobe: torch.Tensor, value: torch.Tensor
    ) -> torch.Tensor:
        bsdf, matrix = self.bsdf(number, vertices), DEPOLARISER
        if isinstance(bsdf, Polarising):
            parts = bsdf.parts(vertices.wi, vertices.to_local(d), lobe)
            parts = [(share, vertices.to_world(axis), matrix) for share, axis, matrix in parts]
            matrix = on_implicit_axes(parts, -vertices.paths.d, d)
        return vertices.paths.beta @ (value[..., None, None] * matrix)

    def met(self, light: Area, paths: Paths) -> torch.Tensor:
        return self.lights.met(light, paths)

    def arriving(self, beta: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
        """What arrives of Stokes vectors (N, C, 4), or of unpolarised light (N, C)."""
        if radiance.ndim == 2:
            return beta[..., 0] * radiance[..., None]
        return (beta @ radiance[..., None])[..., 0]


def stokes_image(
    scene: tr.Scene,
    *,
    seed: int,
    spp: int,
    params: Mapping[str, torch.Tensor] | None = None,
    derivative: bool = False,
    sensor: int = 0,
) -> torch.Tensor:
    """(H, W, C, 4), attached to `params`. `derivative`: of the paths that the native derivative has."""
    world = World(scene, params)
    with in_pytorch():
        positions, rays, pixel, sample = camera_samples(world, seed, spp, sensor)
        random = numbers_of(scene, spp, seed, sensor)
        config = {**tr.PathTracer().config(), **(scene.integrator or tr.PathTracer()).config()}
        stokes, _ = PolarizedTracer(world, config, random, derivative).trace(rays, pixel, sample)
    sums, weights = splat(scene.sensors[sensor].film, *positions.unbind(1), stokes.flatten(1))
    return (sums / weights).unflatten(-1, (-1, 4))
