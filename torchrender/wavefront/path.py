"""The path tracer: csrc/core/integrator/path.h and csrc/cpu/path_tile.h, N paths a segment at a time.

What is attached where things move (`World.moving`). The first point is the attached intersection of the attached camera
ray: it slides over the surface when that or the camera moves. The point that a ray sampled at a smooth vertex hits, or
that is sampled on a light, is glued to its surface, and the measure is area: the direction is that from the one moving
point to the other, and the weight gets the ratio J / J' of solid angles. The ray after a delta lobe is an attached
function of the one before, and so is the point that it hits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch

from ..queries import Hits
from ..scene.camera import Rays
from ..scene.torch_bsdf import SurfaceInteraction
from ..surface import dot, normalize
from . import numbers
from .bsdfs import BSDFS, Bsdf, resolve
from .emitters import Lights
from .geometry import Frame, Rows, glue, reattach
from .world import At, World

GLUED = ("position", "normal", "shading_normal", "uv")
# How far off a surface rays start, and how far before a light they end, in parts of coordinates and length.
OFFSET, SHADOW_EPSILON = 8.9406967e-5, 8.9406967e-4
LEAST_SURVIVAL, MOST_SURVIVAL = 0.05, 0.95
FAR = 1e30


@dataclass
class Paths(Rows):
    """Paths that have arrived somewhere, or left the scene.

    `lane` (N,) says which sample; `d` (N, 3) the direction of arrival; `beta` (N, C) the throughput; `survival` (N, C)
    what Russian roulette judges by; `eta` (N,) the index of refraction relative to the camera's side; `origin`,
    `origin_pdf` where the ray came from and the density of its direction, 0 after delta lobes and for camera rays;
    `seen` whether alpha is decided; then the hit.
    """

    lane: torch.Tensor
    d: torch.Tensor
    beta: torch.Tensor
    survival: torch.Tensor
    eta: torch.Tensor
    origin: torch.Tensor
    origin_pdf: torch.Tensor
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

    @property
    def interaction(self) -> SurfaceInteraction:
        geometry = (self.position, self.normal, self.shading_normal)
        return SurfaceInteraction(*geometry, self.uv, self.barycentric, self.shape, self.primitive)


def arrival(hits: Hits) -> dict[str, torch.Tensor]:
    names = ("valid", "position", "normal", "shading_normal", "uv", "barycentric")
    return {**{n: getattr(hits, n) for n in names}, "shape": hits.shape_id, "primitive": hits.prim_id}


def power_heuristic(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    usable = a * a > 0
    return torch.where(usable, a * a / torch.where(usable, a * a + b * b, 1.0), 0.0)


def offset_origin(p: torch.Tensor, n: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
    """Origins (N, 3) moved off a surface to the side of d."""
    amount = (1 + p.abs().amax(1)) * OFFSET
    return p + n * torch.where(dot(n, d) < 0, -amount, amount)[:, None]


def mirror(v: torch.Tensor, sign: torch.Tensor) -> torch.Tensor:
    """Local directions with z times the sign (N,)."""
    return torch.stack([v[:, 0], v[:, 1], v[:, 2] * sign], 1)


class WavefrontTracer:
    """Traces the paths of one sensor.

    Args:
        world: the scene.
        config: ``max_depth``, ``rr_depth``, ``hide_emitters``.
        random: the random numbers.
        derivative: paths are those of a derivative with respect to BSDFs: Russian roulette judges by a throughput that
            never vanishes.
    """

    def __init__(self, world: World, config: Mapping[str, Any], random: numbers.Numbers, derivative: bool) -> None:
        self.world, self.lights, self.random = world, Lights(world), random
        self.max_depth, self.rr_depth = config["max_depth"], config["rr_depth"]
        self.hide_emitters, self.derivative = config["hide_emitters"], derivative
        self.shape_bsdf, self.shape_emitter = world.shape_field("bsdf"), world.shape_field("emitter")
        self.is_null = torch.tensor([r.type == "null" for r in world.records["bsdf"]], dtype=torch.bool)

    # ----------------------------------------------------------------------------------------------------- whole paths
    def trace(self, rays: Rays, pixel: torch.Tensor, sample: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance (N, C) and alpha (N,) along camera rays, of samples of pixels as `numbers.pixel_key` has them."""
        n, channels, dtype = len(pixel), self.world.channels, self.world.dtype
        self.pixel, self.sample = pixel, sample
        self.found: list[tuple[torch.Tensor, torch.Tensor]] = []
        self.alpha = torch.zeros(n, dtype=dtype)
        if self.max_depth != 0:
            one, zero = torch.ones(n, channels, dtype=dtype), torch.zeros(n, dtype=dtype)
            paths = Paths(
                lane=torch.arange(n),
                d=rays.directions,
                beta=one,
                survival=one,
                eta=one[:, 0],
                origin=rays.origins.detach(),
                origin_pdf=zero,
                seen=zero.bool(),
                **arrival(self.first_hits(rays)),
            )
            depth = 0
            while len(paths) and (self.max_depth < 0 or depth < self.max_depth):
                paths = self.vertex(paths, depth, self.max_depth < 0 or depth + 1 < self.max_depth)
                depth += 1
        radiance = torch.zeros(n, channels, dtype=dtype)
        for lane, value in self.found:
            radiance = radiance.index_add(0, lane, value)
        return radiance, self.alpha

    def first_hits(self, rays: Rays) -> Hits:
        o, d, length = rays
        hits = self.world.intersect(o, d, length)
        while self.hide_emitters:  # the camera looks through shapes that emit
            lit = hits.valid & (self.shape_emitter[hits.shape_id] >= 0)
            if not bool(lit.any()):
                break
            behind = o + d * torch.where(lit, hits.t.detach(), 0.0)[:, None]
            step = torch.where(lit, (1 + behind.detach().abs().amax(1)) * OFFSET, 0.0)
            o = behind + d * step[:, None]
            length = length - torch.where(lit, hits.t.detach() + step, 0.0)
            hits = self.world.intersect(o, d, length)
        return hits

    def add(self, lane: torch.Tensor, value: torch.Tensor) -> None:
        """Light that the samples `lane` have found; of one call none comes twice."""
        if len(lane):
            self.found.append((lane, value))

    # -------------------------------------------------------------------------------------------------------- vertices
    def vertex(self, paths: Paths, depth: int, scatters: bool) -> Paths:
        """What paths find where they are, and where they go on to."""
        if self.lights.environment is not None and not (self.hide_emitters and depth == 0):
            self.escape(paths[~paths.valid])
        paths = paths.take(paths.valid.nonzero()[:, 0])
        if not scatters and depth > 0:  # the end: what does not emit is not looked at
            paths = paths[self.shape_emitter[paths.shape] >= 0]
        if not len(paths):
            return paths
        frame = Frame.about(paths.shading_normal)
        wi = frame.to_local(-paths.d)
        self.emission(paths, wi[:, 2] > 0)
        leaf, mirrored = resolve(self.world, self.shape_bsdf[paths.shape], wi[:, 2] < 0)
        real = ~self.is_null[leaf]
        self.alpha[paths.lane[~paths.seen & real]] = 1.0
        paths = replace(paths, seen=paths.seen | real)
        if not scatters:
            return paths[:0]
        sign = torch.where(mirrored, -1.0, 1.0).to(wi)
        wi = mirror(wi, sign)
        pieces = [paths[:0]]
        for number in leaf.unique().tolist():
            rows = (leaf == number).nonzero()[:, 0]
            pieces += self.scatter(paths.take(rows), frame.take(rows), wi[rows], sign[rows], number, depth)
        return Paths.cat([p for p in pieces if len(p)] or pieces[:1])

    def bsdf(self, number: int, paths: Paths) -> Bsdf:
        record = self.world.records["bsdf"][number]
        return BSDFS[record.type](self.world, record, paths.at, paths.interaction)

    def weight_of_hit(self, paths: Paths, pdf: torch.Tensor) -> torch.Tensor:
        """Weight of emission that BSDF sampling found, given the density with which emitter sampling would have."""
        return torch.where(paths.origin_pdf > 0, power_heuristic(paths.origin_pdf, pdf.detach()), 1.0)

    def escape(self, paths: Paths) -> None:
        light = self.lights.environment
        if light is None or not len(paths):
            return
        pdf = light.escaped_pdf(paths.d.detach()) * self.lights.pmf[light.index]
        self.add(paths.lane, paths.beta * light.escaped(paths.d) * self.weight_of_hit(paths, pdf)[:, None])

    def emission(self, paths: Paths, facing: torch.Tensor) -> None:
        for light in self.lights.areas:
            rows = (facing & (self.shape_emitter[paths.shape] == light.index)).nonzero()[:, 0]
            if len(rows):
                lit = paths[rows]
                pdf = light.hit_pdf(lit.origin, lit.position.detach(), lit.normal.detach())
                weight = self.weight_of_hit(lit, pdf * self.lights.pmf[light.index])
                self.add(lit.lane, lit.beta * light.radiance(lit.at) * weight[:, None])

    def scatter(
        self, paths: Paths, frame: Frame, wi: torch.Tensor, sign: torch.Tensor, number: int, depth: int
    ) -> list[Paths]:
        """Emitter and BSDF sampling at vertices that share a BSDF; returns the paths that go on."""
        bsdf = self.bsdf(number, paths)
        block = numbers.BLOCKS_PER_SCATTERING * depth
        pixel, sample = self.pixel[paths.lane], self.sample[paths.lane]
        ue = self.random.block(pixel, sample, numbers.EMITTER_BLOCK + block)
        ub = self.random.block(pixel, sample, numbers.BSDF_BLOCK + block)
        if not bsdf.delta and self.lights.all:
            self.sample_lights(paths, frame, wi, sign, number, bsdf, ue)

        if depth + 2 == self.max_depth and not bsdf.delta and not self.lights.seen:
            return []  # no ray finds light, and none would be looked for at what it hits
        with torch.set_grad_enabled(torch.is_grad_enabled() and bsdf.delta):
            s = bsdf.sample(wi, ub)
        rows = (~(s.pdf <= 0)).nonzero()[:, 0]  # a density that is not a number is kept, to be found in the result
        if not len(rows):
            return []
        paths, frame, wi, sign = paths.take(rows), frame.take(rows), wi[rows], sign[rows]
        wo, pdf, eta, lobe = s.wo[rows], s.pdf[rows], s.eta[rows], s.lobe[rows]
        bsdf = self.bsdf(number, paths)
        value = bsdf.eval(wi, wo, lobe)
        weight = value.detach() / pdf[:, None]
        if self.derivative:  # a path that an albedo of zero would end goes on, since that has a derivative
            weight = weight.abs().clamp(min=LEAST_SURVIVAL)
        survival, eta = paths.survival * weight, paths.eta * eta
        largest = survival.abs().amax(1)
        alive, keep = ~(largest <= 0), torch.ones_like(largest)
        if depth + 1 >= self.rr_depth:
            q = (largest * eta * eta).clamp(max=MOST_SURVIVAL)
            alive = alive & ~(ue[rows, 3] >= q)
            keep = torch.where(alive, 1 / torch.where(alive, q, 1.0), 1.0)
        rows = alive.nonzero()[:, 0]
        if not len(rows):
            return []
        paths, factor = paths.take(rows), (keep / pdf)[rows]
        went_on = {
            "beta": paths.beta,
            "survival": (survival * keep[:, None])[rows],
            "eta": eta[rows],
            "origin_pdf": torch.zeros_like(factor) if bsdf.delta else pdf[rows],
        }
        local = (frame.take(rows), wi[rows], sign[rows], wo[rows], lobe[rows], value[rows], factor)
        return [self.go_on(number, paths, *local, not bsdf.delta, went_on)]

    def go_on(
        self,
        number: int,
        paths: Paths,
        frame: Frame,
        wi: torch.Tensor,
        sign: torch.Tensor,
        wo: torch.Tensor,
        lobe: torch.Tensor,
        value: torch.Tensor,
        factor: torch.Tensor,
        smooth: bool,
        went_on: dict[str, torch.Tensor],
    ) -> Paths:
        """The paths along wo: glued to what they meet if the lobe is `smooth`, else attached."""
        d = frame.to_world(mirror(wo, sign))
        d = reattach(normalize(d), d) if self.world.moving else normalize(d.detach())
        position = paths.position.detach()
        o = offset_origin(position, paths.normal.detach(), d.detach())
        if smooth:
            d = d.detach()
        elif self.world.moving:
            o = reattach(o, paths.position)
        hits = self.world.intersect(o, d)
        if smooth and self.world.moving:
            hits, ratio, towards = self.glued(hits, paths.position)
            d = torch.where(hits.valid[:, None], reattach(d, towards), d)
            # The direction has changed its derivative, and in the last digits its value.
            value = self.bsdf(number, paths).eval(wi, mirror(frame.to_local(d), sign), lobe)
            factor = factor * ratio
        return Paths(
            lane=paths.lane,
            d=d,
            beta=went_on.pop("beta") * value * factor[:, None],
            origin=position,
            seen=paths.seen,
            **went_on,
            **arrival(hits),
        )

    def glued(self, hits: Hits, x: torch.Tensor) -> tuple[Hits, torch.Tensor, torch.Tensor]:
        """The hits, glued to their surfaces; J / J' and directions as seen from the points x they came from."""
        rows = hits.valid.nonzero()[:, 0]
        shape, primitive = hits.shape_id[rows], hits.prim_id[rows]
        at = glue(self.world.surfaces, shape, primitive, hits.barycentric[rows], hits.position[rows], hits.uv[rows])

        def put(old: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
            return old.detach().index_put((rows,), reattach(old[rows], new))

        moved: dict[str, torch.Tensor] = {name: put(getattr(hits, name), getattr(at, name)) for name in GLUED}
        hits = hits._replace(**moved, t=hits.t.detach(), barycentric=hits.barycentric.detach())
        ratio = torch.ones_like(hits.t).index_put((rows,), at.solid_angle(x[rows]))
        towards = torch.zeros_like(x).index_put((rows,), normalize(at.position - x[rows]))
        return hits, ratio, towards

    def sample_lights(
        self,
        paths: Paths,
        frame: Frame,
        wi: torch.Tensor,
        sign: torch.Tensor,
        number: int,
        bsdf: Bsdf,
        u: torch.Tensor,
    ) -> None:
        """Light from a point on an emitter, where nothing is in between."""
        light = self.lights.sample(paths.position, u)
        wo = mirror(frame.to_local(light.direction), sign)
        pdf = bsdf.pdf(wi, wo).detach()
        possible = (light.pdf > 0) & ~(pdf <= 0)
        mis = torch.where(light.delta, 1.0, power_heuristic(light.pdf, pdf))
        mis = torch.where(torch.isnan(pdf), pdf, mis)
        factor = torch.where(possible, mis / torch.where(possible, light.pdf, 1.0), 0.0)

        rows = possible.nonzero()[:, 0]
        p, n, d = (x[rows].detach() for x in (paths.position, paths.normal, light.direction))
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
        lit = paths.take(rows)
        lobe = torch.zeros_like(lit.lane)
        value = self.bsdf(number, lit).eval(wi[rows], wo[rows], lobe)
        self.add(lit.lane, lit.beta * value * light.value[rows] * factor[rows][:, None])
