"""Emitters: what arrives from a sampled point or direction, and what a ray that hits or escapes finds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from . import numbers
from .geometry import Rows, dot, normalize, reattach
from .glued import glue
from .shapes import SHAPES
from .textures import bilinear
from .world import At, Record, World


@dataclass
class Light(Rows):
    """Sampled light at N points.

    `direction` (N, 3), unit, from the point; `distance` (N,), detached; `pdf` (N,) per solid angle, detached, 0 where
    nothing arrives; `value` (N, C), emission times the geometry that moves, over what it was when it was sampled;
    `delta` (N,), no ray can hit the emitter by itself.
    """

    direction: torch.Tensor
    distance: torch.Tensor
    pdf: torch.Tensor
    value: torch.Tensor
    delta: torch.Tensor


class Emitter:
    """An emitter of a scene; `index` is its number."""

    environment = False  # seen by rays that leave the scene

    def __init__(self, world: World, index: int) -> None:
        self.world, self.index, self.record = world, index, world.records["emitter"][index]
        self.prepare(self.record)

    def prepare(self, record: Record) -> None:
        """What is needed besides."""

    def color(self, name: str, count: int) -> torch.Tensor:
        return self.world.tensor("emitter", self.record, name).expand(count, self.world.channels)


class Area(Emitter):
    def prepare(self, record: Record) -> None:
        self.shape = next(i for i, s in enumerate(self.world.records["shape"]) if s.field["emitter"] == self.index)
        self.geometry = SHAPES[self.world.records["shape"][self.shape].type](self.world, self.shape)

    def radiance(self, at: At) -> torch.Tensor:
        return self.world.color("emitter", self.record, "radiance", at)

    def hit_pdf(self, p: torch.Tensor, hit: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """Density with which `sample` at p would have chosen the point that was hit."""
        distance = torch.linalg.vector_norm(hit - p, dim=1)
        return self.geometry.pdf(p, normal, normalize(hit - p), distance)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        p = x.detach()
        y = self.geometry.sample(p, u)
        distance = torch.linalg.vector_norm(y.position - p, dim=1)
        d = normalize(y.position - p)
        pdf = torch.where(dot(y.normal, d) < 0, self.geometry.pdf(p, y.normal, d, distance), 0.0)
        # the point is glued to the light
        shape = torch.full((len(p),), self.shape)
        moved = glue(self.world.surfaces, shape, y.primitive, y.barycentric, y.position, y.barycentric)
        value = self.radiance(At(shape, y.primitive, y.barycentric, moved.uv)) * moved.solid_angle(x)[:, None]
        direction = reattach(d, normalize(moved.position - x))
        return Light(direction, distance, pdf, value, torch.zeros(len(p), dtype=torch.bool))


class Constant(Emitter):
    environment = True

    def escaped(self, d: torch.Tensor) -> torch.Tensor:
        """Radiance along rays that leave the scene, (N, C)."""
        return self.color("radiance", len(d))

    def escaped_pdf(self, d: torch.Tensor) -> torch.Tensor:
        return torch.full((len(d),), 1 / (4 * math.pi), dtype=d.dtype)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        d = numbers.sphere(u[:, 1], u[:, 2])
        infinite = torch.full((len(d),), math.inf, dtype=d.dtype)
        return Light(d, infinite, self.escaped_pdf(d), self.escaped(d), torch.zeros(len(d), dtype=torch.bool))


class EnvironmentMap(Emitter):
    environment = True

    def prepare(self, record: Record) -> None:
        self.data = self.world.tensor("emitter", record, "data")
        self.scale = self.world.tensor("emitter", record, "scale")
        self.to_world = self.world.tensor("emitter", record, "to_world")[:3, :3]
        texels = self.data.detach()
        height = texels.shape[0]
        if texels.shape[2] == 3:
            importance = (texels * texels.new_tensor([0.2126, 0.7152, 0.0722])).sum(2).clamp(min=0.0)
        else:
            importance = texels[..., 0].clamp(min=0.0)
        pairs = importance + importance.roll(-1, 1)
        rows = max(height - 1, 1)
        cells = 0.25 * (pairs[:rows] + pairs[-rows:])
        if not bool(importance.any()):
            cells = torch.ones_like(cells)
        self.conditional = numbers.cumulative(cells)
        sine = torch.sin((torch.arange(rows, dtype=torch.float64) + 0.5) / rows * math.pi)
        self.marginal = numbers.cumulative(torch.cumsum(cells, 1)[:, -1] * sine)
        self.rows, self.columns = cells.shape

    def coordinates(self, d: torch.Tensor) -> torch.Tensor:
        """World directions to (u, v) of the map: (N, 2)."""
        x, y, z = normalize(d @ torch.linalg.inv(self.to_world).T).unbind(1)
        u = torch.atan2(x, -z) / (2 * math.pi)
        return torch.stack([u - torch.floor(u.detach()), torch.acos(y.clamp(-1.0, 1.0)) / math.pi], 1)

    def at(self, uv: torch.Tensor) -> torch.Tensor:
        """Radiance (N, C) at coordinates of the map."""
        height, width = self.data.shape[:2]
        x, y = uv[:, 0] * width - 0.5, uv[:, 1] * (height - 1)
        left, top = torch.floor(x.detach()), torch.floor(y.detach()).clamp(0, max(height - 2, 0))
        columns = (left.long() % width, (left.long() + 1) % width)
        rows = (top.long(), (top.long() + 1).clamp(max=height - 1))
        return bilinear(self.data, rows, columns, x - left, y - top, self.world.channels) * self.scale

    def density(self, mass: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        sine = torch.sin(v * math.pi)
        usable = sine > 1e-6
        per_area = mass * self.rows * self.columns / (2 * math.pi**2 * torch.where(usable, sine, 1.0))
        return torch.where(usable, per_area, 0.0)

    def escaped(self, d: torch.Tensor) -> torch.Tensor:
        return self.at(self.coordinates(d))

    def escaped_pdf(self, d: torch.Tensor) -> torch.Tensor:
        u, v = self.coordinates(d).detach().unbind(1)
        j = torch.floor(u * self.columns - 0.5).long() % self.columns
        i = torch.floor(v * self.rows).long().clamp(0, self.rows - 1)
        row = torch.diff(self.marginal, prepend=self.marginal.new_zeros(1))[i]
        column = torch.diff(self.conditional, prepend=self.conditional.new_zeros(self.rows, 1), dim=1)[i, j]
        return self.density(row * column, v)

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        i, row, down = numbers.search(self.marginal, u[:, 1])
        cdf = self.conditional[i]
        j = (cdf <= u[:, 2:3]).sum(1).clamp(max=self.columns - 1)
        before = torch.where(j > 0, cdf.gather(1, (j - 1).clamp(min=0)[:, None])[:, 0], 0.0)
        column = cdf.gather(1, j[:, None])[:, 0] - before
        across = (u[:, 2] - before) / column.clamp(min=1e-20)
        azimuth = (j + 0.5 + across.clamp(0.0, 1.0)) / self.columns
        azimuth = azimuth - torch.floor(azimuth)
        v = (i + down.clamp(0.0, 1.0)) / self.rows
        phi, theta = azimuth * (2 * math.pi), v * math.pi
        sine = torch.sin(theta)
        local = torch.stack([sine * torch.sin(phi), torch.cos(theta), -sine * torch.cos(phi)], 1)
        d = normalize(local @ self.to_world.detach().T)
        # the direction stays where it is while the map turns
        uv = torch.stack([azimuth, v], 1)
        value = self.at(reattach(uv, self.coordinates(d)))
        infinite = torch.full((len(d),), math.inf, dtype=d.dtype)
        return Light(d, infinite, self.density(row * column, v), value, torch.zeros(len(d), dtype=torch.bool))


class Point(Emitter):
    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        towards = self.world.tensor("emitter", self.record, "position") - x
        square = dot(towards, towards)
        apart = square > 0
        square = torch.where(apart, square, 1.0)
        value = self.color("intensity", len(x)) / square[:, None]
        pdf = torch.where(apart, 1.0, 0.0).to(square)
        return Light(normalize(towards), torch.sqrt(square).detach(), pdf, value, apart)


class Directional(Emitter):
    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        axis = self.world.tensor("emitter", self.record, "to_world")[:3, 2]
        d = -(axis / torch.linalg.vector_norm(axis)).expand(len(x), 3)
        one = torch.ones(len(x), dtype=d.dtype)
        return Light(d, math.inf * one, one, self.color("irradiance", len(x)), one.bool())


class Oriented(Emitter):
    """A point light with a frame: `pattern` gives what it sends along unit directions of that frame."""

    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Intensity (N, C), and whether light goes there (N,)."""
        raise NotImplementedError

    def number(self, name: str) -> torch.Tensor:
        return self.world.tensor("emitter", self.record, name)

    def image(self, name: str, uv: torch.Tensor) -> torch.Tensor:
        """A texture at coordinates (N, 2)."""
        none = torch.zeros(len(uv), dtype=torch.int64)
        return self.world.color("emitter", self.record, name, At(none, none, uv.detach(), uv))

    def sample(self, x: torch.Tensor, u: torch.Tensor) -> Light:
        to_world = self.number("to_world")
        towards = to_world[:3, 3] - x
        square = dot(towards, towards)
        value, lit = self.pattern(normalize(-towards @ torch.linalg.inv(to_world[:3, :3]).T))
        pdf = lit.to(square)
        everywhere = torch.ones_like(lit)
        return Light(normalize(towards), torch.sqrt(square).detach(), pdf, value / square[:, None], everywhere)


