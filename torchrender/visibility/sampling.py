"""Samples of all outlines, and what the three ways to find them have in common."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from ..render_call import RenderCall
from ..scene.camera_rays import Rays
from ..scene.declaration import models
from ..scene.packing import Layout
from ..scene.scene import Scene
from ..seeds import mix
from ..wavefront.path import offset_origin
from ..wavefront.world import World
from .film_places import film_places
from .film_sums import FilmPlaces
from .outlines import Outlines

STREAM = 0x766973  # tells the seed of outlines from those of paths
CHUNK = 1 << 13  # samples at a time: in the cache
PLACING = ("transform", "float", "point", "tensor")  # kinds of fields that may place something
RIM = 1.05  # how far beyond the rim of interpolated normals, in widths of it
NEAR = 0.02  # what is close, in sizes of the scene

Found = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
Samples = Iterator[Found]


@dataclass
class BoundaryCall:
    """The boundary term of one rendering.

    `spp` samples a wanted pixel of outlines that the camera sees, and of those that points on surfaces see; `moves`
    says which shapes may move, all if the camera does. With `by_length` short outlines get fewer samples.
    """

    call: RenderCall
    scene: Scene
    spp: tuple[int, int]
    moves: torch.Tensor
    by_length: bool


@dataclass
class Chunk:
    """N of `total` samples: a pass's settings, keys, numbers u (N, K), a seed, and places on a number of `cells`."""

    config: dict[str, Any]
    key: torch.Tensor
    u: torch.Tensor
    seed: int
    place: torch.Tensor
    total: int
    cells: int


