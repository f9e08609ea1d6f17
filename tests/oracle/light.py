"""Light tracing: csrc/core/integrator/particle.h and csrc/cpu/particle_tile.h, for one lamp that is a rectangle.

What is attached. A beam is an attached function of its rectangle, and so is what it hits, through chains of delta
lobes. The point that light of an area lamp meets is glued to its surface. A place on the film is an attached function
of the point that is seen there, or of its texture coordinates. Paths end at smooth vertices: nothing that these light
up may be seen within the depth that is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

import torchrender as tr
from torchrender.scene.film import Film
from torchrender.surface import dot, normalize
from torchrender.warp import cosine_hemisphere
from torchrender.wavefront import layers, numbers
from torchrender.wavefront.cells import LightCells
from torchrender.wavefront.cells import barycentric as corners_of
from torchrender.wavefront.film import filter_weight
from torchrender.wavefront.geometry import Frame, Glued, glue, reattach
from torchrender.wavefront.layers import BsdfStack
from torchrender.wavefront.path import offset_origin
from torchrender.wavefront.world import At

from .bsdf import MODELS
from .bsdf.common import fresnel_dielectric
from .bsdf.hair import Hair
from .bsdf.smooth import Dielectric
from .film import numbers_of, splat
from .world import World

EMISSION_BLOCK = 1


class LightDielectric(Dielectric):
    """As light sees it: flux is not compressed."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        eta_ti = fresnel_dielectric(wi[:, 2], self.eta)[3]
        expanded = torch.where(lobe == 0, 1.0, 1 / eta_ti**2)[:, None]
        return super().eval(wi, wo, lobe) * expanded


class LightHair(Hair):
    """As light sees it, which arrives along wi: radiance the other way. Lobes are sampled evenly around the fibre."""

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        return super().eval(wo, wi, lobe) * (wo[:, 2:] / wi[:, 2:]).abs()


AS_LIGHT_SEES_THEM = {"dielectric": LightDielectric, "hair": LightHair}


