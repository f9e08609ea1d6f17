"""The path tracer: csrc/core/integrator/path.h and csrc/cpu/path_tile.h, N paths a step at a time.

What is attached. The first point is the attached intersection of the attached camera ray: it slides over the surface
when that or the camera moves. The point that a ray sampled at a smooth vertex hits, or that is sampled on a light, is
glued to its surface, and the measure is area: the direction is that from the one moving point to the other, and the
weight gets the ratio J / det(J) of solid angles. The ray after a delta lobe is an attached function of the one before,
and so is the point that it hits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch

import torchrender as tr
from torchrender.render_arguments import film_config
from torchrender.scene.camera import Rays

from . import layers, numbers
from .bsdfs import BSDFS
from .emitters import Lights
from .film import develop, reach
from .geometry import Frame, Rows, dot, normalize, reattach
from .glued import glue
from .layers import Layers
from .sensors import SENSORS
from .world import At, Record, World

GLUED = ("position", "normal", "shading_normal", "uv")
OFFSET, SHADOW_EPSILON = 8.9406967e-5, 8.9406967e-4


@dataclass
class Paths(Rows):
    """Paths that have arrived somewhere, or left the scene.

    `lane` (N,) says which sample; `d` (N, 3) the attached direction of arrival; `beta` (N, C) the throughput;
    `survival` (N, C) what Russian roulette judges by; `eta` (N,) the index of refraction relative to the camera's side;
    `origin`, `origin_pdf` where the ray came from and the density of its direction, 0 after delta lobes and for camera
    rays; `seen` whether alpha is decided; then the hit.
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


def arrival(hits: tr.queries.Hits) -> dict[str, torch.Tensor]:
    found = {name: getattr(hits, name) for name in ("valid", "position", "normal", "shading_normal", "uv")}
    return {
        **found,
        "barycentric": hits.barycentric,
        "shape": hits.shape_id.long(),
        "primitive": hits.prim_id.long(),
    }


