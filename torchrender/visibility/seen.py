"""Outlines that the camera sees, and the colours on both sides of them."""

from __future__ import annotations

import math
from typing import Any

import torch

from ..scene.camera_rays import Rays
from .outlines import MOST, PIXELS, Pieces, Viewpoint
from .sampling import CHUNK, RIM, STREAM, Boundary, Samples, across, both_sides, is_open, least_side

LENGTHWISE = 4  # samples for each pixel of an outline's length, in those of a pixel
SIDE = 2.0**-14  # how far beside an outline its colours are looked at, in pixels


def seen_outlines(scene: Boundary) -> Samples:
    """Samples of outlines that the camera sees, see :func:`.boundary.samples`."""
    call, given = scene.call, scene.given
    if not bool(given.moves.any()):
        return
    seen = _SeenOutlines(scene)
    seen.prepare()
    if seen.total <= 0:
        return
    count = given.spp[0] * math.prod(call.size)
    if given.by_length:
        count = min(count, math.ceil(LENGTHWISE * call.spp_grad * seen.total))
    for number, config, generator in scene.configs(STREAM):
        first = float(torch.rand((), generator=generator, dtype=torch.float64))
        for begin in range(0, count, CHUNK):
            n = min(CHUNK, count - begin)
            at = (begin + torch.arange(n, dtype=torch.float64) + first) / count
            key = torch.arange(begin, begin + n, dtype=torch.int64) + number * count
            yield from seen.draw(at, key, config, 1.0 / (count * call.passes), generator)
            scene.begin()


