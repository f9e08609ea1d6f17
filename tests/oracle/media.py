"""Media: what they are at points, exact optical depths, and a volumetric tracer that takes no short cuts.

Other than the surface path tracer here, `Tracer` shares no random numbers with the native renderer: it is a plain
simulation of one channel at a time, whose expectation is that of the native image. Photons fly until delta tracking
says that they collide, turn into directions that are uniform on the sphere and are weighted by the phase function;
light is found by running into it, that of point lights through exact transmittances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from torchrender.surface import dot
from torchrender.wavefront import layers, volumes
from torchrender.wavefront.emitters import Lights, Point
from torchrender.wavefront.geometry import Frame, Rows
from torchrender.wavefront.path import offset_origin
from torchrender.wavefront.world import At

from . import phases
from .bsdf import MODELS
from .world import World

NOTHING = -1  # the medium where there is none
CROSSINGS = 32  # surfaces that a straight line passes, at most


class Medium:
    """A medium of a scene. Values are (N, C) at points (N, 3)."""

    def __init__(self, world: World, index: int) -> None:
        self.world, self.record = world, world.records["medium"][index]
        volume = self.record.field["sigma_t"]
        self.grid = world.records["volume"][volume] if volume >= 0 else None
        if self.grid is not None and self.grid.type != "gridvolume":
            self.grid = None
        self.scale = world.tensor("medium", self.record, "scale")
        self.phase = self.record.field["phase"]

    def _value(self, name: str, default: float, p: torch.Tensor) -> torch.Tensor:
        index = self.record.field[name]
        if index >= 0:
            return volumes.evaluate(self.world, index, p)
        return torch.full((len(p), self.world.channels), default, dtype=p.dtype)

    def extinction(self, p: torch.Tensor) -> torch.Tensor:
        return self.inside(p, self._value("sigma_t", 1.0, p) * self.scale)

    def inside(self, p: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
        """The value where the medium is: one with a grid ends where the unit cube of its extinction ends."""
        if self.grid is None:
            return value
        q = volumes.to_grid(self.world, self.grid, p)
        return torch.where(((q >= 0) & (q <= 1)).all(1, keepdim=True), value, 0.0)

    def albedo(self, p: torch.Tensor) -> torch.Tensor:
        return self._value("albedo", 0.75, p)

    def emission(self, p: torch.Tensor) -> torch.Tensor:
        return self.inside(p, self._value("emission", 0.0, p))

    def majorant(self) -> torch.Tensor:
        """(C,)"""
        if self.grid is None:
            return self.extinction(torch.zeros(1, 3, dtype=torch.float64))[0].detach()
        voxels = self.world.tensor("volume", self.grid, "data").detach()
        return (voxels.amax((0, 1, 2)) * self.scale.detach()).expand(self.world.channels)

    def optical_depth(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """Integral of the extinction between points a and b (N, 3): (N, C), exact.

        Along a line a trilinear grid is a cubic between planes through the centres of voxels, a nearest one is constant
        between their faces, so that two points of Gauss in each piece suffice.
        """
        length = torch.linalg.vector_norm(b - a, dim=1, keepdim=True)
        if self.grid is None:
            return self.extinction(a) * length
        t, weight = self.nodes(a, b)
        points = a[:, None] + (b - a)[:, None] * t[..., None]
        sigma = self.extinction(points.reshape(-1, 3)).reshape(*t.shape, -1)
        return (sigma * weight[..., None]).sum(1) * length

    def nodes(self, a: torch.Tensor, b: torch.Tensor, count: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
        """Gauss's nodes in [0, 1] and their weights, (N, K), in each piece of the ways from a to b."""
        cuts = [torch.zeros_like(a[:, :1]), torch.ones_like(a[:, :1])]
        if self.grid is not None:
            cuts += self.planes(a, b)
        t = torch.cat(cuts, 1).sort(1).values.detach()
        x, w = (torch.from_numpy(v) for v in np.polynomial.legendre.leggauss(count))
        width = t.diff(dim=1)[..., None]
        at = 0.5 * (t[:, 1:] + t[:, :-1])[..., None] + 0.5 * width * x
        return at.flatten(1), (0.5 * width * w).flatten(1)

    def planes(self, a: torch.Tensor, b: torch.Tensor) -> list[torch.Tensor]:
        """Where between a and b, in [0, 1], the extinction may have a kink."""
        data = self.world.tensor("volume", self.grid, "data")
        start, end = (volumes.to_grid(self.world, self.grid, x) for x in (a, b))
        cuts = []
        for axis, n in enumerate((data.shape[2], data.shape[1], data.shape[0])):
            i = torch.arange(n, dtype=a.dtype)
            planes = torch.cat([i / n, (i + 0.5) / n, torch.ones(1, dtype=a.dtype)])
            way = (end - start)[:, axis : axis + 1]
            t = (planes - start[:, axis : axis + 1]) / torch.where(way == 0, 1.0, way)
            cuts.append(torch.where(way == 0, 0.0, t).clamp(0.0, 1.0))
        return cuts


