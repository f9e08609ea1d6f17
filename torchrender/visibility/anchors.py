"""Paths from the camera, and the points on them from which outlines are looked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch

from ..scene.camera_rays import Rays
from ..scene.declaration import models
from ..surface import dot
from ..wavefront.bsdfs import BSDFS
from ..wavefront.numbers import Numbers
from ..wavefront.path import Paths, Vertices, WavefrontTracer
from .sampling import Boundary
from .tree import Anchors

# How much of it about a lobe scatters, and the power of its roughness that is the width of the microfacets' slopes.
GLOSSY = {
    "roughconductor": (1.0, 1.0),
    "anisotropicconductor": (1.0, 1.0),
    "roughplastic": (0.5, 1.0),
    "pplastic": (0.5, 1.0),
    "roughdielectric": (0.5, 1.0),
    "anisotropicdielectric": (0.5, 1.0),
    "principled": (0.3, 2.0),
    "principledthin": (0.3, 2.0),
    "redner": (0.5, 0.5),
}


@dataclass
class Piece:
    """Vertices that share a depth and the BSDF of a number."""

    number: int
    depth: int
    vertices: Vertices
    weight: torch.Tensor


class AnchorTracer(WavefrontTracer):
    """Traces paths and keeps their vertices with smooth BSDFs; looks for no light."""

    def __init__(self, scene: Boundary) -> None:
        config = scene.call.config
        super().__init__(scene.world, config, _numbers(scene, {**config, "seed": 0}), derivative=True)
        self.scene = scene
        self.counts = (self.emitter_samples, self.bsdf_samples)
        self.emitter_samples = self.bsdf_samples = 1
        self.pieces: list[Piece] = []

    def start(self, config: dict[str, Any]) -> None:
        """The random numbers of a pass."""
        self.random = _numbers(self.scene, config)

    def _begin(self, key: torch.Tensor, max_depth: int) -> None:
        self.max_depth = max_depth
        self.pixel, self.sample, self.pieces = key & 0xFFFFFFFF, torch.zeros_like(key), []
        self.alpha = torch.zeros(len(key), dtype=self.world.dtype)

    def vertices(self, rays: Rays, key: torch.Tensor, max_depth: int) -> list[Piece]:
        """Of paths that begin with camera rays, up to this number of surfaces and a light."""
        self._begin(key, max_depth)
        paths = self.first_points(rays)
        depth = 0
        while len(paths) and (max_depth < 0 or depth + 1 < max_depth):
            paths = self.vertex(paths, depth, 0, True)
            depth += 1
        return self.pieces

    def escape(self, paths: Paths, depth: int) -> None:
        pass

    def emission(self, paths: Paths, facing: torch.Tensor, depth: int) -> None:
        pass

    def sample_lights(self, vertices: Vertices, number: int, u: torch.Tensor, n_emitter: int, n_bsdf: int) -> None:
        pass

    def scatter(
        self, vertices: Vertices, ue: torch.Tensor, ub: torch.Tensor, number: int, depth: int, index: int
    ) -> list[Paths]:
        kind = BSDFS[self.world.records["bsdf"][number].type]
        if not kind.delta:  # its ray has a direction at rest
            frame = type(vertices.frame)(*(getattr(vertices.frame, a).detach() for a in ("s", "t", "n")))
            vertices = replace(vertices, frame=frame, wi=vertices.wi.detach())
        if kind.smooth:
            beta = (vertices.paths.beta.detach() * (vertices.above.weight * vertices.above.inverse)[:, None]).abs()
            self.pieces.append(Piece(number, depth, vertices, beta.mean(1)))
        if 0 <= self.max_depth <= depth + 2:
            return []
        return super().scatter(vertices, ue, ub, number, depth, index)

    def anchors(self, piece: Piece) -> Anchors:
        """Where outlines are looked for from, and how light is scattered there."""
        v, record = piece.vertices, self.world.records["bsdf"][piece.number]
        with torch.no_grad():
            point = v.paths.position.detach()
            up = torch.zeros_like(point)
            up[:, 2] = 1.0
            normal = v.to_world(up).detach()
            share, k = torch.zeros_like(point[:, 0]), torch.zeros_like(point[:, 0])
            axis = normal
            if record.type in GLOSSY:
                wi = v.to_world(v.wi)
                axis = normal * (2 * dot(normal, wi))[:, None] - wi
                part, power = GLOSSY[record.type]
                alpha = self._roughness(record, v) ** power
                k, share = 0.5 / (alpha * alpha).clamp(min=1e-6), torch.full_like(share, part)
            if record.type == "torch" or "transmits" in models()["bsdf", record.type].flags:
                normal = torch.zeros_like(normal)
            return Anchors(point, normal, axis, k, share, v.paths.shape.to(k))

    def _roughness(self, record: Any, v: Vertices) -> torch.Tensor:
        found = []
        for field in models()["bsdf", record.type].fields:
            if field.name in ("alpha", "alpha_u", "alpha_v", "roughness"):
                if field.kind == "float":
                    value = self.world.tensor("bsdf", record, field.name).reshape(1, 1)
                else:
                    value = self.world.look_up("bsdf", record, field.name, v.paths.at)
                found.append(value.detach().expand(len(v), -1).mean(1))
        return torch.stack(found).amax(0).clamp(min=1e-3) if found else torch.full((len(v),), 0.3, dtype=v.wi.dtype)

    def value(self, piece: Piece, rows: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """BSDF times cosine (M, C) of those vertices towards directions (M, 3), with all factors; and its density."""
        with torch.no_grad():
            v = piece.vertices[rows]
            wo = v.to_local(d)
            bsdf = self.bsdf(piece.number, v)
            lobe = torch.zeros(len(rows), dtype=torch.int64)
            value = bsdf.eval(v.wi, wo, lobe) * (v.above.weight * v.above.dimmed(d) * v.above.inverse)[:, None]
            pdf = bsdf.pdf(v.wi, wo)
            usable = v.sees(d) & torch.isfinite(value).all(1) & (pdf > 0)
            return torch.where(usable[:, None], value, 0.0).detach(), torch.where(usable, pdf, 0.0).detach()

    def seen_from(
        self,
        piece: Piece,
        rows: torch.Tensor,
        c: torch.Tensor,
        f: torch.Tensor,
        factor: torch.Tensor,
        key: torch.Tensor,
    ) -> list[Piece]:
        """The vertices that those of a piece see in directions c (M, 3); throughputs get f (M, C) times factor (M,)."""
        v = piece.vertices[rows]
        self._begin(key, piece.depth + 3)
        went_on = {"survival": v.paths.survival, "eta": v.paths.eta, "previous_pdf": torch.ones_like(factor)}
        lobe, all_ = torch.zeros(len(rows), dtype=torch.int64), torch.arange(len(rows))
        paths = self.go_on(piece.number, v, v.to_local(c), lobe, f, factor, True, went_on, all_)
        self.vertex(paths, piece.depth + 1, 0, True)
        return self.pieces


def _numbers(scene: Boundary, config: dict[str, Any]) -> Numbers:
    return Numbers(config["sampler"], 1 << 20, config["seed"], config["sensor"], scene.real)


def one_of_path(pieces: list[Piece], u: torch.Tensor, n: int) -> list[Piece]:
    """One vertex of each path of those in the pieces, in proportion to its weight; weights are then 1 / probability."""
    total = torch.zeros(n, dtype=torch.float64)
    for p in pieces:
        total.index_add_(0, p.vertices.paths.lane, p.weight.double())
    before, found = torch.zeros(n, dtype=torch.float64), []
    for p in pieces:
        lane, weight = p.vertices.paths.lane, p.weight.double()
        low = before[lane]
        before.index_add_(0, lane, weight)
        at = u[lane] * total[lane]
        rows = ((weight > 0) & (at >= low) & (at < low + weight)).nonzero()[:, 0]
        found.append(Piece(p.number, p.depth, p.vertices[rows], (total[lane] / weight)[rows]))
    return found
