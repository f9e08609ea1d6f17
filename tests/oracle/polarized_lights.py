"""Light of lamps as Stokes vectors, on the implicit axes of its directions.

Shares Q, U and V of the intensity are those on an axis of the lamp: dp/du of a shape, else the x axis of its frame, or
of the world. What of it lies across the ray counts.
"""

from __future__ import annotations

import torch

from torchrender.wavefront.emitter import Emitter, Light
from torchrender.wavefront.emitters import Area, Lights
from torchrender.wavefront.geometry import glue
from torchrender.wavefront.partials import partials
from torchrender.wavefront.path import Paths
from torchrender.wavefront.world import At, World

from .mueller import across, implicit_axis, rotation


class PolarizedEmitter:
    """An emitter whose samples are Stokes vectors, (N, C, 4)."""

    def __init__(self, emitter: Emitter) -> None:
        self.emitter, self.world = emitter, emitter.world

    def stokes(self, radiance: torch.Tensor, k: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """Of light (N, C) that travels along k (N, 3), polarised on this axis (N, 3)."""
        shares = radiance.new_zeros(3)
        if "stokes" in self.emitter.record.field:
            shares = self.emitter.number("stokes")
        light = radiance[..., None] * torch.cat([torch.ones_like(shares[:1]), shares])
        return (rotation(k, across(k, axis), implicit_axis(k)) @ light[..., None])[..., 0]

    def axis(self, x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """That of light that `sample` of the same has found, (N, 3)."""
        if isinstance(self.emitter, Area):
            y, _ = self.emitter.points(x.detach(), u)
            shape = torch.full((len(x),), self.emitter.shape)
            p = glue(self.world.surfaces, shape, y.primitive, y.barycentric, y.position, y.barycentric).position
            return partials(self.world, At(shape, y.primitive, y.barycentric, y.barycentric), p)[0]
        if "to_world" in self.emitter.record.field:
            return self.emitter.number("to_world")[:3, 0].expand_as(x)
        return x.new_tensor([1.0, 0.0, 0.0]).expand_as(x)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        light = self.emitter.sample(x, u)
        light.value = self.stokes(light.value, -light.direction, self.axis(x, u))
        return light


class PolarizedLights(Lights):
    """All emitters of a scene, of which each sample is a Stokes vector."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.all = [PolarizedEmitter(e) for e in self.all]

    def met(self, light: Area, paths: Paths) -> torch.Tensor:
        """What the light sends along paths that have met it, (N, C, 4)."""
        axis = partials(light.world, paths.at, paths.position)[0]
        return PolarizedEmitter(light).stokes(light.radiance(paths.at), -paths.d, axis)
