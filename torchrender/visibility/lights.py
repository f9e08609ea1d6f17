"""Outlines that lights see: the edges of shadows.

From a place on a light, or along a direction of one that is infinitely far away, an outline's point B is chosen; the
ray past it ends at S, which the camera sees at the place u of its film, at the end of a segment c. With the unit
direction d from S to the light, at S the BSDF f with its cosine, w pixels per area perpendicular to c, and the density
p of the light's place,

    dI = - integral of h(p - u) / Z  w |n.c| / |n.d|  f L g  n.(dB - (1 - tau) dS - tau dE)  dl

with tau = |B - S| / |E - S|, and g = sin cos_E / (r^2 p) for places E on shapes with the cosine there, r from B away;
sin / r^2 for points, L being their intensity; and sin / p for directions. Where a vertex x of a path sees S in place of
the camera, beta f_x / |S - x|^2 stands for h w / Z. Directions that the BSDF finds as well share what they bring with
it by the power heuristic of the path tracer, and close to x with what is found there from x, see vertices.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..queries import find_hits
from ..scene.camera_rays import Rays
from ..surface import dot
from ..wavefront.emitters import Area
from ..wavefront.numbers import search
from ..wavefront.path import power_heuristic
from .anchors import AnchorTracer, Piece, one_of_path
from .choice import Choice
from .light_places import Places, light_places
from .sampling import Boundary, Found, Samples, across, joined, least_side
from .tree import Anchors

STREAM, PILOT = 0x6C69676874, 0x70696C6F74
FEW = 1024  # samples that tell how much the camera sees of what lights find
EXTENDED = ("area", "constant", "envmap")
SHADE = ("area", "constant", "envmap", "point", "spot", "projector", "directional")


def outlines_before_lights(scene: Boundary, choice: Choice, tracer: AnchorTracer, in_view: float) -> Samples:
    """Samples of outlines that lights see, see :func:`.boundary.samples`; `in_view`: see :func:`share_in_view`."""
    pmf = _pmf(scene, tracer, SHADE)
    if pmf is None:
        return
    max_depth = scene.call.config["max_depth"]
    for chunk in scene.chunks(STREAM, 9):
        tracer.start(chunk.config)
        shadows = _Shadows(scene, tracer, chunk.key, 1.0 / chunk.total, float(chunk.cells), in_view, max_depth)
        yield from joined(shadows.draw(choice, pmf, chunk.place, chunk.u, chunk.seed))


def share_in_view(scene: Boundary, choice: Choice, tracer: AnchorTracer) -> float:
    """About which share of the edges that lights find the camera sees, in the wanted pixels: of a few samples.

    With lights in view of which it sees few, those are left to the vertices. A function of the seed alone.
    """
    pmf = _pmf(scene, tracer, EXTENDED)
    if pmf is None:
        return 1.0
    _, config, generator = next(scene.configs(PILOT))
    tracer.start(config)
    with torch.no_grad():
        u = torch.rand(FEW, 9, generator=generator, dtype=torch.float64)
        shadows = _Shadows(scene, tracer, torch.arange(FEW), 1.0, 1.0, 1.0, max_depth=2)
        found = shadows.draw(choice, pmf, u[:, :2], u, scene.call.seed_grad & 0xFFFFFFFF)
        inside = sum(int(scene.film.wanted(place).sum()) for _, _, place in found)
    return min(1.0, max(inside / max(shadows.edges, 1), 1e-3))


def _pmf(scene: Boundary, tracer: AnchorTracer, kinds: tuple[str, ...]) -> torch.Tensor | None:
    """The probability of each light of these kinds, not normalised; None if there is none."""
    emitters = scene.world.records["emitter"]
    chosen = torch.tensor([emitters[e.index].type in kinds for e in tracer.lights.all], dtype=torch.bool)
    pmf = tracer.lights.pmf[: len(chosen)] * chosen
    return pmf if bool(pmf.sum() > 0) else None


@dataclass
class _Edges:
    """Edges of shadows that a light throws: points S (M, 3) on surfaces, and all of the formula that is the light's.

    `row` (M,) numbers the light's places, `lane` (M,) the samples; `b` (M, 3) is attached; `free` (M, 3) is n.
    `of_lane` (N,) gives the rows of all samples, or -1.
    """

    places: Places
    row: torch.Tensor
    lane: torch.Tensor
    s: torch.Tensor
    d: torch.Tensor
    b: torch.Tensor
    free: torch.Tensor
    weight: torch.Tensor
    of_lane: torch.Tensor

    def rate(self, at: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
        """Of those edges (N,), whose points on surfaces move like s (N, 3)."""
        places, b = self.places, self.b[at]
        moved = b - s
        if places.moving is not None:
            e = places.moving[self.row[at]]
            length = torch.linalg.vector_norm(moved.detach(), dim=1)
            if places.far:  # the direction turns
                moved = moved + e * length[:, None]
            else:
                tau = (length / torch.linalg.vector_norm((e - s).detach(), dim=1))[:, None]
                moved = b - (1 - tau) * s - tau * e
        return (moved * self.free[at]).sum(1).double()


class _Shadows:
    """The edges of shadows of a chunk of samples, as the camera and vertices of paths see them."""

    def __init__(
        self,
        scene: Boundary,
        tracer: AnchorTracer,
        key: torch.Tensor,
        share: float,
        cells: float,
        in_view: float,
        max_depth: int,
    ) -> None:
        self.scene, self.tracer, self.lights, self.key = scene, tracer, tracer.lights, key
        self.share, self.cells, self.in_view, self.max_depth = share, cells, in_view, max_depth
        self.edges = 0  # that were found

    def draw(self, choice: Choice, pmf: torch.Tensor, place: torch.Tensor, u: torch.Tensor, seed: int) -> list[Found]:
        real, found, paths = self.scene.real, [], []
        if self.max_depth < 0 or self.max_depth > 2:
            rays = self.scene.rays(place.to(real), u[:, :2].to(real))
            pieces = self.tracer.vertices(rays, self.key, max(self.max_depth - 1, -1))
            paths = [p for p in one_of_path(pieces, u[:, 2], len(place)) if len(p.vertices)]
        pmf = pmf / pmf.sum()
        index, _, _ = search(torch.cumsum(pmf, 0).clamp(max=1.0), u[:, 3].to(pmf))
        for i in index.unique().tolist():
            lane = (index == i).nonzero()[:, 0]
            places = light_places(self.scene.world, self.lights.all[i], u[lane, 4:7].to(real))
            places.weight = places.weight * (self.share / float(pmf[i]))
            edges = self._edges(choice, places, lane, seed + i)
            if edges is not None:
                self.edges += len(edges.row)
                found += self._seen_by_camera(edges, u[:, 7:].to(real))
                for piece in paths:
                    found += self._seen_by_vertices(edges, piece, place)
        return found

    def _edges(self, choice: Choice, places: Places, lane: torch.Tensor, seed: int) -> _Edges | None:
        scene, world, light, far = self.scene, self.scene.world, places.light, places.far
        own = light.shape if isinstance(light, Area) else -1
        chosen = choice.draw(Anchors.plain(places.at, places.normal, own), seed, far)
        row, point = chosen.rows, chosen.point
        with torch.no_grad():
            y, b, along = places.at[row], point.position.detach(), point.along
            towards = y if far else b - y
            r = torch.linalg.vector_norm(towards, dim=1)
            d = towards / r.clamp(min=1e-30)[:, None]  # with the light
            normal, turned = across(d, along)
            free = -point.front[:, None] * normal  # from what hides to what does not
            g = turned / torch.linalg.vector_norm(along, dim=1)
            if not far:
                g = g / (r * r)
            if isinstance(light, Area):
                g = g * dot(places.normal[row], d).clamp(min=0.0)
            weight = g * places.weight[row] * chosen.inverse
            kept = ((point.front != 0) & (weight > 0) & torch.isfinite(weight)).nonzero()[:, 0]
            if not len(kept):
                return None
            row, y, b, r, free, d = row[kept], y[kept], b[kept], r[kept], free[kept], d[kept]
            if far:
                rays = Rays(b + free * least_side(b, 1.0)[:, None], d, torch.full_like(r, math.inf))
                passed = ~world.occluded(rays.origins, -d, rays.tmax)
            else:
                rays = scene.beside(y, places.normal[row], b, free, point.room[kept])
                passed = torch.ones_like(r, dtype=torch.bool)
            hits = find_hits(scene.call.native, world.plain, *rays)
            on = passed & hits.valid
            if not far:
                on = on & (hits.t > r * (1 - 1e-3))
            on = on.nonzero()[:, 0]
            if not len(on):
                return None
            row, free, kept = row[on], free[on], kept[on]
            of_lane = torch.full((len(self.key),), -1)
            of_lane[lane[row]] = torch.arange(len(row))
        s, d, moving = hits.position[on], -rays.directions[on], point.position[kept]
        return _Edges(places, row, lane[row], s, d, moving, free, weight[kept], of_lane)

    def _brought(
        self, edges: _Edges, at: torch.Tensor, piece: Piece, rows: torch.Tensor, c: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """|n.c| / |n.d| f L and the weight of the power heuristic, of edges (N,) on surfaces of these rows (N,)."""
        paths, d = piece.vertices.paths, edges.d[at]
        f, pdf = self.tracer.value(piece, rows, d)
        normal = paths.normal.detach()[rows]
        ratio = dot(normal, c).abs() / dot(normal, d).abs().clamp(min=1e-6)
        light, density = edges.places.arriving(self.lights, edges.row[at], paths.position.detach()[rows], d)
        n_light, n_bsdf = self.tracer.counts if piece.depth == 0 else (1, 1)
        if piece.depth == 0:
            density = density * self.in_view
        mis = torch.where(density > 0, power_heuristic(n_light * density, n_bsdf * pdf), 1.0)
        return f * light * (ratio * edges.weight[at])[:, None], torch.where(density > 0, mis, math.inf)

    def _seen_by_camera(self, edges: _Edges, lens: torch.Tensor) -> list[Found]:
        scene, found = self.scene, []
        with torch.no_grad():
            lens = lens[edges.lane]
            place = scene.places(edges.s, lens)
            seen = torch.isfinite(place).all(1).nonzero()[:, 0]
        if not len(seen):
            return []
        camera = scene.rays(place[seen], lens[seen])
        for piece in self.tracer.vertices(camera, self.key[edges.lane[seen]], 2):
            paths = piece.vertices.paths
            with torch.no_grad():
                at = seen[paths.lane]
                distance = torch.linalg.vector_norm(edges.s[at] - camera.origins.detach()[paths.lane], dim=1)
                rows = self._meets(edges, at, paths.position, distance)
                if not len(rows):
                    continue
                at, c = at[rows], camera.directions.detach()[paths.lane[rows]]
                area = scene.pixel_area(place[at], lens[at], c, distance[rows])
                value, mis = self._brought(edges, at, piece, rows, c)
                value = value * (mis.clamp(max=1.0) / area)[:, None]
                rows, at, value = _bright(rows, at, value)
            if len(rows):
                found.append((pad(-value), edges.rate(at, paths.position[rows]), place[at].double()))
        return found

    def _seen_by_vertices(self, edges: _Edges, piece: Piece, place: torch.Tensor) -> list[Found]:
        tracer, found = self.tracer, []
        with torch.no_grad():
            at = edges.of_lane[piece.vertices.paths.lane]
            rows = (at >= 0).nonzero()[:, 0]
            if not len(rows):
                return []
            at = at[rows]
            towards = edges.s[at] - piece.vertices.paths.position.detach()[rows]
            r = torch.linalg.vector_norm(towards, dim=1)
            c = towards / r.clamp(min=1e-30)[:, None]
            f, _ = tracer.value(piece, rows, c)
            factor = piece.weight[rows].to(r) * self.cells / (r * r)
            good = ((f != 0).any(1) & torch.isfinite(factor)).nonzero()[:, 0]
            if not len(good):
                return []
            rows, at, r, c, f, factor = rows[good], at[good], r[good], c[good], f[good], factor[good]
            row_of_lane = torch.full((len(place),), -1)
            row_of_lane[piece.vertices.paths.lane[rows]] = torch.arange(len(rows))
        for end in tracer.seen_from(piece, rows, c, f, factor, self.key):
            paths = end.vertices.paths
            lane = paths.lane
            with torch.no_grad():
                there, mine = edges.of_lane[lane], row_of_lane[lane]
                kept = self._meets(edges, there, paths.position, r[mine])
                if not len(kept):
                    continue
                there, mine = there[kept], mine[kept]
                value, mis = self._brought(edges, there, end, kept, c[mine])
                # close to the vertex a part of it is found from there
                near = torch.where(torch.isinf(mis), 1.0, self.scene.apart(r[mine]) * mis.clamp(max=1.0))
                value = value * paths.beta.detach()[kept] * near[:, None]
                kept, there, value = _bright(kept, there, value)
            if len(kept):
                found.append((pad(-value), edges.rate(there, paths.position[kept]), place[lane[kept]].double()))
        return found

    def _meets(self, edges: _Edges, at: torch.Tensor, position: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
        """Rows whose rays have met the edges at their points."""
        s = edges.s[at]
        apart = torch.linalg.vector_norm(position.detach() - s, dim=1)
        return (apart < 1e-3 * (distance + s.abs().amax(1))).nonzero()[:, 0]


def _bright(
    rows: torch.Tensor, at: torch.Tensor, value: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    some = (torch.isfinite(value).all(1) & (value != 0).any(1)).nonzero()[:, 0]
    return rows[some], at[some], value[some]


def pad(jump: torch.Tensor) -> torch.Tensor:
    """Jumps of colour with none of alpha."""
    return torch.nn.functional.pad(jump.double(), (0, 1))