def power_heuristic(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    usable = a * a > 0
    return torch.where(usable, a * a / torch.where(usable, a * a + b * b, 1.0), 0.0)


def offset_origin(p: torch.Tensor, n: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
    """Origins (N, 3) moved off a surface to the side of d."""
    amount = (1 + p.abs().amax(1)) * OFFSET
    return p + n * torch.where(dot(n, d) < 0, -amount, amount)[:, None]


class PathTracer:
    """One rendering of one sensor: all samples of all pixels at once."""

    def __init__(self, world: World, config: Mapping, seed: int, sensor: int, derivative: bool) -> None:
        self.world, self.lights, self.seed, self.sensor = world, Lights(world), seed, sensor
        self.max_depth, self.rr_depth = config["max_depth"], config["rr_depth"]
        self.hide_emitters = config["hide_emitters"]
        self.emitter_samples, self.bsdf_samples = config["emitter_samples"], config["bsdf_samples"]
        self.shape_bsdf, self.shape_emitter = world.shape_field("bsdf"), world.shape_field("emitter")
        self.derivative = derivative

    # ----------------------------------------------------------------------------------------------------- whole paths
    def trace(self, rays: Rays, pixel: torch.Tensor, sample: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Radiance (N, C) and alpha (N,) along camera rays."""
        n, channels = len(pixel), self.world.channels
        self.pixel, self.sample = pixel, sample
        self.radiance = torch.zeros(n, channels, dtype=torch.float64)
        self.alpha = torch.zeros(n, dtype=torch.float64)
        if self.max_depth == 0:
            return self.radiance, self.alpha
        one, zero = torch.ones(n, channels, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)
        first = Paths(
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
        scatters = self.max_depth < 0 or self.max_depth > 1
        for index in range(max(self.emitter_samples, self.bsdf_samples) if scatters else 1):
            paths, depth = first, 0
            while len(paths) and (self.max_depth < 0 or depth < self.max_depth):
                more = self.max_depth < 0 or depth + 1 < self.max_depth
                paths = self.vertex(paths, depth, index if depth == 0 else 0, more)
                depth += 1
        return self.radiance, self.alpha

    def first_hits(self, rays: Rays) -> tr.queries.Hits:
        o, d, length = rays
        hits = self.world.intersect(o, d, length)
        while self.hide_emitters:  # the camera looks through shapes that emit
            lit = hits.valid & (self.shape_emitter[hits.shape_id.long()] >= 0)
            if not bool(lit.any()):
                break
            behind = o + d * torch.where(lit, hits.t.detach(), 0.0)[:, None]
            step = torch.where(lit, (1 + behind.detach().abs().amax(1)) * OFFSET, 0.0)
            o = behind + d * step[:, None]
            length = length - torch.where(lit, hits.t.detach() + step, 0.0)
            hits = self.world.intersect(o, d, length)
        return hits

    def add(self, lane: torch.Tensor, value: torch.Tensor) -> None:
        self.radiance = self.radiance.index_add(0, lane, value)

    # -------------------------------------------------------------------------------------------------------- vertices
    def vertex(self, paths: Paths, depth: int, index: int, scatters: bool) -> Paths:
        """What paths find where they are, and where they go on to. `index` counts splits of the first vertex."""
        if index == 0 and self.lights.environment is not None and not (self.hide_emitters and depth == 0):
            self.escape(paths[~paths.valid], depth)
        paths = paths[paths.valid]
        if not scatters and depth > 0:  # the end: what does not emit is not looked at
            paths = paths[self.shape_emitter[paths.shape] >= 0]
        frame = Frame.about(paths.shading_normal)
        wi = frame.to_local(-paths.d)
        if index == 0:
            self.emission(paths, wi[:, 2] > 0, depth)
        ue, ub = self.draw(paths, depth + index)
        found = layers.find(
            self.world,
            self.shape_bsdf[paths.shape],
            paths.at,
            paths.position,
            paths.shading_normal,
            paths.d,
            ub[:, 3],
            viewed=True,
            derivative=self.derivative,
        )
        is_null = torch.tensor([r.type in ("null", "mask") for r in self.world.records["bsdf"]])[found.leaf]
        newly = paths.lane[~paths.seen & ~is_null]
        self.alpha[newly] = 1.0
        paths = replace(paths, seen=paths.seen | ~is_null)
        if not scatters:
            return paths[:0]
        frame = layers.frames(self.world, found, paths.at, paths.position)
        sign = torch.where(found.mirrored, -1.0, 1.0).to(wi)
        wi = frame.to_local(-paths.d)
        wi = torch.stack([wi[:, 0], wi[:, 1], wi[:, 2] * sign], 1)
        pieces = [paths[:0]]
        for number in found.leaf.unique().tolist():
            rows = (found.leaf == number).nonzero()[:, 0]
            here = (paths[rows], frame[rows], wi[rows], sign[rows], found[rows], ue[rows], ub[rows])
            pieces.append(self.scatter(*here, number, depth, index))
        return Paths.cat(pieces)

    def draw(self, paths: Paths, scattering: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The random numbers (N, 4) of emitter and BSDF sampling."""
        pixel, sample = self.pixel[paths.lane], self.sample[paths.lane]
        block = numbers.BLOCKS_PER_SCATTERING * scattering
        ue = numbers.random4(self.seed, self.sensor, pixel, sample, numbers.EMITTER_BLOCK + block)
        return ue, numbers.random4(self.seed, self.sensor, pixel, sample, numbers.BSDF_BLOCK + block)

    def weight_of_hit(self, paths: Paths, pdf: torch.Tensor, depth: int) -> torch.Tensor:
        """Weight of emission that BSDF sampling found, given the density with which emitter sampling would have."""
        if depth == 1:
            pdf = pdf * (self.emitter_samples / self.bsdf_samples)
        return torch.where(paths.origin_pdf > 0, power_heuristic(paths.origin_pdf, pdf.detach()), 1.0)

    def escape(self, paths: Paths, depth: int) -> None:
        light = self.lights.environment
        pdf = light.escaped_pdf(paths.d.detach()) * self.lights.pmf[light.index]
        weight = self.weight_of_hit(paths, pdf, depth)
        self.add(paths.lane, paths.beta * light.escaped(paths.d) * weight[:, None])

    def emission(self, paths: Paths, facing: torch.Tensor, depth: int) -> None:
        for light in self.lights.all:
            rows = (facing & (self.shape_emitter[paths.shape] == light.index)).nonzero()[:, 0]
            if not len(rows):
                continue
            lit = paths[rows]
            pdf = light.hit_pdf(lit.origin, lit.position.detach(), lit.normal.detach()) * self.lights.pmf[light.index]
            weight = self.weight_of_hit(lit, pdf, depth)
            self.add(lit.lane, lit.beta * light.radiance(lit.at) * weight[:, None])

    def scatter(
        self,
        paths: Paths,
        frame: Frame,
        wi: torch.Tensor,
        sign: torch.Tensor,
        above: Layers,
        ue: torch.Tensor,
        ub: torch.Tensor,
        number: int,
        depth: int,
        index: int,
    ) -> Paths:
        """Emitter and BSDF sampling at vertices that share a BSDF; returns the paths that go on."""
        record = self.world.records["bsdf"][number]
        bsdf = BSDFS[record.type](self.world, record, paths.at)
        n_emitter = self.emitter_samples if depth == 0 else 1
        n_bsdf = self.bsdf_samples if depth == 0 else 1
        if bsdf.smooth and self.lights.all and index < self.emitter_samples:
            self.sample_lights(paths, frame, wi, sign, above, bsdf, ue, n_emitter, n_bsdf)

        s = bsdf.sample(wi, ub)
        wo = frame.to_world(torch.stack([s.wo[:, 0], s.wo[:, 1], s.wo[:, 2] * sign], 1)).detach()
        alive = (s.pdf > 0) & (index < n_bsdf) & ~above.hides(-paths.d) & ~above.hides(wo)
        inverse = torch.where(alive, above.inverse / torch.where(alive, n_bsdf * s.pdf, 1.0), 0.0)
        brought = (above.weight * above.dimmed(wo)).detach() * inverse
        weight = bsdf.eval(wi, s.wo, s.lobe).detach() * brought[:, None]
        if self.derivative:  # a path that an albedo of zero would end goes on, since that has a derivative
            weight = weight.abs().clamp(min=0.05)
        survival = paths.survival * weight
        largest = survival.abs().amax(1)
        alive = alive & (largest > 0)
        eta = paths.eta * s.eta
        keep = torch.ones_like(largest)
        if depth + 1 >= self.rr_depth:
            q = (largest * eta * eta).clamp(max=0.95)
            alive = alive & (ue[:, 3] < q)
            keep = torch.where(alive, 1 / torch.where(alive, q, 1.0), 1.0)

        going = []
        for smooth in (True, False):
            if not (bsdf.smooth if smooth else bsdf.delta):
                continue
            kind = (s.lobe == 0) == smooth if bsdf.smooth and bsdf.delta else torch.ones_like(alive)
            rows = (alive & kind).nonzero()[:, 0]
            went_on = {"survival": (survival * keep[:, None])[rows], "eta": eta[rows]}
            went_on["origin_pdf"] = s.pdf[rows].detach() if smooth else torch.zeros_like(sign[rows])
            on = (paths[rows], frame[rows], wi[rows], sign[rows], above[rows], s.wo[rows], s.lobe[rows])
            going.append(self.go_on(record, *on, (inverse * keep)[rows], smooth, went_on))
        return Paths.cat(going)

    def go_on(
        self,
        record: Record,
        paths: Paths,
        frame: Frame,
        wi: torch.Tensor,
        sign: torch.Tensor,
        above: Layers,
        wo: torch.Tensor,
        lobe: torch.Tensor,
        factor: torch.Tensor,
        smooth: bool,
        went_on: dict[str, torch.Tensor],
    ) -> Paths:
        """The paths along wo: glued to what they meet if the lobe is `smooth`, else attached."""
        bsdf = BSDFS[record.type](self.world, record, paths.at)
        flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], 1)
        d = frame.to_world(wo * flip)
        d = reattach(normalize(d), d)
        position, normal = paths.position.detach(), paths.normal.detach()
        o = offset_origin(position, normal, d.detach())
        if smooth:
            d = d.detach()
        else:
            o = reattach(o, paths.position)
        hits = self.world.intersect(o, d)
        if smooth:
            hits, ratio, towards = self.glued(hits, paths.position)
            d = torch.where(hits.valid[:, None], reattach(d, towards), d)
            wo = frame.to_local(d) * flip
            factor = factor * ratio
        factor = factor * above.weight * above.dimmed(d)
        return Paths(
            lane=paths.lane,
            d=d,
            beta=paths.beta * bsdf.eval(wi, wo, lobe) * factor[:, None],
            origin=position,
            seen=paths.seen,
            **went_on,
            **arrival(hits),
        )

    def glued(self, hits: tr.queries.Hits, x: torch.Tensor) -> tuple[tr.queries.Hits, torch.Tensor, torch.Tensor]:
        """The hits, glued to their surfaces; J / det(J) and directions as seen from the points x they came from."""
        rows = hits.valid.nonzero()[:, 0]
        shape, primitive = hits.shape_id.long()[rows], hits.prim_id.long()[rows]
        at = glue(self.world.surfaces, shape, primitive, hits.barycentric[rows], hits.position[rows], hits.uv[rows])

        def put(old: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
            return old.detach().index_put((rows,), reattach(old[rows], new))

        moved = {name: put(getattr(hits, name), getattr(at, name)) for name in GLUED}
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
        above: Layers,
        bsdf: object,
        u: torch.Tensor,
        n_emitter: int,
        n_bsdf: int,
    ) -> None:
        light = self.lights.sample(paths.position, u)
        wo = frame.to_local(light.direction)
        wo = torch.stack([wo[:, 0], wo[:, 1], wo[:, 2] * sign], 1)
        pdf = bsdf.pdf(wi, wo).detach()
        possible = (light.pdf > 0) & (pdf > 0) & ~above.hides(-paths.d) & ~above.hides(light.direction)
        mis = torch.where(light.delta, 1.0, power_heuristic(n_emitter * light.pdf, n_bsdf * pdf))
        factor = torch.where(possible, mis / torch.where(possible, n_emitter * light.pdf, 1.0), 0.0)
        factor = factor * above.inverse * above.weight * above.dimmed(light.direction)
        value = paths.beta * bsdf.eval(wi, wo, torch.zeros_like(paths.lane)) * light.value * factor[:, None]

        rows = possible.nonzero()[:, 0]
        p, n, d = (x[rows].detach() for x in (paths.position, paths.normal, light.direction))
        distance = light.distance[rows]
        o = offset_origin(p, n, d)
        near = distance < 1e30
        towards = p + d * torch.where(near, distance, 1.0)[:, None] - o
        length = torch.linalg.vector_norm(towards, dim=1)
        direction = torch.where(near[:, None], towards / length[:, None], d)
        limit = torch.where(near, length * (1 - SHADOW_EPSILON), math.inf)
        rows = rows[~self.world.occluded(o, direction, limit)]
        self.add(paths.lane[rows], value[rows])


def render(
    scene: tr.Scene,
    *,
    seed: int,
    spp: int,
    integrator: tr.integrators.Integrator | None = None,
    sensor: int = 0,
    params: Mapping[str, torch.Tensor] | None = None,
    derivative: bool = False,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Image (H, W, C) and alpha (H, W), attached to the scene's parameters and to `params`.

    With `derivative`, paths are those of the native derivative with respect to all BSDFs: Russian roulette judges by a
    throughput that never vanishes.
    """
    assert scene.dtype == torch.float64
    world, film = World(scene, params), scene.sensors[sensor].film
    positions, rays, pixel, sample = camera_samples(world, seed, spp, sensor)
    config = (integrator or scene.integrator or tr.PathTracer()).config()
    radiance, alpha = PathTracer(world, config, seed, sensor, derivative).trace(rays, pixel, sample)
    image = develop(film, positions, torch.cat([radiance, alpha[:, None]], 1))
    return image[..., :-1], image[..., -1].detach()


def camera_samples(
    world: World, seed: int, spp: int, sensor: int
) -> tuple[torch.Tensor, Rays, torch.Tensor, torch.Tensor]:
    """Film positions (N, 2), their rays, and numbers of pixel and sample (N,)."""
    record, film = world.records["sensor"][sensor], world.scene.sensors[sensor].film
    y0, x0, height, width = film.window
    sampled = film_config(film, None)[2]["window"]
    k = reach(film)  # samples that reach no pixel are not drawn
    rows = range(max(sampled[0], y0 - k), min(sampled[0] + sampled[2], y0 + height + k))
    columns = range(max(sampled[1], x0 - k), min(sampled[1] + sampled[3], x0 + width + k))
    y, x, sample = (
        t.flatten() for t in torch.meshgrid(torch.tensor(rows), torch.tensor(columns), torch.arange(spp), indexing="ij")
    )
    pixel = ((y + 32768) << 16) | (x + 32768)
    u = numbers.random4(seed, sensor, pixel, sample, 0)
    positions = torch.stack([x + u[:, 0], y + u[:, 1]], 1)
    rays = SENSORS[record.type](world, record, (film.height, film.width), positions, u[:, 2:])
    return positions, rays, pixel, sample
