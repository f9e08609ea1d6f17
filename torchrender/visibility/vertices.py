"""Outlines that points on surfaces see: where the light that they scatter ends to be visible, and begins.

At a vertex S of a path, which has the throughput beta, light comes from everywhere; past an outline's point B there is
one thing on the one side and another on the other. With the unit direction d to B, at the distance r,

    dI = beta  integral of f(d) sin / r^2  (L_minus v_minus - L_plus v_plus)  dl

where v = n.(dB - (1 - tau) dS - tau dE) for a point E that is glued to what emits, tau = r / |E - S|, and n.(dB - dS)
for all else, which is looked up along a direction at rest: see docs/theory/motion.md.
"""

from __future__ import annotations

from typing import Any

import torch

from ..queries import find_hits
from ..scene.camera_rays import Rays
from ..wavefront.geometry import glue
from .anchors import AnchorTracer, Piece, one_of_path
from .choice import Choice, Chosen
from .lights import pad
from .sampling import CHUNK, RIM, Boundary, Found, Samples, is_crease_seen, joined
from .tree import Anchors

STREAM = 0x7665727478


def outlines_before_surfaces(scene: Boundary, choice: Choice, in_view: float) -> Samples:
    """Samples of outlines that points on paths see, see :func:`.boundary.samples`."""
    call = scene.call
    cells = scene.film.cells(call.config["window"])
    if not len(cells):
        return
    count = scene.given.spp[1] * len(cells)
    for number, config, generator in scene.configs(STREAM):
        tracer = AnchorTracer(scene, config)
        for begin in range(0, count, CHUNK):
            n = min(CHUNK, count - begin)
            at = torch.arange(begin, begin + n, dtype=torch.int64)
            u = torch.rand(n, 6, generator=generator, dtype=torch.float64)
            seed = int(torch.randint(0, 1 << 62, (), generator=generator))
            place = cells[at % len(cells)] + u[:, :2]
            share = len(cells) / (count * call.passes)
            yield from _draw(scene, choice, tracer, place, u[:, 2:], at + number * count, seed, config, share, in_view)
            scene.begin()


def _draw(
    scene: Boundary,
    choice: Choice,
    tracer: AnchorTracer,
    place: torch.Tensor,
    u: torch.Tensor,
    key: torch.Tensor,
    seed: int,
    config: dict[str, Any],
    share: float,
    in_view: float,
) -> Samples:
    lens = u[:, :2].to(scene.real)
    rays = scene.rays(place.to(scene.real), lens)
    pieces = tracer.vertices(rays, key, config["max_depth"])
    pieces = one_of_path(pieces, u[:, 2], len(place))
    pieces = [p for p in pieces if len(p.vertices)]
    if not pieces:
        return
    anchors = [tracer.anchors(p) for p in pieces]
    whole = Anchors(*(torch.cat([getattr(a, n) for a in anchors]) for n in Anchors.__dataclass_fields__))
    chosen = choice.draw(whole, seed)
    first, found = 0, []
    for piece in pieces:
        end = first + len(piece.vertices)
        mine = ((chosen.rows >= first) & (chosen.rows < end)).nonzero()[:, 0]
        if len(mine):
            found += _behind(scene, tracer, piece, chosen, mine, first, place, u, key, config, share, in_view)
        first = end
    yield from joined(found)


