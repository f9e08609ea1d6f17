"""The path tracer: csrc/core/integrator/surface.h and csrc/cpu/path_tile.h, N paths a segment at a time.

What is attached where things move (`World.moving`). The first point is the attached intersection of the attached camera
ray: it slides over the surface when that or the camera moves. The point that a ray sampled at a smooth vertex hits on a
shape that emits, or that is sampled on a light, is glued to its surface, and the measure is area: the direction is that
from the one moving point to the other, and the weight gets the ratio J / J' of solid angles. On other shapes it is
attached to the ray, whose direction is at rest. The ray after a delta lobe is an attached function of the one before,
and so is the point that it hits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch

from ..queries import Hits
from ..scene.camera import Rays
from ..scene.torch_bsdf import SurfaceInteraction
from ..surface import OFFSET, dot, normalize
from . import layers, numbers
from .bsdf import Bsdf
from .bsdfs import BSDFS
from .emitters import Area, Lights
from .geometry import Frame, Rows, glue, reattach
from .layers import BsdfStack
from .world import At, World

GLUED = ("position", "normal", "shading_normal", "uv")
# How far before a light rays end, in parts of their length.
SHADOW_EPSILON = 8.9406967e-4
LEAST_SURVIVAL, MOST_SURVIVAL = 0.05, 0.95
FAR = 1e30


@dataclass
class Paths(Rows):
    """Paths that have arrived somewhere, or left the scene.

    `lane` (N,) says which sample; `d` (N, 3) the direction of arrival; `beta` (N, C) the throughput; `survival` (N, C)
    what Russian roulette judges by; `eta` (N,) the index of refraction relative to the camera's side; `previous`,
    `previous_pdf` where the ray came from and the density of its direction, 0 after delta lobes and for camera rays;
    `seen` whether alpha is decided; then the hit.
    """

    lane: torch.Tensor
    d: torch.Tensor
    beta: torch.Tensor
    survival: torch.Tensor
    eta: torch.Tensor
    previous: torch.Tensor
    previous_pdf: torch.Tensor
    seen: torch.Tensor
    valid: torch.Tensor
    shape: torch.Tensor
    primitive: torch.Tensor
    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    barycentric: torch.Tensor
    uv: torch.Tensor

    @property
    def at(self) -> At:
        return At(self.shape, self.primitive, self.barycentric, self.uv)


def arrival(hits: Hits) -> dict[str, torch.Tensor]:
    """The members of `Paths` that say what a ray has hit."""
    names = ("valid", "position", "normal", "shading_normal", "uv", "barycentric")
    return {**{n: getattr(hits, n) for n in names}, "shape": hits.shape_id, "primitive": hits.prim_id}


def power_heuristic(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Weight (N,) of samples of density a that could have been taken with density b."""
    usable = a * a > 0
    return torch.where(usable, a * a / torch.where(usable, a * a + b * b, 1.0), 0.0)


