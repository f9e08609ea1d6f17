"""Emitters: what arrives from a sampled point or direction, and what a ray that hits or escapes finds."""

from __future__ import annotations

import math
from typing import cast

import torch

from .. import warp
from ..scene.packing import Record
from ..surface import dot, inverse_linear, normalize, transform_vector
from . import numbers
from .cells import LightCells, barycentric
from .emitter import Emitter, Light, endless
from .envmap import EnvironmentMap
from .geometry import glue, reattach, root
from .lights import LIGHT_SHAPES, LightPoint, Triangles
from .world import At, World


class Area(Emitter):
    """A shape that emits."""

    def prepare(self, record: Record) -> None:
        self.shape = next(i for i, s in enumerate(self.world.records["shape"]) if s.field["emitter"] == self.index)
        texture = record.field["radiance"]
        self.constant = texture < 0 or self.world.records["texture"][texture].type == "constant"
        self.geometry = LIGHT_SHAPES[self.world.records["shape"][self.shape].type](self.world, self.shape)
        self.cells = LightCells.of(self.world, self.shape, texture)

    def radiance(self, at: At) -> torch.Tensor:
        return self.world.color("emitter", self.record, "radiance", at)

    def hit_pdf(self, p: torch.Tensor, hit: torch.Tensor, normal: torch.Tensor, at: At) -> torch.Tensor:
        """Density with which `sample` at p would have chosen the point that was hit."""
        distance = torch.linalg.vector_norm(hit - p, dim=1)
        pdf = self.geometry.pdf(p, normal, normalize(hit - p), distance)
        return pdf if self.cells is None else pdf * self.cells.density(at.primitive, at.barycentric.detach())

    def points(self, p: torch.Tensor, u: torch.Tensor) -> tuple[LightPoint, torch.Tensor]:
        """Points for the reference points p, and by how much denser they are than `geometry` says."""
        if self.cells is None:
            return self.geometry.sample(p, u), torch.ones_like(u[:, 0])
        square, density = self.cells.sample(u[:, 1:3])
        return cast("Triangles", self.geometry).at(*barycentric(square)), density

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        p = x.detach()
        y, density = self.points(p, u)
        distance = torch.linalg.vector_norm(y.position - p, dim=1)
        d = normalize(y.position - p)
        pdf = torch.where(dot(y.normal, d) < 0, self.geometry.pdf(p, y.normal, d, distance) * density, 0.0)
        shape = torch.full((len(p),), self.shape)
        delta = torch.zeros(len(p), dtype=torch.bool)
        if not self.world.moving and self.constant:
            nowhere = y.barycentric  # a colour that is the same everywhere
            return Light(d, distance, pdf, self.radiance(At(shape, y.primitive, nowhere, nowhere)), delta)
        # the point is glued to the light
        moved = glue(self.world.surfaces, shape, y.primitive, y.barycentric, y.position, y.barycentric)
        value = self.radiance(At(shape, y.primitive, y.barycentric, moved.uv))
        if not self.world.moving:
            return Light(d, distance, pdf, value, delta)
        value = value * moved.solid_angle(x)[:, None]
        return Light(reattach(d, normalize(moved.position - x)), distance, pdf, value, delta)


class Constant(Emitter):
    """An environment that is the same in all directions."""

    environment = True

    def escaped(self, d: torch.Tensor) -> torch.Tensor:
        """Radiance along rays that leave the scene, (N, C)."""
        return self.color("radiance", len(d))

    def escaped_pdf(self, d: torch.Tensor) -> torch.Tensor:
        return torch.full((len(d),), 1 / (4 * math.pi), dtype=d.dtype)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        d = warp.sphere(u[:, 1], u[:, 2])
        return endless(d, self.escaped_pdf(d), self.escaped(d))


class Point(Emitter):
    """A point that emits equally in all directions."""

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        towards = self.number("position") - x
        square = dot(towards, towards)
        apart = square > 0
        square = torch.where(apart, square, 1.0)
        value = self.color("intensity", len(x)) / square[:, None]
        pdf = torch.where(apart, 1.0, 0.0).to(square)
        return Light(normalize(towards), torch.sqrt(square).detach(), pdf.detach(), value, apart)


class Directional(Emitter):
    """Parallel light."""

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        d = -normalize(self.number("to_world")[:3, 2]).expand(len(x), 3)
        return endless(d, torch.ones_like(x[:, 0]).detach(), self.color("irradiance", len(x)), delta=True)