def _behind(
    scene: Boundary,
    tracer: AnchorTracer,
    piece: Piece,
    chosen: Chosen,
    mine: torch.Tensor,
    first: int,
    place: torch.Tensor,
    u: torch.Tensor,
    key: torch.Tensor,
    config: dict[str, Any],
    share: float,
    in_view: float,
) -> list[Found]:
    """What a piece's vertices see on both sides of outlines' points."""
    world, point = scene.world, chosen.point
    rows = chosen.rows[mine] - first
    with torch.no_grad():
        s = piece.vertices.paths.position.detach()[rows]
        b, along = point.position.detach()[mine], point.along[mine]
        towards = b - s
        r = torch.linalg.vector_norm(towards, dim=1)
        d = towards / r.clamp(min=1e-30)[:, None]
        across = torch.linalg.cross(d, along)
        turned = torch.linalg.vector_norm(across, dim=1)
        sine = turned / torch.linalg.vector_norm(along, dim=1)
        normal = across / turned.clamp(min=1e-30)[:, None]
        value, pdf = tracer.value(piece, rows, d)
        weight = sine / (r * r) * chosen.inverse[mine] * share
        beta = piece.vertices.paths.beta.detach()[rows] * piece.weight[rows, None]
        carried = beta * value * weight[:, None]
        good = (r > 0) & (turned > 0) & torch.isfinite(carried).all(1) & (carried != 0).any(1)
        keep = good.nonzero()[:, 0]
    if not len(keep):
        return []
    mine, rows, s, b, r, normal = mine[keep], rows[keep], s[keep], b[keep], r[keep], normal[keep]
    carried, pdf, front = carried[keep], pdf[keep], point.front[mine]
    paths = piece.vertices.paths[rows]
    with torch.no_grad():
        ng, lane = paths.normal.detach(), paths.lane
        rim = RIM * point.rim[mine]
        both = [scene.beside(s, ng, b, normal * sign, point.room[mine], rim * (front == sign)) for sign in (-1.0, 1.0)]
        rays = Rays(*(torch.cat([getattr(x, n) for x in both]) for n in Rays._fields))
        hits = find_hits(scene.call.native, world.plain, rays.origins, rays.directions, rays.tmax)
        # something is before the outline: on its free side, since a sphere is met before its contour on the other
        free_side = torch.cat([front >= 0, front <= 0])
        blocked = hits.valid & free_side & (hits.t < r.repeat(2) * (1 - 1e-3))
        near = is_crease_seen(front.repeat(2), r.repeat(2), hits.t)
        free = (~blocked & near).view(2, -1).all(0)
        keep = free.nonzero()[:, 0]
    if not len(keep):
        return []
    two = torch.cat([keep, keep + len(r)])
    with torch.no_grad():
        rays = Rays(*(x[two] for x in rays))
        # what lights find, too, see lights.py: what a smooth vertex, or the camera, sees, and not too close to it
        sight = torch.linalg.vector_norm(paths.position.detach() - paths.previous, dim=1)
        shared = (paths.previous_pdf > 0) & (u[lane, 3] < scene.apart(sight).double())
        density = pdf / in_view if piece.depth == 0 else torch.where(shared, pdf, 0.0)
        density = density[keep]
        keys = key[lane[keep]]
        light = scene.radiance(rays, keys.repeat(2), config, piece.depth + 1, density.repeat(2))[:, :-1]
    b_moving, s_moving = point.position[mine[keep]], paths.position[keep]
    normal, r = normal[keep], r[keep]
    found = []
    at_rest = ((b_moving - s_moving) * normal).sum(1)
    for half, sign in ((slice(0, len(keep)), 1.0), (slice(len(keep), None), -1.0)):
        jump = carried[keep] * light[half] * sign
        rate = at_rest
        shape = hits.shape_id[two[half]].long()
        emits = (hits.valid[two[half]] & (tracer.shape_emitter[shape.clamp_min(0)] >= 0)).nonzero()[:, 0]
        if len(emits):  # glued to the light; what hides something, or is a crease, moves with its own outline
            hit = two[half][emits]
            glued = glue(
                world.surfaces,
                shape[emits],
                hits.prim_id[hit].long(),
                hits.barycentric[hit],
                hits.position[hit],
                hits.uv[hit],
            )
            tau = r[emits] / torch.linalg.vector_norm(hits.position[hit] - s[keep][emits], dim=1)
            moved = b_moving[emits] - (1 - tau)[:, None] * s_moving[emits] - tau[:, None] * glued.position
            rate = rate.index_put((emits,), (moved * normal[emits]).sum(1))
            behind = front[keep][emits] * sign == 1.0
            jump = jump.index_put((emits,), torch.where(behind[:, None], jump[emits], 0.0))
        bright = (jump != 0).any(1).nonzero()[:, 0]
        if len(bright):
            found.append((pad(jump[bright]), rate[bright].double(), place[lane[keep][bright]]))
    return found