class PinholeView:
    """Where on the film points are seen, and the importance of light that leaves them for the camera."""

    def __init__(self, world: World, index: int) -> None:
        record, film = world.records["sensor"][index], world.scene.sensors[index].film

        def get(name: str) -> torch.Tensor:
            return world.tensor("sensor", record, name)

        self.width, self.height = film.width, film.height
        matrix = get("to_world")
        self.linear, self.origin = matrix[:3, :3], matrix[:3, 3]
        self.slope = torch.tan(torch.deg2rad(get("x_fov")) / 2)
        self.rise = self.slope * get("pixel_aspect") * (film.height / film.width)
        self.shift = get("principal_point_offset_x"), get("principal_point_offset_y")
        self.near, self.far = get("near_clip").detach(), get("far_clip").detach()

    def connect(self, p: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Direction to the pinhole (N, 3), clear length, x and y in pixels, importance; false where not in view."""
        y = p - self.origin
        q = torch.linalg.solve(self.linear, y.T).T
        distance = torch.linalg.vector_norm(y, dim=1)
        z = torch.where(q[:, 2] > 0, q[:, 2], 1.0)
        x_film = ((1 - q[:, 0] / (z * self.slope)) / 2 - self.shift[0]) * self.width
        y_film = ((1 - q[:, 1] / (z * self.rise)) / 2 - self.shift[1]) * self.height
        pixels = self.width * self.height / (4 * self.slope * self.rise * torch.linalg.det(self.linear).abs())
        seen = (q[:, 2] > self.near) & (q[:, 2] < self.far)
        clear = distance * (1 - self.near / z)
        return -y / distance[:, None], clear, x_film, y_film, distance / z**3 * pixels, seen


def correction(wi: torch.Tensor, wo: torch.Tensor, ns: torch.Tensor, ng: torch.Tensor) -> torch.Tensor:
    """Veach 1997, section 5.3.2; 1 where the normals are equal."""
    return (dot(wi, ns) * dot(wo, ng) / (dot(wi, ng) * dot(wo, ns))).abs()


def developed(film: Film, x: torch.Tensor, y: torch.Tensor, values: torch.Tensor, measured: bool) -> torch.Tensor:
    """Sums of values (N, C) times filter weights, over the integral of the filter, (H, W, C)."""
    rows, columns = (_integrals(film, n, measured) for n in (film.height, film.width))
    return splat(film, x, y, values)[0] / (rows[:, None] * columns)[..., None]


def _integrals(film: Film, size: int, measured: bool) -> torch.Tensor:
    """Of the filter of each of `size` pixels over the whole line, or over the film alone; by a fine midpoint rule."""
    fine, margin = 20000, 0 if measured else math.ceil(film.filter.reach) + 1
    if film.filter.type == "box":
        return torch.ones(size, dtype=torch.float64)
    x = (torch.arange(fine * (size + 2 * margin), dtype=torch.float64) + 0.5) / fine - margin
    return torch.stack([filter_weight(film.filter, x - (i + 0.5)).sum() / fine for i in range(size)])


def render(
    scene: tr.Scene,
    *,
    seed: int,
    spp: int,
    max_depth: int,
    params: Mapping[str, torch.Tensor] | None = None,
    derivative: bool = False,
) -> torch.Tensor:
    """Image (H, W, C), attached to the scene's parameters and to `params`. Without roulette; the lamp is not seen.

    With `derivative`, paths are those of the native derivative with respect to all weights of blends and masks.
    """
    world, film = World(scene, params), scene.sensors[0].film
    (emitter,) = world.records["emitter"]
    lamp = next(i for i, s in enumerate(world.records["shape"]) if s.field["emitter"] == 0)
    measured = world.records["sensor"][0].type == "irradiancemeter"
    meter = world.records["sensor"][0].field["shape"] if measured else -1
    view = None if measured else PinholeView(world, 0)
    grid = (torch.arange(n) for n in (film.height, film.width, spp))
    row, column, sample = (t.flatten() for t in torch.meshgrid(*grid, indexing="ij"))
    pixel = ((row + 32768) << 16) | (column + 32768)
    n = len(pixel)

    random = numbers_of(scene, spp, seed, 0)
    u, v = (random.block(pixel, sample, block) for block in (numbers.CAMERA_BLOCK, EMISSION_BLOCK))
    a, b = (column + u[:, 0]) / film.width, (row + u[:, 1]) / film.height
    square, cells = torch.stack([a, b], 1), LightCells.of(world, lamp, emitter.field["radiance"])
    density = torch.ones(n, dtype=torch.float64)
    if cells is not None:
        square, density = cells.sample(square)
    primitive, barycentric = corners_of(square)  # the rectangle's two triangles, which the square fills
    shape, none = torch.full((n,), lamp), torch.zeros(n, 3, dtype=torch.float64)
    start = glue(world.surfaces, shape, primitive, barycentric, none, none[:, :2])
    area = torch.linalg.vector_norm(start.area, dim=1)  # of the rectangle, twice that of a triangle
    beta = world.color("emitter", emitter, "radiance", At(shape, primitive, barycentric, start.uv)) / density[:, None]
    beam = emitter.type == "directionalarea"
    if beam:
        d, beta = start.normal, beta * area[:, None]
    else:
        d = Frame.about(start.normal.detach()).to_world(cosine_hemisphere(v[:, 1], v[:, 2]))
        beta = beta * (math.pi * area.detach())[:, None]
    p, normal = start.position, start.normal
    places: list[tuple[torch.Tensor, ...]] = []
    lane, depth = torch.arange(n), 0
    glued = not beam  # whether the next hit is
    bsdf_of = world.shape_field("bsdf")
    needs_grad = torch.full((len(world.records["bsdf"]),), derivative)
    while len(lane) and depth + 2 <= max_depth:
        o = offset_origin(p.detach(), normal.detach(), d.detach())
        hits = world.intersect(o if glued else reattach(o, p), d.detach() if glued else d)
        position, ng, ns, uv = hits.position, hits.normal, hits.shading_normal, hits.uv
        shape, primitive = hits.shape_id.long(), hits.prim_id.long()
        rows = hits.valid.nonzero()[:, 0]
        at = glue(
            world.surfaces, shape[rows], primitive[rows], hits.barycentric[rows], hits.position[rows], hits.uv[rows]
        )
        if glued:
            beta = beta[rows] * _transfer(start[rows], at)[:, None]
            position, ng, ns, uv = (
                reattach(old[rows], new)
                for old, new in ((position, at.position), (ng, at.normal), (ns, at.shading_normal), (uv, at.uv))
            )
            d = reattach(d[rows], normalize(at.position - p[rows]))
        else:
            beta, position, ng, ns, uv, d = (t[rows] for t in (beta, position, ng, ns, uv, d))
        shape, primitive, lane = shape[rows], primitive[rows], lane[rows]
        here = At(shape, primitive, hits.barycentric[rows].detach(), uv)
        if measured:
            seen = ((shape == meter) & (dot(ng, d) < 0)).nonzero()[:, 0]
            texels = film.width * film.height / torch.linalg.vector_norm(at.area[seen], dim=1)
            places.append((uv[seen, 0] * film.width, uv[seen, 1] * film.height, beta[seen] * texels[:, None]))
        chains = []
        block = numbers.BSDF_BLOCK + numbers.BLOCKS_PER_SCATTERING * depth
        u = random.block(pixel[lane], sample[lane], block)
        found = layers.resolve(
            world, bsdf_of[shape], here, position, ns, d, u[:, 3], viewed=False, needs_grad=needs_grad
        )
        for number in found.resolved.unique().tolist():
            chosen = (found.resolved == number).nonzero()[:, 0]
            record = world.records["bsdf"][number]
            kind = AS_LIGHT_SEES_THEM.get(record.type, MODELS[record.type])
            bsdf = kind(world, record, here[chosen])
            above = found[chosen]
            x, g, w = (t[chosen] for t in (position, ng, -d))
            frame = layers.frames(world, above, here[chosen], x)
            flip = torch.where(above.mirrored[:, None], x.new_tensor([1, 1, -1]), x.new_tensor([1, 1, 1]))
            wi = frame.to_local(w) * flip
            brought = beta[chosen] * (above.weight * above.inverse * above.dimmed(w))[:, None]
            if bsdf.smooth:
                if view is not None:
                    places.append(_seen(world, view, bsdf, frame, flip, x, w, above, g, brought))
                continue
            taken = bsdf.sample(wi, u[chosen])
            out = normalize(frame.to_world(taken.wo * flip))
            weight = correction(w, out, above.normal, g) / taken.pdf
            weight = bsdf.eval(wi, taken.wo, taken.lobe) * weight[:, None]
            alive = (taken.pdf > 0) & ~above.hides(w) & ~above.hides(out)
            chains.append((chosen[alive], out[alive], (brought * weight)[alive]))
        depth, glued = depth + 1, False
        if not chains:
            break
        order, d, beta = (torch.cat(columns) for columns in zip(*chains))
        p, normal, lane = position[order], ng[order], lane[order]
    if not places:
        return torch.zeros(film.height, film.width, world.channels, dtype=torch.float64)
    x, y, values = (torch.cat(columns) for columns in zip(*places))
    return developed(film, x, y, values, measured) / (spp * film.height * film.width)


def _transfer(start: Glued, end: Glued) -> torch.Tensor:
    """|N_0.D| |N_1.D| / |D|^4 over what it was, (R,): light that goes from one glued point to another."""
    towards = end.position - start.position
    value = dot(start.area, towards).abs() * dot(end.area, towards).abs() / dot(towards, towards) ** 2
    return value / value.detach()


def _seen(world, view, bsdf, frame, flip, x, w, above: BsdfStack, g, beta) -> tuple[torch.Tensor, ...]:
    """Places on the film and what is brought there, of points x (N, 3) that light reaches from w."""
    to, clear, column, row, importance, seen = view.connect(x)
    wi, wo = frame.to_local(w) * flip, frame.to_local(to) * flip
    seen = seen & (bsdf.pdf(wi, wo) > 0) & ~above.hides(w) & ~above.hides(to)
    seen = seen & ~world.occluded(offset_origin(x.detach(), g.detach(), to.detach()), to, clear)
    factor = bsdf.eval(wi, wo, torch.zeros(len(x)).long()) * (correction(w, to, above.normal, g) * importance)[:, None]
    rows = seen.nonzero()[:, 0]
    return column[rows], row[rows], (beta * factor)[rows]