def offset_origin(p: torch.Tensor, n: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
    """Origins (N, 3) moved off a surface to the side of d."""
    amount = (1 + p.abs().amax(1)) * OFFSET
    return p + n * torch.where(dot(n, d) < 0, -amount, amount)[:, None]


@dataclass
class Vertices(Rows):
    """Paths at surfaces that scatter them, with the layers `above` their BSDFs.

    `frame` is the frame in which a BSDF sees directions, mirrored where `sign` (N,) is -1; `wi` (N, 3) is where the
    path comes from.
    """

    paths: Paths
    above: BsdfStack
    frame: Frame
    sign: torch.Tensor
    wi: torch.Tensor

    @classmethod
    def of(cls, world: World, paths: Paths, above: BsdfStack) -> Vertices:
        frame = layers.frames(world, above, paths.at, paths.position)
        sign = torch.where(above.mirrored, -1.0, 1.0).to(paths.d)
        return cls(paths, above, frame, sign, mirror(frame.to_local(-paths.d), sign))

    def to_local(self, v: torch.Tensor) -> torch.Tensor:
        return mirror(self.frame.to_local(v), self.sign)

    def to_world(self, v: torch.Tensor) -> torch.Tensor:
        return self.frame.to_world(mirror(v, self.sign))

    def sees(self, w: torch.Tensor) -> torch.Tensor:
        """Where light from w (N, 3) gets past turned normals on its way to where the paths come from."""
        return ~self.above.hides(-self.paths.d) & ~self.above.hides(w)

    @property
    def interaction(self) -> SurfaceInteraction:
        p = self.paths
        return SurfaceInteraction(p.position, p.normal, self.above.normal, p.uv, p.barycentric, p.shape, p.primitive)


def mirror(v: torch.Tensor, sign: torch.Tensor) -> torch.Tensor:
    """Local directions with z times the sign (N,)."""
    return torch.stack([v[:, 0], v[:, 1], v[:, 2] * sign], 1)


class WavefrontTracer:
    """Traces the paths of one sensor.

    Args:
        world: the scene.
        config: ``max_depth``, ``rr_depth``, ``hide_emitters``; how many ``emitter_samples`` and ``bsdf_samples`` are
            drawn at the first vertex.
        random: the random numbers.
        derivative: paths are those of a derivative: at BSDFs that need a gradient Russian roulette judges by a
            throughput that never vanishes, and every layer is met.
    """

    # The shape of what light has of each colour: a number here, four in the oracle of polarised light.
    components: ClassVar[tuple[int, ...]] = ()

    def __init__(self, world: World, config: Mapping[str, Any], random: numbers.Numbers, derivative: bool) -> None:
        self.world, self.lights, self.random = world, Lights(world), random
        self.max_depth, self.rr_depth = config["max_depth"], config["rr_depth"]
        self.hide_emitters = config["hide_emitters"]
        self.emitter_samples, self.bsdf_samples = config["emitter_samples"], config["bsdf_samples"]
        self.shape_bsdf, self.shape_emitter = world.shape_field("bsdf"), world.shape_field("emitter")
        kinds = [r.type for r in world.records["bsdf"]]
        self.is_null = torch.tensor([k in ("null", "mask") for k in kinds], dtype=torch.bool)
        needs_grad = [derivative and world.needs_grad("bsdf", i) for i in range(len(kinds))]
        self.needs_grad = torch.tensor(needs_grad, dtype=torch.bool)
        self.chooses = any(k in layers.CHOICES for k in kinds)

    # ----------------------------------------------------------------------------------------------------- whole paths
    def trace(self, rays: Rays, pixel: torch.Tensor, sample: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance (N, C) and alpha (N,) along camera rays, of samples of pixels as `numbers.pixel_key` has them."""
        n, channels, dtype = len(pixel), self.world.channels, self.world.dtype
        self.pixel, self.sample = pixel, sample
        self.found: list[tuple[torch.Tensor, torch.Tensor]] = []
        self.alpha = torch.zeros(n, dtype=dtype)
        if self.max_depth != 0:
            first = self.first_points(rays)
            scatters = self.max_depth < 0 or self.max_depth > 1
            for index in range(max(self.emitter_samples, self.bsdf_samples) if scatters else 1):
                paths, depth = first, 0
                while len(paths) and (self.max_depth < 0 or depth < self.max_depth):
                    more = self.max_depth < 0 or depth + 1 < self.max_depth
                    paths = self.vertex(paths, depth, index if depth == 0 else 0, more)
                    depth += 1
        radiance = torch.zeros(n, channels, *self.components, dtype=dtype)
        for lane, value in self.found:
            radiance = radiance.index_add(0, lane, value)
        return radiance, self.alpha

    def first_points(self, rays: Rays) -> Paths:
        """Paths that begin with camera rays, one for each sample."""
        n, dtype = len(rays.origins), self.world.dtype
        one, zero = torch.ones(n, self.world.channels, dtype=dtype), torch.zeros(n, dtype=dtype)
        return Paths(
            lane=torch.arange(n),
            d=rays.directions,
            beta=one,
            survival=one,
            eta=one[:, 0],
            previous=rays.origins.detach(),
            previous_pdf=zero,
            seen=zero.bool(),
            **arrival(self.world.first_hits(rays, self.hide_emitters)),
        )

    def add(self, paths: Paths, beta: torch.Tensor, radiance: torch.Tensor) -> None:
        """Light (N, C) that paths have found behind the throughput beta; of one call no sample comes twice."""
        if len(paths):
            self.found.append((paths.lane, self.arriving(beta, radiance)))

    def arriving(self, beta: torch.Tensor, radiance: torch.Tensor) -> torch.Tensor:
        """What the throughput beta lets through of emitted light (N, C)."""
        return beta * radiance

    def throughput(
        self, number: int, vertices: Vertices, d: torch.Tensor, lobe: torch.Tensor, value: torch.Tensor
    ) -> torch.Tensor:
        """That of paths which go on along d (N, 3), in the world, with this value (N, C) of their BSDF."""
        return vertices.paths.beta * value

    # -------------------------------------------------------------------------------------------------------- vertices
    def vertex(self, paths: Paths, depth: int, index: int, scatters: bool) -> Paths:
        """What paths find where they are, and where they go on to. `index` counts the samples of the first vertex."""
        if index == 0 and not (self.hide_emitters and depth == 0):
            self.escape(paths[~paths.valid], depth)
        paths = paths.take(paths.valid.nonzero()[:, 0])
        if not scatters and depth > 0:  # the end: what does not emit is not looked at
            paths = paths[self.shape_emitter[paths.shape] >= 0]
        if not len(paths):
            return paths
        if index == 0:
            self.emission(paths, dot(paths.shading_normal, paths.d) < 0, depth)
        ue, ub = self.draw(paths, depth + index, scatters)
        above = layers.resolve(
            self.world,
            self.shape_bsdf[paths.shape],
            paths.at,
            paths.position,
            paths.shading_normal,
            paths.d,
            ub[:, 3],
            viewed=True,
            needs_grad=self.needs_grad,
        )
        real = ~self.is_null[above.resolved]
        self.alpha[paths.lane[~paths.seen & real]] = 1.0
        paths = replace(paths, seen=paths.seen | real)
        if not scatters:
            return paths[:0]
        vertices = Vertices.of(self.world, paths, above)
        pieces = [paths[:0]]
        for number in above.resolved.unique().tolist():
            rows = (above.resolved == number).nonzero()[:, 0]
            pieces += self.scatter(vertices.take(rows), ue[rows], ub[rows], number, depth, index)
        return Paths.cat([p for p in pieces if len(p)] or pieces[:1])

    def draw(self, paths: Paths, scattering: int, scatters: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """The random numbers (N, 4) of emitter and BSDF sampling, the last of which chooses layers."""
        if not scatters and not self.chooses:
            nothing = paths.d.new_zeros(len(paths), 4)
            return nothing, nothing
        pixel, sample = self.pixel[paths.lane], self.sample[paths.lane]
        block = numbers.BLOCKS_PER_SCATTERING * scattering
        ue = self.random.block(pixel, sample, numbers.EMITTER_BLOCK + block)
        return ue, self.random.block(pixel, sample, numbers.BSDF_BLOCK + block)

    def bsdf(self, number: int, vertices: Vertices) -> Bsdf:
        record = self.world.records["bsdf"][number]
        return BSDFS[record.type](self.world, record, vertices.paths.at, vertices.interaction)

    def weight_of_hit(self, paths: Paths, pdf: torch.Tensor, depth: int) -> torch.Tensor:
        """Weight of emission that BSDF sampling found, given the density with which emitter sampling would have."""
        if depth == 1:
            pdf = pdf * (self.emitter_samples / self.bsdf_samples)
        return torch.where(paths.previous_pdf > 0, power_heuristic(paths.previous_pdf, pdf.detach()), 1.0)

    def escape(self, paths: Paths, depth: int) -> None:
        light = self.lights.environment
        if light is None or not len(paths):
            return
        pdf = light.escaped_pdf(paths.d.detach()) * self.lights.pmf[light.index]
        weight = self.weight_of_hit(paths, pdf, depth)[:, None]
        self.add(paths, paths.beta, light.escaped(paths.d) * weight)

    def emission(self, paths: Paths, facing: torch.Tensor, depth: int) -> None:
        for light in self.lights.areas:
            rows = (facing & (self.shape_emitter[paths.shape] == light.index)).nonzero()[:, 0]
            if len(rows):
                lit = paths[rows]
                pdf = light.hit_pdf(lit.previous, lit.position.detach(), lit.normal.detach(), lit.at)
                weight = self.weight_of_hit(lit, pdf * self.lights.pmf[light.index], depth)
                self.add(lit, lit.beta, torch.einsum("n,n...->n...", weight, self.met(light, lit)))

    def met(self, light: Area, paths: Paths) -> torch.Tensor:
        """What a light that paths have met sends along them, (N, C)."""
        return light.radiance(paths.at)

    def scatter(
        self, vertices: Vertices, ue: torch.Tensor, ub: torch.Tensor, number: int, depth: int, index: int
    ) -> list[Paths]:
        """Emitter and BSDF sampling at vertices that share a BSDF; returns the paths that go on."""
        kind = BSDFS[self.world.records["bsdf"][number].type]
        n_emitter, n_bsdf = (self.emitter_samples, self.bsdf_samples) if depth == 0 else (1, 1)
        if kind.smooth and self.lights.all and index < n_emitter:
            self.sample_lights(vertices, number, ue, n_emitter, n_bsdf)

        if index >= n_bsdf or (depth + 2 == self.max_depth and not kind.delta and not self.lights.seen):
            return []  # no ray finds light, and none would be looked for at what it hits
        with torch.set_grad_enabled(torch.is_grad_enabled() and kind.delta):
            s = self.bsdf(number, vertices).sample(vertices.wi, ub)
        pdf = s.pdf.detach()
        # a density that is not a number is kept, to be found in the result
        rows = (~(pdf <= 0) & vertices.sees(vertices.to_world(s.wo))).nonzero()[:, 0]
        if not len(rows):
            return []
        vertices, wo, eta, lobe = vertices.take(rows), s.wo[rows], s.eta[rows].detach(), s.lobe[rows]
        above, paths = vertices.above, vertices.paths
        inverse = above.inverse / (n_bsdf * pdf[rows])
        value = self.bsdf(number, vertices).eval(vertices.wi, wo, lobe)
        passes = above.weight * above.dimmed(vertices.to_world(wo))
        weight = value.detach() * (passes.detach() * inverse)[:, None]
        # a path that an albedo of zero would end goes on where that has a derivative
        needs_grad = (self.needs_grad[number] | above.needs_grad)[:, None]
        weight = torch.where(needs_grad, weight.abs().clamp(min=LEAST_SURVIVAL), weight)
        survival, eta = paths.survival * weight, paths.eta * eta
        largest = survival.abs().amax(1)
        alive, keep = ~(largest <= 0), torch.ones_like(largest)
        if depth + 1 >= self.rr_depth:
            q = (largest * eta * eta).clamp(max=MOST_SURVIVAL)
            alive = alive & ~(ue[rows, 3] >= q)
            keep = torch.where(alive, 1 / torch.where(alive, q, 1.0), 1.0)
        previous_pdf = torch.where(lobe == 0, pdf[rows], 0.0) if kind.smooth else torch.zeros_like(keep)
        went_on = {"survival": survival * keep[:, None], "eta": eta, "previous_pdf": previous_pdf}
        lobes = [(alive, kind.smooth)]
        if kind.smooth and kind.delta:
            lobes = [(alive & (lobe == 0), True), (alive & (lobe != 0), False)]
        pieces = []
        for chosen, smooth in lobes:
            on = chosen.nonzero()[:, 0]
            if len(on):
                local = (wo[on], lobe[on], value[on] * passes[on, None], (inverse * keep)[on])
                pieces.append(self.go_on(number, vertices.take(on), *local, smooth, went_on, on))
        return pieces

    def go_on(
        self,
        number: int,
        vertices: Vertices,
        wo: torch.Tensor,
        lobe: torch.Tensor,
        value: torch.Tensor,
        factor: torch.Tensor,
        smooth: bool,
        went_on: dict[str, torch.Tensor],
        rows: torch.Tensor,
    ) -> Paths:
        """The paths along wo: if the lobe is `smooth` along a fixed direction, or glued to a light; else attached."""
        paths, above = vertices.paths, vertices.above
        d = vertices.to_world(wo)
        d = reattach(normalize(d), d) if self.world.moving else normalize(d.detach())
        position = paths.position.detach()
        o = offset_origin(position, paths.normal.detach(), d.detach())
        if smooth:
            d = d.detach()
        if self.world.moving:
            o = reattach(o, paths.position)
        hits = self.world.intersect(o, d)
        if smooth and self.world.moving:
            hits, ratio, moved, towards = self.glued(hits, paths.position)
            d = d.index_put((moved,), reattach(d[moved], towards))
            # The direction has changed its derivative, and in the last digits its value.
            value = self.bsdf(number, vertices).eval(vertices.wi, vertices.to_local(d), lobe)
            value = value * (above.weight * above.dimmed(d) * ratio)[:, None]
        return Paths(
            lane=paths.lane,
            d=d,
            beta=self.throughput(number, vertices, d, lobe, value * factor[:, None]),
            previous=position,
            seen=paths.seen,
            **{name: column[rows] for name, column in went_on.items()},
            **arrival(hits),
        )

    def glued(self, hits: Hits, x: torch.Tensor) -> tuple[Hits, torch.Tensor, torch.Tensor, torch.Tensor]:
        """The hits, those on what emits glued to it; J / J'; their rows, and their directions from the points x."""
        glued = hits.valid & (self.shape_emitter[hits.shape_id.clamp_min(0)] >= 0)
        slides = hits.valid & ~glued
        rows = glued.nonzero()[:, 0]
        shape, primitive = hits.shape_id[rows], hits.prim_id[rows]
        at = glue(self.world.surfaces, shape, primitive, hits.barycentric[rows], hits.position[rows], hits.uv[rows])

        def put(old: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
            return kept(old).index_put((rows,), reattach(old[rows], new))

        def kept(old: torch.Tensor) -> torch.Tensor:
            return torch.where(slides.reshape(-1, *[1] * (old.ndim - 1)), old, old.detach())

        moved: dict[str, torch.Tensor] = {name: put(getattr(hits, name), getattr(at, name)) for name in GLUED}
        hits = hits._replace(**moved, t=kept(hits.t), barycentric=kept(hits.barycentric))
        ratio = torch.ones_like(hits.t).index_put((rows,), at.solid_angle(x[rows]))
        return hits, ratio, rows, normalize(at.position - x[rows])

    def sample_lights(self, vertices: Vertices, number: int, u: torch.Tensor, n_emitter: int, n_bsdf: int) -> None:
        """Light from a point on an emitter, where nothing is in between."""
        light = self.lights.sample(vertices.paths.position, u)
        with torch.no_grad():
            pdf = self.bsdf(number, vertices).pdf(vertices.wi, vertices.to_local(light.direction))
        possible = (light.pdf > 0) & ~(pdf <= 0) & vertices.sees(light.direction)
        mis = torch.where(light.delta, 1.0, power_heuristic(n_emitter * light.pdf, n_bsdf * pdf))
        mis = torch.where(torch.isnan(pdf), pdf, mis)
        factor = torch.where(possible, mis / torch.where(possible, n_emitter * light.pdf, 1.0), 0.0)

        rows = possible.nonzero()[:, 0]
        p, n, d = (x[rows].detach() for x in (vertices.paths.position, vertices.paths.normal, light.direction))
        distance = light.distance[rows]
        o = offset_origin(p, n, d)
        near = distance < FAR
        towards = p + d * torch.where(near, distance, 1.0)[:, None] - o
        length = torch.linalg.vector_norm(towards, dim=1)
        direction = torch.where(near[:, None], towards / length[:, None], d)
        limit = torch.where(near, length * (1 - SHADOW_EPSILON), math.inf)
        rows = rows[~self.world.occluded(o, direction, limit)]
        if not len(rows):
            return
        lit, above = vertices.take(rows), vertices.above.take(rows)
        d, lobe = light.direction[rows], torch.zeros_like(lit.paths.lane)
        value = self.bsdf(number, lit).eval(lit.wi, lit.to_local(d), lobe)
        factor = factor[rows] * above.inverse * above.weight * above.dimmed(d)
        self.add(lit.paths, self.throughput(number, lit, d, lobe, value * factor[:, None]), light.value[rows])