class _SeenOutlines:
    """Outlines of the scene as one camera sees them."""

    def __init__(self, scene: Boundary) -> None:
        self.scene, self.world, self.outlines, self.size = scene, scene.world, scene.outlines, scene.size
        self.parallel = scene.record.type == "orthographic"
        to_world = self.world.tensor("sensor", scene.record, "to_world").detach()
        radius = 0.0
        if scene.record.type == "thinlens":
            radius = float(self.world.tensor("sensor", scene.record, "aperture_radius").detach())
            radius *= float(torch.linalg.matrix_norm(to_world[:3, :3], 2))
        self.view = Viewpoint(None if self.parallel else to_world[:3, 3], to_world[:3, 2], radius)
        self.total = 0.0

    def prepare(self) -> None:
        """Cut outlines into pieces, and weigh these by their length on the film, where pixels there are wanted."""
        with torch.no_grad():
            self.edges, whole = self.outlines.whole(self.view)
            length, _, seen = self._on_film(whole, 8)
            number = torch.where(seen, (length / PIXELS).ceil(), torch.zeros_like(length)).clamp(0, MOST).long()
            number = torch.where(seen & (whole.edge < 0), number.clamp(min=32), number)
            rows = torch.arange(len(number)).repeat_interleave(number)
            first = (torch.cumsum(number, 0) - number)[rows]
            step = (torch.arange(len(rows)) - first).to(whole.begin.dtype)
            pieces, parts = whole[rows], number[rows].to(whole.begin.dtype)
            pieces.begin, pieces.end = step / parts, (step + 1) / parts
            length, middle, seen = self._on_film(pieces, 2)
            film = self.scene.film
            height, width = film.height, film.width
            length = length.clamp(max=float(height + width))
            weight = pieces.weight * torch.where(seen, length, torch.zeros_like(length))
            margin = length + film.reach + 1 + (0.5 * (height + width) if self.view.radius > 0 else 0)
            x, y = middle[:, 0] - film.x0, middle[:, 1] - film.y0
            inside = (x > -margin) & (x < width + margin) & (y > -margin) & (y < height + margin)
            weight = torch.where(inside | ~torch.isfinite(x + y), weight, torch.zeros_like(weight))
            if film.where is not None:
                weight = weight * film.near_wanted(x, y, int(PIXELS) + film.reach)
            kept = (weight > 0).nonzero()[:, 0]
            self.pieces = pieces[kept]
            self.cdf = torch.cumsum(weight[kept].double(), 0)
            self.total = float(self.cdf[-1]) if len(kept) else 0.0

    def _on_film(self, pieces: Pieces, steps: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Lengths of pieces on the film, roughly, places of their middles, and whether anything can be seen of them."""
        n, real = len(pieces.begin), pieces.begin.dtype
        share = torch.linspace(0, 1, steps + 1, dtype=real)
        places = []
        for s in share:
            at = pieces.begin + (pieces.end - pieces.begin) * s
            places.append(self.scene.places(self._origin_points(pieces, at), torch.full((n, 2), 0.5, dtype=real)))
        place = torch.stack(places)
        there = torch.isfinite(place).all(2)
        step = torch.linalg.vector_norm(place[1:] - place[:-1], dim=2)
        both = there[1:] & there[:-1]
        unknown = (there[1:] ^ there[:-1]).to(real) * (PIXELS * 2)
        length = torch.where(both, step, unknown).sum(0)
        if self.scene.record.type == "panorama":  # around the seam
            length = torch.where(both, step.clamp(max=self.size[1] / 4), unknown).sum(0)
        return length, place[steps // 2], there.any(0) | (self.view.radius > 0)

    def _origin_points(self, pieces: Pieces, at: torch.Tensor) -> torch.Tensor:
        origin = self.view.direction if self.view.point is None else self.view.point
        return self.outlines.points(
            self.edges, pieces, at, origin.expand(len(at), 3), self.parallel, exact=False
        ).position

    def draw(
        self, at: torch.Tensor, key: torch.Tensor, config: dict[str, Any], share: float, generator: torch.Generator
    ) -> Samples:
        """Samples at places of the distribution of pieces, in [0, 1)."""
        real = self.scene.real
        numbers = torch.rand(len(at), 3, generator=generator, dtype=torch.float64)
        index = torch.searchsorted(self.cdf, at * self.total, right=True).clamp(max=len(self.cdf) - 1)
        mass = self.cdf[index] - torch.where(index > 0, self.cdf[(index - 1).clamp(min=0)], 0.0)
        pieces = self.pieces[index]
        s = (pieces.begin + (pieces.end - pieces.begin) * numbers[:, 0]).to(real)
        lens = numbers[:, 1:].to(real)
        density = mass / self.total / (pieces.end - pieces.begin)  # by the parameter
        origin = self._origins(lens)
        point = self.outlines.points(self.edges, pieces, s, origin, self.parallel)
        b, along = point.position, point.along
        with torch.no_grad():
            place = self.scene.places(b, lens)
            kept = (point.valid & torch.isfinite(place).all(1)).nonzero()[:, 0]
        b, along, place, lens, density, key = b[kept], along[kept], place[kept], lens[kept], density[kept], key[kept]
        front, room, rim = point.front[kept], point.room[kept], point.rim[kept]
        if not len(kept):
            return
        rays = self.scene.rays(place, lens)
        with torch.no_grad():
            towards = b - rays.origins
            distance = (towards * rays.directions).sum(1)
            apart = torch.linalg.vector_norm(towards - rays.directions * distance[:, None], dim=1)
            normal, turned = across(rays.directions, along)
            area = self.scene.pixel_area(place, lens, rays.directions, distance)
            side = torch.maximum(torch.minimum(SIDE * area.sqrt(), room / 8), least_side(b, distance))
            good = (turned > 0) & (area > 0) & (distance > 0) & (distance < rays.tmax)
            good = good & (apart < 1e-3 * distance)  # the lens does show it there
            kept = good.nonzero()[:, 0]
            if not len(kept):
                return
            both = self._beside(rays, b, normal, side, torch.where(front != 0, RIM * rim, 0.0), front, kept)
            t = self.world.first_hits(both, self.scene.call.config["hide_emitters"]).t.detach()
            open_ = is_open(front[kept], distance[kept], t, 1e-5).nonzero()[:, 0]
            if not len(open_):
                return
            both = Rays(*(x[torch.cat([open_, open_ + len(kept)])] for x in both))
            kept = kept[open_]
            values = self.scene.radiance(both, key[kept].repeat(2), config)
            jump = values[: len(kept)] - values[len(kept) :]
            weight = turned[kept] / area[kept] / density[kept] * share
            jump = (
                jump.double() * torch.where(torch.isfinite(weight), weight, torch.zeros_like(weight))[:, None].double()
            )
        o, d = rays.origins[kept], rays.directions[kept]
        rate = ((b[kept] - o - d * distance[kept, None]) * normal[kept]).sum(1)
        yield jump, rate.double(), place[kept].double()

    def _origins(self, lens: torch.Tensor) -> torch.Tensor:
        if self.view.point is None:
            return self.view.direction.expand(len(lens), 3)
        if self.scene.record.type != "thinlens":
            return self.view.point.expand(len(lens), 3)
        with torch.no_grad():  # rays begin on the near plane: back to the lens
            middle = torch.tensor([self.size[1] / 2, self.size[0] / 2], dtype=lens.dtype).expand(len(lens), 2)
            rays = self.scene.rays(middle, lens)
            axis = torch.nn.functional.normalize(self.view.direction, dim=0)
            back = ((rays.origins - self.view.point) @ axis) / (rays.directions @ axis)
            return rays.origins - rays.directions * back[:, None]

    def _beside(
        self,
        rays: Rays,
        b: torch.Tensor,
        normal: torch.Tensor,
        side: torch.Tensor,
        rim: torch.Tensor,
        front: torch.Tensor,
        kept: torch.Tensor,
    ) -> Rays:
        """Camera rays on both sides of points b, of these rows: `side` beside them, in front `rim` more."""
        o, d, reach = (x.detach()[kept] for x in rays)

        def on(sign: float) -> Rays:
            offset = normal[kept] * (sign * (side + torch.where(front == sign, rim, 0.0)))[kept, None]
            if self.parallel:
                return Rays(o + offset, d, reach)
            return Rays(o, torch.nn.functional.normalize(b.detach()[kept] - o + offset, dim=1), reach)

        return both_sides(on)