MEDIA = {"homogeneous": Medium, "heterogeneous": Medium}


class Media:
    """All media of a scene, and which of them lies behind a surface."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.all = [MEDIA[record.type](world, i) for i, record in enumerate(world.records.get("medium", []))]
        self.interior, self.exterior = world.shape_field("interior"), world.shape_field("exterior")
        self.bsdf = world.shape_field("bsdf")
        self.is_null = torch.tensor([r.type == "null" for r in world.records["bsdf"]])

    def beyond(self, shape: torch.Tensor, normal: torch.Tensor, d: torch.Tensor, medium: torch.Tensor) -> torch.Tensor:
        """Media (N,) of rays that leave surfaces in directions d."""
        inside, outside = self.interior[shape], self.exterior[shape]
        changes = (inside >= 0) | (outside >= 0)
        return torch.where(changes, torch.where(dot(normal, d) > 0, outside, inside), medium)

    def between(self, p: torch.Tensor, q: torch.Tensor, medium: torch.Tensor) -> torch.Tensor:
        """Transmittance (N, C) from points p, in the media given by number, to points q."""
        d = torch.nn.functional.normalize(q - p, dim=1)
        length = torch.linalg.vector_norm(q - p, dim=1)
        depth = torch.zeros(len(p), self.world.channels, dtype=p.dtype)
        open_, o, going = torch.ones(len(p), dtype=torch.bool), p, torch.ones(len(p), dtype=torch.bool)
        for _ in range(CROSSINGS):
            left = (length - dot(o - p, d)).clamp(min=0.0) * (1 - 1e-9)
            hits = self.world.intersect(o, d, left)
            step = torch.where(hits.valid, hits.t, left)
            end = o + d * step[:, None]
            for index, some in enumerate(self.all):
                rows = (going & (medium == index)).nonzero()[:, 0]
                if len(rows):
                    depth = depth.index_add(0, rows, some.optical_depth(o[rows], end[rows]))
            going = going & hits.valid
            shape = hits.shape_id.long().clamp(min=0)
            open_ = open_ & ~(going & ~self.is_null[self.bsdf[shape]])
            medium = torch.where(going, self.beyond(shape, hits.normal, d, medium), medium)
            o = torch.where(going[:, None], offset_origin(end, hits.normal, d), o)
            if not bool(going.any()):
                return torch.exp(-depth) * open_[:, None]
        raise AssertionError(f"more than {CROSSINGS} surfaces along a line")


@dataclass
class Photons(Rows):
    """Paths of one channel each: sample, channel, ray, medium, weight, and scatterings so far."""

    lane: torch.Tensor
    channel: torch.Tensor
    o: torch.Tensor
    d: torch.Tensor
    length: torch.Tensor
    medium: torch.Tensor
    weight: torch.Tensor
    depth: torch.Tensor

    def of(self, values: torch.Tensor) -> torch.Tensor:
        """The channel's column of (N, C)."""
        return values.gather(1, self.channel[:, None])[:, 0]


