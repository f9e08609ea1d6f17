"""Rays through the medium of a shape: in at its boundary, bent inside, out again."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch

from ..compiling import opaque
from ..errors import RangeWarning, describe, nearest
from ..functions import refuse_batches
from ..queries import _rays, find_hits
from ..scene.bending_field import reference_index
from ..scene.gather import gather
from ..scene.host_memory import results_at_the_scene
from ..scene.native import NativeScene
from ..scene.packing import Layout, Record, bending_boundary, record
from ..scene.scene import Scene
from ..scene.spectral.core_values import for_core
from ..surface import OFFSET, SurfacePoints, Surfaces, dot, inverse_linear, normalize, transform_vector
from .blocks import Known, in_blocks
from .flights import TOO_FAR, TOO_LONG, Bending, Field, Flights
from .light import Light

INACCURATE = 0.01  # |p| / n - 1, which is 0 for exact rays
_LOST = {
    TOO_LONG: "took more than max_steps steps, and are not valid",
    TOO_FAR: "went further beyond the grid than it is long, and are not valid: is the shape closed?",
}


class BentRays(NamedTuple):
    """Where rays come out of a medium, or to a surface in it; 0 in rows that are not valid.

    `position`, `direction` (N, 3): in the world, the direction of unit length, behind the boundary if that is where the
    ray has come to. `optical_path`, `length` (N,): the integrals of n and of 1 over the way in the medium, in the
    world's units. `transmittance` (N, C) of that way, and `emission` (N, C): radiance over n^2 that the medium sends
    back along it, at its beginning; C is 1 where the medium has no colours. `index` (N,): n at its end. `steps` (N,)
    int32. `shape_id` (N,) int32: the shape at the end. `valid` (N,) bool: the ray went into the medium and came out of
    it, or met a surface in it.
    """

    position: torch.Tensor
    direction: torch.Tensor
    optical_path: torch.Tensor
    length: torch.Tensor
    transmittance: torch.Tensor
    emission: torch.Tensor
    index: torch.Tensor
    steps: torch.Tensor
    shape_id: torch.Tensor
    valid: torch.Tensor


@opaque
@results_at_the_scene
def trace(
    scene: Scene,
    shape: str,
    origins: Any,
    directions: Any,
    *,
    params: Mapping[str, torch.Tensor] | None = None,
) -> BentRays:
    """Follow rays through the medium of a shape, whose index of refraction varies.

    A ray begins outside, and the first thing it meets is the shape; or it begins inside, with nothing but the shape
    straight ahead. It is refracted where it goes in (unless the boundary is `null`), bent by the medium, and refracted
    where it comes out, by the vertex normals of a mesh that has them. It ends there, or at the first surface inside.
    Rays that are totally reflected, at either end, are not valid.

    How two rays become a spot::

        rays = tr.gradientindex.trace(scene, "ball", origins, directions)
        loss = (rays.position[rays.valid] - target).square().sum(1).mean()

    The rays are those of a numerical solution (velocity Verlet with steps of about a voxel), and derivatives are those
    of exactly this solution, in memory that does not grow with the number of steps: by rays, `index`, `index_base`,
    `index_scale`, `to_world`, `ext_ior`, `sigma_t`, `emission`, `scale`, and by the shapes where rays go in and out; in
    reverse and forward mode, once. The length of steps, which follows `to_world` and the largest index, counts as
    constant. At corners of the boundary, where a ray changes from one face to another, rays jump.

    Args:
        scene: where.
        shape: the name of a shape whose `interior` is a `gradientindex` medium and whose BSDF is `null` or
            `dielectric`.
        origins, directions: (N, 3), world space, array-like; directions need not be normalised.
        params: tensors that replace parameters of these names in this call, as in `render`.

    Returns:
        A named tuple of tensors, see `BentRays`.

    Raises:
        TypeError, ValueError: before any work, naming the argument, what was expected and what came.

    Warns:
        RangeWarning: for rays that took more than `max_steps`, that went further beyond the grid than it is long, and
            where steps are too long for how fast the index changes.
    """
    scene, origins, directions, _ = _rays("gradientindex.trace", scene, origins, directions, None)
    layout = scene.layout()
    tensors = for_core(scene, layout, gather(scene, layout, params, "gradientindex.trace"))
    for tensor in (origins, directions, *tensors):
        refuse_batches(tensor)
    row = _row_of(layout, shape)
    medium = _Medium.of(layout, tensors, row, shape)
    native = scene.native(layout, [tuple(t.shape) for t in tensors])
    rays = _Rays(scene, layout, native, row, shape, medium.step)
    found = in_blocks(rays.follow, medium.slot, origins, directions, tensors)
    rays.warn()
    return BentRays(*found)


@dataclass
class _Rays:
    """What rays through the medium of a shape have in common; and what is to be warned of."""

    scene: Scene
    layout: Layout
    native: NativeScene
    row: int  # of the shape
    shape: str
    step: float
    entered: int = 0
    lost: dict[int, int] = field(default_factory=dict)
    error: float = 0.0  # of |p| / n, at most

    def follow(
        self, origins: torch.Tensor, directions: torch.Tensor, tensors: Sequence[torch.Tensor], known: Known
    ) -> tuple[torch.Tensor, ...]:
        """The fields of `BentRays`."""
        scene, layout, native, tensors, count = self.scene, self.layout, self.native, list(tensors), len(origins)
        medium = _Medium.of(layout, tensors, self.row, self.shape, self.step)
        surfaces = Surfaces.of(scene, layout, tensors)

        # the way in
        towards = normalize(directions.detach())
        first = find_hits(native, tensors, origins, towards, towards.new_full((count,), torch.inf))
        rows = (first.shape_id == self.row).nonzero()[:, 0]
        # after the choice: what is not a direction has derivatives that are no numbers, not zeros
        o, d, towards, shapes, primitives, t, normal = _chosen(
            rows, count, origins, directions, towards, first.shape_id, first.prim_id, first.t, first.normal
        )
        outside = (dot(normal, towards) < 0)[:, None]
        d, q, refracting, offset = _enter(surfaces, medium, o, d, shapes, primitives, t, outside)
        light = Light.of(scene, layout, native, tensors, medium.number)
        bending = medium.bending(native, light.look_up, known)
        value, _ = Field.apply(bending, medium.values, q)
        u, through = medium.refracted(d, refracting, value, outside)

        # through the medium
        plain = [t.detach() for t in (offset, *tensors)]
        grids = light.grids(medium.matrix, medium.origin)
        flights = Flights.apply(bending, medium.values, medium.kick, q, u, *grids, *plain)
        last_q, last_u, sums, depth, emitted, _, steps, hit, primitive, t = flights
        if known.flights is None:
            known.flights = tuple(t.detach() for t in flights)
            self._count(hit, through)
        usable = ((hit >= 0) & through).nonzero()[:, 0]
        ends = (rows, steps, hit, primitive, t, last_q, last_u, sums, depth, emitted)
        rows, steps, hit, primitive, t, last_q, last_u, sums, depth, emitted = _chosen(usable, len(hit), *ends)

        # and out
        position, q, refracting, v, rest, behind = _arrive(surfaces, medium, hit, primitive, last_q, last_u, t)
        value, slope = Field.apply(bending, medium.values, q)
        leaves = (hit == self.row)[:, None]
        *found, free, error = _leave(
            medium, light, position, refracting, v, rest, behind, value, slope, leaves, sums, depth, emitted
        )
        self.error = max(self.error, float(error.amax()) if len(error) else 0.0)
        good = free.nonzero()[:, 0]
        rows, *found = _chosen(good, len(free), rows, position, *found, steps, hit)
        if len(rows) == count:
            return *found, torch.ones(count, dtype=torch.bool)
        valid = torch.zeros(count, dtype=torch.bool)
        valid[rows] = True
        return *(x.new_zeros(count, *x.shape[1:]).index_put((rows,), x) for x in found), valid

    def _count(self, hit: torch.Tensor, through: torch.Tensor) -> None:
        self.entered += len(hit)
        for code in _LOST:
            self.lost[code] = self.lost.get(code, 0) + int(((hit == code) & through).sum())

    def warn(self) -> None:
        for code, text in _LOST.items():
            if count := self.lost.get(code):
                text = f"gradientindex.trace: {count} of {self.entered} rays {text}"
                warnings.warn(text, RangeWarning, stacklevel=4)
        if self.error > INACCURATE:
            text = (
                f"gradientindex.trace: |p| / n, which is 1 along a ray, is off by {self.error:.1%}: the index changes "
                "too fast for steps of this length; make `step` smaller, or the index smoother"
            )
            warnings.warn(text, RangeWarning, stacklevel=4)


def _enter(
    surfaces: Surfaces,
    medium: _Medium,
    o: torch.Tensor,
    d: torch.Tensor,
    shape: torch.Tensor,
    primitive: torch.Tensor,
    t: torch.Tensor,
    outside: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Rays to the boundary, or from inside of it: direction, place in voxels, normal, and where surfaces count from."""
    d = normalize(d)
    entry = surfaces.meet(shape, primitive, o, d, t, coordinates=False)
    x = torch.where(outside, entry.position, o)
    amount = OFFSET * (1 + x.detach().abs().amax(1, True))
    offset = torch.where(outside, -amount * entry.normal.detach(), 0.0)
    return d, medium.to_voxels(x), _refracting(entry), offset