class Boundary:
    """A scene with its outlines, as one camera sees it."""

    def __init__(self, boundary: BoundaryCall, params: Sequence[torch.Tensor], film: FilmPlaces, threads: int) -> None:
        call = boundary.call
        self.given, self.call, self.film, self.threads = boundary, call, film, threads
        self.sensor, self.size = call.config["sensor"], call.config["film_size"]
        self.world = World(boundary.scene, call.layout, call.native, _placing(call, params), moving=True)
        self.record = self.world.records["sensor"][self.sensor]
        key, known = call.layout.index_key(), call.layout.edges
        table = known[1] if known is not None and known[0] == key else None
        self.outlines = Outlines(self.world.surfaces, table, boundary.moves)
        if self.outlines.table is not table:
            call.layout.edges = (key, self.outlines.table)
        self.real = self.world.dtype
        box = call.native.handle.bounding_box()
        self.near = NEAR * math.dist(box[:3], box[3:])

    def begin(self) -> None:
        """Before every chunk: what is attached to the parameters once more."""
        self.world.begin()
        self.outlines.surfaces = self.world.surfaces

    def configs(self, stream: int) -> Iterator[tuple[int, dict[str, Any], torch.Generator]]:
        """Number, settings and random numbers of each pass."""
        for number, config in enumerate(self.call.configs(derivative=True)):
            seed = mix(config["seed"], stream)
            yield number, {**config, "seed": seed, "threads": self.threads}, torch.Generator().manual_seed(seed >> 1)

    def chunks(self, stream: int, numbers: int) -> Iterator[Chunk]:
        """The samples of shadows and reflections, by places on the film, with so many random numbers besides."""
        cells = self.film.cells(self.call.config["window"])
        count = self.given.spp[1] * len(cells)
        for number, config, generator in self.configs(stream):
            for begin in range(0, count, CHUNK):
                at = torch.arange(begin, min(begin + CHUNK, count), dtype=torch.int64)
                u = torch.rand(len(at), 2 + numbers, generator=generator, dtype=torch.float64)
                seed = int(torch.randint(0, 1 << 62, (), generator=generator))
                place = cells[at % len(cells)] + u[:, :2]
                total = count * self.call.passes
                yield Chunk(config, at + number * count, u[:, 2:], seed, place, total, len(cells))
                self.begin()

    def places(self, points: torch.Tensor, lens: torch.Tensor) -> torch.Tensor:
        return film_places(self.world, self.sensor, self.size, points.detach(), lens)

    def rays(self, place: torch.Tensor, lens: torch.Tensor) -> Rays:
        return self.world.camera_rays(self.sensor, self.size, place, lens)

    def pixel_area(
        self, place: torch.Tensor, lens: torch.Tensor, direction: torch.Tensor, distance: torch.Tensor
    ) -> torch.Tensor:
        """Area perpendicular to the ray in that direction, at that distance, of what a pixel sees."""
        step = 0.05
        columns = []
        for x, y in ((step, 0.0), (0.0, step)):
            move = place.new_tensor([x, y])
            plus, minus = (self.rays(place + m, lens) for m in (move, -move))
            ends = [r.origins + r.directions * distance[:, None] for r in (plus, minus)]
            columns.append((ends[0] - ends[1]) / (2 * step))
        area = torch.linalg.cross(columns[0], columns[1])
        return (area * direction).sum(1).abs()

    def radiance(
        self,
        rays: Rays,
        key: torch.Tensor,
        config: dict[str, Any],
        depth: int = 0,
        pdf: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Radiance and alpha (N, C + 1) along rays, `depth` vertices of whose paths are behind them.

        `pdf` (N,) is the density with which their directions are sampled beside lights; without it, or 0, they alone
        are to find the light.
        """
        o, d, reach = (t.detach().contiguous() for t in rays)
        keys = (key & 0xFFFFFFFF).to(torch.uint32).contiguous()
        n, native = len(o), self.call.native
        density = torch.zeros(n, dtype=native.dtype) if pdf is None else pdf.detach().contiguous()
        image, alpha = (torch.empty(n, c, dtype=native.dtype) for c in (native.channels, 1))
        addresses = [t.data_ptr() for t in (o, d, reach, density, keys)]
        out = {"image": image.data_ptr(), "alpha": alpha.data_ptr()}
        native.call("render_rays", self.world.plain, config, n, addresses, depth, out)
        values = torch.cat([image, alpha], 1)
        return torch.where(torch.isfinite(values), values, torch.zeros_like(values))

    def beside(
        self,
        origin: torch.Tensor,
        normal: torch.Tensor,
        b: torch.Tensor,
        across: torch.Tensor,
        room: torch.Tensor,
        rim: torch.Tensor | float = 0.0,
    ) -> Rays:
        """Rays from points (of surfaces with these normals, or 0) past an outline's points b, a little beside them.

        Args:
            across: (N, 3) unit vectors to which side. room: see `OutlinePoints`. rim: (N,) how far further.
        """
        distance = torch.linalg.vector_norm(b - origin, dim=1)
        side = torch.maximum(torch.minimum(distance * 2.0**-17, room / 8), least_side(b, distance))
        at = b + across * (side + rim)[:, None]
        d = torch.nn.functional.normalize(at - origin, dim=1)
        o = offset_origin(origin, normal, d)
        d = torch.nn.functional.normalize(at - o, dim=1)
        return Rays(o, d, torch.full_like(distance, math.inf))

    def apart(self, distance: torch.Tensor) -> torch.Tensor:
        """Of points at a distance, the share, in [0, 1), of what the one gets from the other that lights find."""
        square = distance * distance
        return square / (square + self.near * self.near)


def least_side(b: torch.Tensor, distance: torch.Tensor | float) -> torch.Tensor:
    """How far beside points (N, 3) rays that begin at a distance can be told apart from those to the points.

    Whatever the scene's type: rays are traced in single precision.
    """
    return 8 * 2.0**-24 * (b.abs().amax(1) + distance)


def across(d: torch.Tensor, along: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Unit normals (N, 3) of outlines across rays along d; (N,) sines between both times the length of `along`."""
    n = torch.linalg.cross(d, along)
    turned = torch.linalg.vector_norm(n, dim=1)
    return n / turned.clamp(min=1e-30)[:, None], turned


def is_open(front: torch.Tensor, distance: torch.Tensor, t: torch.Tensor, tolerance: float) -> torch.Tensor:
    """Whether nothing is before outlines (N,), as rays (2 N,) see it that meet something at t, first on the side of -n.

    On the free side alone, since a sphere is met before its contour on the other. Beside creases (`front` is 0) rays
    have to meet the crease's own faces: where one goes on its face is narrower than what rays can tell apart, and the
    jump is another outline's.
    """
    two, free = distance.repeat(2), torch.cat([front >= 0, front <= 0])
    before = free & (t < two * (1 - tolerance))
    met = (front.repeat(2) != 0) | ((t - two).abs() < 5e-3 * two)
    return (~before & met).view(2, -1).all(0)


def both_sides(rays: Callable[[float], Rays]) -> Rays:
    """Those on the side of -n, then those of n."""
    minus, plus = rays(-1.0), rays(1.0)
    return Rays(*(torch.cat([a, b]) for a, b in zip(minus, plus, strict=True)))


def placing_slots(layout: Layout, category: str) -> list[tuple[str, list[int]]]:
    """The types of all objects of a category, and the slots of what may place them."""
    found = []
    for kind, numbers, _ in layout.objects[category]:
        fields = models()[category, kind].fields
        slots = [n for n, f in zip(numbers, fields, strict=True) if f.kind in PLACING and n >= 0]
        found.append((kind, slots))
    return found


def _placing(call: RenderCall, params: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    """The tensors, those detached that place neither shapes nor cameras nor lights."""
    categories = ("shape", "sensor", "emitter")
    kept = {slot for c in categories for _, slots in placing_slots(call.layout, c) for slot in slots}
    return [p if i in kept else p.detach() for i, p in enumerate(params)]


def joined(found: list[Found]) -> Samples:
    """All of them as one, since they share a graph."""
    if found:
        yield torch.cat([f[0] for f in found]), torch.cat([f[1] for f in found]), torch.cat([f[2] for f in found])