class Tracer:
    """One simulation: `trace` starts it."""

    def __init__(self, world: World, max_depth: int, seed: int) -> None:
        self.world, self.media, self.lights = world, Media(world), Lights(world)
        self.points = [light for light in self.lights.all if isinstance(light, Point)]
        self.emitter = world.shape_field("emitter")
        self.max_depth = max_depth if max_depth >= 0 else 1 << 30
        self.generator = torch.Generator().manual_seed(seed)

    def uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=self.generator, dtype=torch.float64)

    def trace(self, o: torch.Tensor, d: torch.Tensor, medium: int, length: torch.Tensor | None = None) -> torch.Tensor:
        """Estimates of radiance (N, C) along rays that start in a medium."""
        n, c = len(o), self.world.channels
        self.radiance = torch.zeros(n * c, dtype=torch.float64)
        length = torch.full((n,), math.inf, dtype=torch.float64) if length is None else length
        photons = Photons(
            torch.arange(n * c),
            torch.arange(c).repeat(n),
            o.detach().repeat_interleave(c, 0),
            d.detach().repeat_interleave(c, 0),
            length.detach().repeat_interleave(c),
            torch.full((n * c,), medium),
            torch.ones(n * c, dtype=torch.float64),
            torch.zeros(n * c, dtype=torch.int64),
        )
        while len(photons):
            photons = self.step(photons)
        return self.radiance.reshape(n, c)

    def add(self, photons: Photons, value: torch.Tensor) -> None:
        self.radiance.index_add_(0, photons.lane, photons.weight * value)

    def step(self, photons: Photons) -> Photons:
        """A flight, and what happens at its end."""
        hits = self.world.intersect(photons.o, photons.d, photons.length)
        end = torch.where(hits.valid, hits.t, math.inf)
        flight = torch.minimum(self.collision(photons, end), end)
        self.glow(photons, flight)
        collides = flight < end
        lost = ~collides & ~hits.valid
        escaped = photons[lost]
        if self.lights.environment is not None:
            self.add(escaped, escaped.of(self.lights.environment.escaped(escaped.d)))
        scattered = photons[collides]
        scattered.o = scattered.o + scattered.d * flight[collides][:, None]
        arrives = ~collides & hits.valid
        rows = arrives.nonzero()[:, 0]
        at = At(*(getattr(hits, n)[rows].detach() for n in ("shape_id", "prim_id", "barycentric", "uv")))
        at.shape, at.primitive = at.shape.long(), at.primitive.long()
        found = {n: getattr(hits, n)[rows].detach() for n in ("position", "normal", "shading_normal")}
        return Photons.cat([self.scatter(scattered), self.surface(photons[arrives], at, **found)])

    def collision(self, photons: Photons, end: torch.Tensor) -> torch.Tensor:
        """Distances at which photons collide, infinite for those that would fly beyond `end`."""
        found = torch.full_like(end, math.inf)
        for index, medium in enumerate(self.media.all):
            majorant = photons.of(medium.majorant().expand(len(end), -1))
            rows = ((photons.medium == index) & (majorant > 0)).nonzero()[:, 0]
            t = torch.zeros(len(rows), dtype=torch.float64)
            while len(rows):
                t = t - torch.log1p(-self.uniform(len(rows))) / majorant[rows]
                inside = t < end[rows]
                rows, t = rows[inside], t[inside]
                some = photons[rows]
                sigma = some.of(medium.extinction(some.o + some.d * t[:, None])).detach()
                assert bool((sigma <= majorant[rows] * (1 + 1e-12)).all())
                real = self.uniform(len(rows)) * majorant[rows] < sigma
                found[rows[real]] = t[real]
                rows, t = rows[~real], t[~real]
        return found

    def glow(self, photons: Photons, flight: torch.Tensor) -> None:
        """What media emit on the way: as often as a point is reached, it is among those of a flight."""
        for index, medium in enumerate(self.media.all):
            if medium.record.field["emission"] >= 0:
                rows = (photons.medium == index).nonzero()[:, 0]
                some, length = photons[rows], flight[rows]
                p = some.o + some.d * (length * self.uniform(len(rows)))[:, None]
                self.add(some, some.of(medium.emission(p)) * length)

    def live(self, photons: Photons) -> Photons:
        """Those that may go on; of those of little weight few, with more."""
        photons = photons[(photons.depth < self.max_depth) & (photons.weight > 0)]
        keep = (photons.weight * 5).clamp(max=1.0)
        photons.weight = photons.weight / keep
        return photons[self.uniform(len(photons)) < keep]

    def illuminate(self, photons: Photons, response, medium: torch.Tensor) -> None:
        """Point lights; `response` (N,) to directions of light, from points just before them."""
        for light in self.points:
            sample = light.sample(photons.o, self.uniform(len(photons), 4))
            target = photons.o + sample.direction * sample.distance[:, None]
            seen = self.media.between(photons.o, target, medium(sample.direction))
            self.add(photons, response(sample.direction) * photons.of(sample.value * seen))

    def scatter(self, photons: Photons) -> Photons:
        photons.length = torch.full_like(photons.weight, math.inf)
        weight = photons.weight.clone()
        for index, medium in enumerate(self.media.all):
            rows = (photons.medium == index).nonzero()[:, 0]
            some = photons[rows]
            weight[rows] = some.weight * some.of(medium.albedo(some.o)).detach()
        photons.weight, photons.depth = weight, photons.depth + 1
        photons = self.live(photons)

        def phase(d: torch.Tensor) -> torch.Tensor:
            value = torch.zeros(len(photons), dtype=torch.float64)
            for index, medium in enumerate(self.media.all):
                rows = (photons.medium == index).nonzero()[:, 0]
                at, before, after = photons.o[rows], photons.d[rows], d[rows]
                value[rows] = phases.evaluate(self.world, medium.phase, at, before, after).detach()
            return value

        self.illuminate(photons, phase, lambda d: photons.medium)
        z, phi = 2 * self.uniform(len(photons)) - 1, 2 * math.pi * self.uniform(len(photons))
        r = torch.sqrt(1 - z * z)
        d = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1)
        photons.weight, photons.d = photons.weight * phase(d) * 4 * math.pi, d
        return photons

    def surface(self, photons: Photons, at: At, position, normal, shading_normal) -> Photons:
        pieces = [photons[:0]]
        frame = Frame.about(shading_normal)
        wi = frame.to_local(-photons.d)
        for light in self.lights.all:
            rows = ((self.emitter[at.shape] == light.index) & (wi[:, 2] > 0)).nonzero()[:, 0]
            if len(rows):
                self.add(photons[rows], photons[rows].of(light.radiance(at[rows])).detach())
        u, needs_grad = (
            torch.zeros(len(at), dtype=torch.float64),
            torch.zeros(len(self.media.is_null), dtype=torch.bool),
        )
        held = (self.media.bsdf[at.shape], at, position, shading_normal, photons.d, u)
        found = layers.resolve(self.world, *held, viewed=True, needs_grad=needs_grad)
        leaf, sign = found.resolved, torch.where(found.mirrored, -1.0, 1.0).to(wi)
        flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], 1)
        for number in leaf.unique().tolist():
            rows = (leaf == number).nonzero()[:, 0]
            record = self.world.records["bsdf"][number]
            some, here = photons[rows], at[rows]
            n, side = normal[rows], flip[rows]
            local, axes, p = wi[rows] * side, frame[rows], position[rows]
            bsdf = MODELS[record.type](self.world, record, here)
            if record.type != "null":
                some.depth = some.depth + 1

            if bsdf.smooth and self.points:
                alive = (some.depth < self.max_depth).double()
                some.o = offset_origin(p, n, -some.d)

                def response(d: torch.Tensor, bsdf=bsdf, local=local, axes=axes, side=side, some=some, alive=alive):
                    return some.of(bsdf.eval(local, axes.to_local(d) * side, torch.zeros_like(some.lane))) * alive

                def medium(d: torch.Tensor, here=here, n=n, some=some):
                    return self.media.beyond(here.shape, n, d, some.medium)

                self.illuminate(some, response, medium)
            sample = bsdf.sample(local, self.uniform(len(rows), 4))
            weight = some.of(bsdf.eval(local, sample.wo, sample.lobe)) / torch.where(sample.pdf > 0, sample.pdf, 1.0)
            some.weight = some.weight * torch.where(sample.pdf > 0, weight, 0.0).detach()
            some.d = torch.nn.functional.normalize(axes.to_world(sample.wo * side), dim=1).detach()
            some.o = offset_origin(p, n, some.d)
            some.medium = self.media.beyond(here.shape, n, some.d, some.medium)
            some.length = torch.full_like(some.weight, math.inf)
            pieces.append(self.live(some))
        return Photons.cat(pieces)
