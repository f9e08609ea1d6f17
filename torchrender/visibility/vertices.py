"""Outlines that points on surfaces see: where the light that they scatter ends to be visible, and begins.

At a vertex S of a path, which has the throughput beta, light comes from everywhere; past an outline's point B there is
one thing on the one side and another on the other. With the unit direction d to B, at the distance r,

    dI = beta  integral of f(d) sin / r^2  (L_minus v_minus - L_plus v_plus)  dl

where v = n.(dB - (1 - tau) dS - tau dE) for a point E that is glued to what emits, tau = r / |E - S|, and n.(dB - dS)
for all else, which is looked up along a direction at rest: see docs/theory/motion.md.
"""

from __future__ import annotations

import torch

from ..queries import find_hits
from ..scene.camera_rays import Rays
from ..wavefront.geometry import glue
from .anchors import AnchorTracer, Piece, one_of_path
from .choice import Choice, Chosen
from .lights import pad
from .sampling import RIM, Boundary, Chunk, Found, Samples, across, both_sides, is_open, joined
from .tree import Anchors

STREAM = 0x7665727478


def outlines_before_surfaces(scene: Boundary, choice: Choice, tracer: AnchorTracer, in_view: float) -> Samples:
    """Samples of outlines that points on paths see, see :func:`.boundary.samples`.

    `in_view` is the share of the lights' outlines that the camera sees, see lights.py.
    """
    for chunk in scene.chunks(STREAM, 4):
        yield from joined(_Reflections(scene, tracer, chunk, in_view).draw(choice))


class _Reflections:
    """What one vertex of each path of a chunk sees on both sides of an outline's point."""

    def __init__(self, scene: Boundary, tracer: AnchorTracer, chunk: Chunk, in_view: float) -> None:
        self.scene, self.tracer, self.chunk, self.in_view = scene, tracer, chunk, in_view

    def draw(self, choice: Choice) -> list[Found]:
        chunk, real = self.chunk, self.scene.real
        self.tracer.start(chunk.config)
        rays = self.scene.rays(chunk.place.to(real), chunk.u[:, :2].to(real))
        pieces = self.tracer.vertices(rays, chunk.key, chunk.config["max_depth"])
        pieces = [p for p in one_of_path(pieces, chunk.u[:, 2], len(chunk.key)) if len(p.vertices)]
        if not pieces:
            return []
        chosen = choice.draw(Anchors.cat([self.tracer.anchors(p) for p in pieces]), chunk.seed)
        first, found = 0, []
        for piece in pieces:
            end = first + len(piece.vertices)
            mine = ((chosen.rows >= first) & (chosen.rows < end)).nonzero()[:, 0]
            if len(mine):
                found += self._behind(piece, chosen, mine, chosen.rows[mine] - first)
            first = end
        return found

    def _behind(self, piece: Piece, chosen: Chosen, mine: torch.Tensor, rows: torch.Tensor) -> list[Found]:
        """Of a piece's vertices of these rows, before the chosen points `mine`."""
        scene, tracer, chunk, point = self.scene, self.tracer, self.chunk, chosen.point
        with torch.no_grad():
            s = piece.vertices.paths.position.detach()[rows]
            b, along = point.position.detach()[mine], point.along[mine]
            towards = b - s
            r = torch.linalg.vector_norm(towards, dim=1)
            d = towards / r.clamp(min=1e-30)[:, None]
            normal, turned = across(d, along)
            value, pdf = tracer.value(piece, rows, d)
            sine = turned / torch.linalg.vector_norm(along, dim=1)
            weight = sine / (r * r) * chosen.inverse[mine] * (chunk.cells / chunk.total)
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
            ng, lane, room, rim = paths.normal.detach(), paths.lane, point.room[mine], RIM * point.rim[mine]
            rays = both_sides(lambda sign: scene.beside(s, ng, b, normal * sign, room, rim * (front == sign)))
            hits = find_hits(scene.call.native, scene.world.plain, *rays)
            keep = is_open(front, r, hits.t, 1e-3).nonzero()[:, 0]
        if not len(keep):
            return []
        two = torch.cat([keep, keep + len(r)])
        with torch.no_grad():
            # what lights find, too, see lights.py: what a smooth vertex, or the camera, sees, and not too close to it
            sight = torch.linalg.vector_norm(paths.position.detach() - paths.previous, dim=1)
            shared = (paths.previous_pdf > 0) & (chunk.u[lane, 3] < scene.apart(sight).double())
            density = pdf / self.in_view if piece.depth == 0 else torch.where(shared, pdf, 0.0)
            beside, keys = Rays(*(x[two] for x in rays)), chunk.key[lane[keep]].repeat(2)
            light = scene.radiance(beside, keys, chunk.config, piece.depth + 1, density[keep].repeat(2))[:, :-1]
        place, b_moving, s_moving = chunk.place[lane[keep]], point.position[mine[keep]], paths.position[keep]
        carried, normal, r, front, s = carried[keep], normal[keep], r[keep], front[keep], s[keep]
        at_rest, found = ((b_moving - s_moving) * normal).sum(1), []
        for half, sign in ((slice(0, len(keep)), 1.0), (slice(len(keep), None), -1.0)):
            jump, rate, on = carried * light[half] * sign, at_rest, two[half]
            shape = hits.shape_id[on].long()
            emits = (hits.valid[on] & (tracer.shape_emitter[shape.clamp_min(0)] >= 0)).nonzero()[:, 0]
            if len(emits):  # glued to the light; what hides something, or is a crease, moves with its own outline
                hit = on[emits]
                position, prim = hits.position[hit], hits.prim_id[hit].long()
                glued = glue(scene.world.surfaces, shape[emits], prim, hits.barycentric[hit], position, hits.uv[hit])
                tau = (r[emits] / torch.linalg.vector_norm(position - s[emits], dim=1))[:, None]
                moved = b_moving[emits] - (1 - tau) * s_moving[emits] - tau * glued.position
                rate = rate.index_put((emits,), (moved * normal[emits]).sum(1))
                behind = front[emits] * sign == 1.0
                jump = jump.index_put((emits,), torch.where(behind[:, None], jump[emits], 0.0))
            bright = (jump != 0).any(1).nonzero()[:, 0]
            if len(bright):
                found.append((pad(jump[bright]), rate[bright].double(), place[bright]))
        return found