def _arrive(
    surfaces: Surfaces,
    medium: _Medium,
    shape: torch.Tensor,
    primitive: torch.Tensor,
    last_q: torch.Tensor,
    last_u: torch.Tensor,
    t: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """From the last kick to the surface: its place, also in voxels, normal, velocity, what is left of the last kick."""
    v = transform_vector(medium.matrix, last_u)
    end = surfaces.meet(shape, primitive, medium.to_world(last_q), v, t, coordinates=False)
    return end.position, medium.to_voxels(end.position), _refracting(end), v, end.t - 0.5, end.normal.detach()


def _leave(
    medium: _Medium,
    light: Light,
    position: torch.Tensor,
    refracting: torch.Tensor,
    v: torch.Tensor,
    rest: torch.Tensor,
    behind: torch.Tensor,
    value: torch.Tensor,
    slope: torch.Tensor,
    leaves: torch.Tensor,
    sums: torch.Tensor,
    depth: torch.Tensor,
    emitted: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Fields of `BentRays` from the direction to the index, which rays come out, and how far |p| / n is off 1."""
    n = medium.index_of(value)
    v = v + rest[:, None] * transform_vector(medium.inverse.T, slope) * medium.step**2
    sums = sums + rest[:, None] * torch.stack([n * n / 2, n], 1)
    along = normalize(v)
    direction, free = medium.leaving(along, refracting, n, leaves)
    free = free & ((dot(along.detach(), behind) > 0) | ~leaves[:, 0])
    length = sums[:, 1] * medium.step
    brought = light.at_end(position, n, length, rest * medium.step, depth, emitted)
    error = (torch.linalg.vector_norm(v.detach(), dim=1) / (n.detach() * medium.step) - 1).abs()
    return direction, sums[:, 0] * (2 * medium.step), length, *brought, n, free, error


def _chosen(rows: torch.Tensor, count: int, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """These rows of tensors that have `count`; the tensors themselves if that is all of them."""
    return tensors if len(rows) == count else tuple(t[rows] for t in tensors)


@dataclass
class _Medium:
    """A medium in the units of rays: positions in voxels, steps of `step`, in world units of length over index.

    `values` are the spline's control values of Phi = n^2 / 2 but for `constant`; `matrix`, `inverse` (3, 3) and
    `origin` (3,) place the voxels; `kick` is G. `number` is that of the medium, `slot` that of the control values among
    the scene's tensors. `ext_ior` is None for a null boundary.
    """

    values: torch.Tensor
    constant: float
    quadratic: bool
    matrix: torch.Tensor
    inverse: torch.Tensor
    origin: torch.Tensor
    kick: torch.Tensor
    step: float
    number: int
    slot: int
    ext_ior: torch.Tensor | None

    @classmethod
    def of(
        cls, layout: Layout, tensors: list[torch.Tensor], row: int, shape: str, step: float | None = None
    ) -> _Medium:
        """`step`: that of these tensors, if it is known already."""
        number, medium, ext_ior = _medium_of(layout, tensors, row)
        field = medium.field
        values, to_world = tensors[field["index"]], tensors[field["to_world"]]  # as `gather` has them for the core
        constant = reference_index(tensors[field["index_base"]]) ** 2 / 2
        size = [n - 4 for n in reversed(values.shape)]
        matrix = to_world[:3, :3] / to_world.new_tensor(size)
        if step is None:
            largest = float(torch.sqrt(2 * (values.detach().amax() + constant)))
            if not 0 < largest < math.inf:
                raise ValueError(
                    f"gradientindex.trace: {shape}: expected positive indices of refraction, got {largest:g}"
                )
            voxel = float(torch.linalg.vector_norm(matrix.detach(), dim=0).min())
            # rounded up, so that steps hardly ever change in an optimisation
            step = float(tensors[field["step"]]) * voxel / (math.ceil(largest * 16) / 16)
        inverse = inverse_linear(matrix)
        g = step**2 * (inverse[:, None, :] * inverse[None, :, :]).sum(-1)  # sums keep their precision under autocast
        kick = torch.stack([g[0, 0], g[1, 1], g[2, 2], g[0, 1], g[0, 2], g[1, 2]])
        quadratic = field["interpolation"] == 1
        origin, slot = to_world[:3, 3], field["index"]
        return cls(values, constant, quadratic, matrix, inverse, origin, kick, step, number, slot, ext_ior)

    def bending(self, native: NativeScene, look_up: dict[str, tuple[int, int]], known: Known) -> Bending:
        size = self.values.shape[2] - 4, self.values.shape[1] - 4, self.values.shape[0] - 4
        numbers = (self.constant, self.quadratic, self.number, self.step)
        return Bending(native, size, *numbers, look_up, known.flights, known.partials)

    def to_voxels(self, x: torch.Tensor) -> torch.Tensor:
        return transform_vector(self.inverse, x - self.origin)

    def to_world(self, q: torch.Tensor) -> torch.Tensor:
        return transform_vector(self.matrix, q) + self.origin

    def index_of(self, value: torch.Tensor) -> torch.Tensor:
        return torch.sqrt(2 * (value + self.constant))

    def refracted(
        self, d: torch.Tensor, normal: torch.Tensor, value: torch.Tensor, outside: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Velocities of rays in the medium, those from outside refracted; whether there are any."""
        n = self.index_of(value)
        p, possible = d * n[:, None], torch.ones_like(outside[:, 0])
        if self.ext_ior is not None:
            tangential, along, possible = _snell(d, normal, self.ext_ior, n, outside)
            p = torch.where(outside, tangential - normal * along, p)
        return self.step * transform_vector(self.inverse, p), possible

    def leaving(
        self, d: torch.Tensor, normal: torch.Tensor, n: torch.Tensor, leaves: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Directions behind the boundary, for those that come to it; which ones are not totally reflected."""
        if self.ext_ior is None:
            return d, torch.ones_like(leaves[:, 0])
        tangential, along, possible = _snell(d, normal, n[:, None], self.ext_ior, leaves)
        return torch.where(leaves, (tangential + normal * along) / self.ext_ior, d), possible


def _snell(
    d: torch.Tensor, normal: torch.Tensor, before: torch.Tensor, behind: torch.Tensor, wanted: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Snell's law: what is tangential (N, 3) stays, of vectors as long as the index.

    Also what is left along the normal (N, 1), and where there is such a vector or none is `wanted` (N, 1).
    """
    tangential = (d - normal * dot(d, normal)[:, None]) * before
    square = behind**2 - dot(tangential, tangential)
    possible = (square > 0) | ~wanted[:, 0]
    return tangential, torch.sqrt(torch.where(possible & wanted[:, 0], square, 1.0))[:, None], possible


def _refracting(found: SurfacePoints) -> torch.Tensor:
    """Normals (N, 3) by which surfaces refract: those for shading, on the side of the geometric ones."""
    other = dot(found.shading_normal.detach(), found.normal.detach()) < 0
    return torch.where(other[:, None], -found.shading_normal, found.shading_normal)


def _row_of(layout: Layout, shape: Any) -> int:
    names = [name for _, _, name in layout.objects["shape"]]
    if not isinstance(shape, str):
        raise TypeError(f"gradientindex.trace: shape: expected the name of a shape, got {describe(shape)}")
    if shape not in names:
        raise ValueError(f"gradientindex.trace: shape: the scene has no shape {shape!r}; {nearest(shape, names)}")
    return names.index(shape)


def _medium_of(layout: Layout, tensors: list[torch.Tensor], row: int) -> tuple[int, Record, torch.Tensor | None]:
    """The medium inside of a shape and its number; the index outside, None where the boundary is null."""
    shape = record(layout, "shape", row)
    where = f"gradientindex.trace: {shape.path}"
    inside = shape.field.get("interior", -1)
    if inside not in layout.bending:
        found = layout.objects["medium"][inside][0] if inside >= 0 else "none"
        raise ValueError(f"{where}: expected a gradientindex medium as its interior, got {found}")
    medium = record(layout, "medium", inside)
    refracts = bending_boundary(layout, tensors, shape.field["bsdf"], f"{where}.bsdf")
    return inside, medium, tensors[medium.field["ext_ior"]] if refracts else None