class Spot(Oriented):
    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        cutoff, beam = torch.deg2rad(self.number("cutoff_angle")), torch.deg2rad(self.number("beam_width"))
        angle = torch.acos(d[:, 2])
        fall = torch.where(angle > beam, (cutoff - angle) / (cutoff - beam), 1.0)
        uv = 0.5 + 0.5 * d[:, :2] / (d[:, 2:] * torch.tan(cutoff))
        value = self.color("intensity", len(d)) * self.image("texture", uv) * fall[:, None]
        return value, angle < cutoff


class Projector(Oriented):
    def pattern(self, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        texture = self.world.records["texture"][self.record.field["irradiance"]]
        aspect = 1.0
        if texture.type == "bitmap":
            height, width = self.world.tensor("texture", texture, "data").shape[:2]
            aspect = width / height
        slope = torch.tan(torch.deg2rad(self.number("x_fov")) / 2)
        front = d[:, 2] > 0
        z = torch.where(front, d[:, 2], 1.0)
        a, b = d[:, 0] / (z * slope), d[:, 1] / (z * slope / aspect)
        value = self.image("irradiance", torch.stack([0.5 - a / 2, 0.5 - b / 2], 1)) * self.number("scale") * math.pi
        return value / (z**3)[:, None], front & (a.abs() < 1) & (b.abs() < 1)


EMITTERS = {
    "area": Area,
    "constant": Constant,
    "envmap": EnvironmentMap,
    "point": Point,
    "directional": Directional,
    "spot": Spot,
    "projector": Projector,
}


class Lights:
    """All emitters of a scene, chosen by their sampling weights."""

    def __init__(self, world: World) -> None:
        records = world.records["emitter"]
        self.all = [EMITTERS[r.type](world, i) for i, r in enumerate(records)]
        self.environment = next((e for e in self.all if e.environment), None)
        if self.all:
            weights = torch.stack([world.tensor("emitter", r, "sampling_weight").detach() for r in records])
            self.pmf, self.cdf = weights / torch.cumsum(weights, 0)[-1], numbers.cumulative(weights)

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
        return Light.cat(pieces)[torch.argsort(torch.cat(order))]