class Oriented(Emitter):
    """A point light with a frame: `pattern` gives the intensity along unit directions of the frame."""

    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Intensity (N, C), and whether light goes there (N,)."""
        raise NotImplementedError

    def image(self, name: str, uv: torch.Tensor) -> torch.Tensor:
        """A texture at coordinates (N, 2)."""
        none = torch.zeros(len(uv), dtype=torch.int64)
        return self.world.color("emitter", self.record, name, At(none, none, uv.detach(), uv))

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        matrix = self.number("to_world")
        towards = matrix[:3, 3] - x
        square = dot(towards, towards)
        apart = square > 0
        square = torch.where(apart, square, 1.0)
        value, lit = self.pattern(normalize(transform_vector(inverse_linear(matrix), -towards)))
        pdf = torch.where(apart & lit, 1.0, 0.0).to(square)
        value = torch.where(lit[:, None], value, 0.0) / square[:, None]
        return Light(normalize(towards), torch.sqrt(square).detach(), pdf, value, torch.ones_like(lit))


class Spot(Oriented):
    """A cone of light from a point."""

    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        cutoff, beam = torch.deg2rad(self.number("cutoff_angle")), torch.deg2rad(self.number("beam_width"))
        angle = torch.atan2(root((d[:, :2] * d[:, :2]).sum(1)), d[:, 2])
        falls = (angle > beam) & (cutoff > beam)
        fall = torch.where(falls, (cutoff - angle) / torch.where(cutoff > beam, cutoff - beam, 1.0), 1.0)
        below = d[:, 2:] * torch.sin(cutoff)
        scale = 0.5 * torch.cos(cutoff) / torch.where(below.abs() > 1e-6, below, 1e-6)
        value = self.color("intensity", len(d)) * self.image("texture", 0.5 + d[:, :2] * scale) * fall[:, None]
        return value, angle < cutoff


class Projector(Oriented):
    """An image that is thrown from a point."""

    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        index, aspect = self.record.field["irradiance"], 1.0
        if index >= 0 and self.world.records["texture"][index].type == "bitmap":
            height, width = self.world.tensor("texture", self.world.records["texture"][index], "data").shape[:2]
            aspect = width / height
        slope = torch.tan(torch.deg2rad(self.number("x_fov")) / 2)
        front = d[:, 2] > 1e-6
        z = torch.where(front, d[:, 2], 1.0)
        a, b = d[:, 0] / (z * slope), d[:, 1] / (z * slope / aspect)
        value = self.image("irradiance", torch.stack([0.5 - a / 2, 0.5 - b / 2], 1)) * self.number("scale") * math.pi
        return value / (z**3)[:, None], front & (a.abs() < 1) & (b.abs() < 1)


class Beam(Emitter):
    """A `directionalarea`: no path from the camera finds it."""

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        nothing = torch.zeros(len(x), self.world.channels, dtype=x.dtype)
        return endless(x.new_tensor([0.0, 0.0, 1.0]).expand_as(x), nothing[:, 0], nothing)


EMITTERS: dict[str, type[Emitter]] = {
    "area": Area,
    "constant": Constant,
    "envmap": EnvironmentMap,
    "point": Point,
    "directional": Directional,
    "spot": Spot,
    "projector": Projector,
    "directionalarea": Beam,
}


class Lights:
    """All emitters of a scene, chosen by their sampling weights."""

    def __init__(self, world: World) -> None:
        found = world.records["emitter"]
        self.all = [EMITTERS[r.type](world, i) for i, r in enumerate(found)]
        self.environment = next((e for e in self.all if isinstance(e, (Constant, EnvironmentMap))), None)
        self.areas = [e for e in self.all if isinstance(e, Area)]
        self.seen = bool(self.areas) or self.environment is not None  # rays can find light
        if self.all:
            weights = torch.stack([world.tensor("emitter", r, "sampling_weight").detach() for r in found])
            total = torch.cumsum(weights, 0)[-1]
            self.pmf = weights / torch.where(total > 0, total, 1.0)
            self.cdf = numbers.cumulative(weights)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        """Light from one emitter for each of the points (N, 3)."""
        index, _, _ = numbers.search(self.cdf, u[:, 0])
        if len(self.all) > 1:  # what is left of the number chooses the face of a mesh
            before = torch.where(index > 0, self.cdf[(index - 1).clamp(min=0)], 0.0)
            left = ((u[:, 0] - before) / self.pmf[index].clamp(min=1e-20)).clamp(0.0, 1 - 1e-7)
            u = torch.cat([left[:, None], u[:, 1:]], 1)
        pieces, order = [], []
        for i, emitter in enumerate(self.all):
            rows = (index == i).nonzero()[:, 0]
            if len(rows):
                light = emitter.sample(x[rows], u[rows])
                light.pdf = light.pdf * self.pmf[i]
                pieces.append(light)
                order.append(rows)
        if len(pieces) == 1:
            return pieces[0]
        return Light.cat(pieces)[torch.argsort(torch.cat(order))]
