"""Ray queries for grids of signed distances: hits, normals, and derivatives of both."""

from __future__ import annotations

import pytest
import torch
from sdf_grids import DOUBLE, PLACES, T, coordinates, dented, lit, rays, scene_of

import torchrender as tr


def slanted(n: tuple[int, int, int], noise: float) -> torch.Tensor:
    """A plane, which leaves the cube on all sides, with numbers that are off by chance: (D, H, W, 1)."""
    z, y, x = coordinates(*n)
    generator = torch.Generator().manual_seed(2)
    return (0.3 * x - 0.2 * y + z - 0.55 + noise * (2 * torch.rand(n, generator=generator, dtype=DOUBLE) - 1))[
        ..., None
    ]


def first_hits(grid: torch.Tensor, o: torch.Tensor, d: torch.Tensor, steps: int = 1500):
    """Distances of rays in the grid's space by a search in small steps and bisection, in double precision, infinite at
    a miss; and whether that is sure: the function keeps off zero elsewhere."""
    safe = torch.where(d == 0, 1e-300, d)
    a, b = -o / safe, (1 - o) / safe
    enter = torch.minimum(a, b).amax(1).clamp_min(0)
    leave = torch.maximum(a, b).amin(1)
    crosses = leave > enter
    leave = torch.maximum(leave, enter)

    def value(t: torch.Tensor) -> torch.Tensor:
        return tr.sdfgrid.evaluate(grid, o[:, None] + d[:, None] * t[..., None])[0]

    t = enter[:, None] + (leave - enter)[:, None] * torch.linspace(0, 1, steps, dtype=DOUBLE)
    f = value(t)
    change = (f[:, 1:] < 0) != (f[:, :1] < 0)
    hit = change.any(1) & crosses
    index = change.int().argmax(1)
    low, high = t.gather(1, index[:, None]), t.gather(1, index[:, None] + 1)
    for _ in range(50):
        middle = (low + high) / 2
        same = (value(middle) < 0) == (f[:, :1] < 0)
        low, high = torch.where(same, middle, low), torch.where(same, high, middle)
    # local extrema that come near zero before the hit may hide two roots
    before = (torch.arange(1, steps - 1) < torch.where(hit, index, steps)[:, None]) & crosses[:, None]
    turns = (f[:, 1:-1].abs() <= f[:, :-2].abs()) & (f[:, 1:-1].abs() <= f[:, 2:].abs())
    unsure = (before & turns & (f[:, 1:-1].abs() < 1e-4)).any(1)
    return torch.where(hit, high[:, 0], torch.inf), ~unsure


SIZES = {
    "one cell": (2, 2, 2, 0.3),
    "flat": (2, 9, 30, 0.05),
    "uneven": (7, 16, 12, 0.02),
    "fine": (40, 40, 40, 0.002),
    "rough": (9, 9, 9, 0.3),
}


@pytest.mark.parametrize("size", SIZES)
def test_rays_meet_the_surface_where_a_search_finds_it(size):
    *n, noise = SIZES[size]
    grid = (slanted if size in ("one cell", "flat") else dented)(tuple(n), noise)
    o, d = rays(torch.eye(4, dtype=DOUBLE))
    expected, sure = first_hits(grid, o, d)
    for name, place in PLACES.items():
        matrix = place.matrix.to(DOUBLE)
        world = o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T
        for dtype, tolerance in ((torch.float32, 3e-5), (DOUBLE, 1e-9)):
            scene = scene_of(grid, dtype, to_world=place)
            hits = tr.ray_intersect(scene, *world)
            both = hits.valid & torch.isfinite(expected)
            assert int(both.sum()) > 30
            wrong = sure & (hits.valid != torch.isfinite(expected))
            near = (hits.t.double() - expected).abs() <= tolerance * (1 + expected)
            # a ray that nearly touches the surface may be on the other side of it in single precision
            assert int(wrong.sum()) + int((both & sure & ~near).sum()) <= 2, name
            assert torch.equal(tr.ray_occluded(scene, *world), hits.valid)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("normals", tr.sdfgrid.NORMALS)
def test_points_and_normals_are_those_of_the_surface(normals, dtype):
    grid = dented((9, 12, 10), 0.01)
    tolerance = 2e-5 if dtype == torch.float32 else 1e-11
    for name, place in PLACES.items():
        matrix = place.matrix.to(DOUBLE)
        o, d = rays(matrix)
        flip = name == "turned"
        scene = scene_of(grid, dtype, normals=normals, to_world=place, flip_normals=flip)
        hits = tr.ray_intersect(scene, o, d)
        valid = hits.valid
        position, sign = hits.position[valid].double(), -1 if flip else 1
        local = (position - matrix[:3, 3]) @ torch.linalg.inv(matrix[:3, :3]).T
        value, gradient = tr.sdfgrid.evaluate(scene["ball"].grid.detach().double(), local)
        assert float(value.abs().max()) < tolerance
        up = torch.nn.functional.normalize(gradient @ torch.linalg.inv(matrix[:3, :3]), dim=1) * sign
        # a point on the border of a cell may be in the one as well as in the other
        inner = ((local * tr.sdfgrid.cell_counts(grid)) % 1 - 0.5).abs().amax(1) < 0.499
        torch.testing.assert_close(hits.normal[valid][inner].double(), up[inner], rtol=0, atol=100 * tolerance)
        assert torch.equal(hits.normal, hits.shading_normal) == (normals == "analytic")
        assert float((hits.normal * hits.shading_normal).sum(1)[valid].min()) > 0.7
        assert not bool(hits.uv.any())
        assert bool((hits.barycentric[valid] >= -1e-6).all()) and bool((hits.barycentric[valid] <= 1 + 1e-6).all())
        along = o[valid] + d[valid] * hits.t[valid, None].double()
        torch.testing.assert_close(along, position, rtol=20 * tolerance, atol=20 * tolerance)
        stored = tr.sdfgrid.place(scene["ball"].grid.detach(), hits.prim_id[valid], hits.barycentric[valid])
        torch.testing.assert_close(stored.double(), local, rtol=0, atol=20 * tolerance)


def test_smooth_normals_go_on_from_cell_to_cell():
    """Analytic ones do not: over a path along the surface they jump at the cells' borders."""
    grid = dented((8, 8, 8), 0.0)
    angle = torch.linspace(0.3, 2.8, 4000, dtype=DOUBLE)
    away = torch.stack([torch.cos(angle), torch.sin(angle), 0.3 * torch.sin(3 * angle)], 1)
    o = torch.tensor([0.5, 0.45, 0.5], dtype=DOUBLE).expand_as(away)
    largest = {}
    for normals in tr.sdfgrid.NORMALS:
        found = tr.ray_intersect(scene_of(grid, DOUBLE, normals=normals), o, away)
        assert bool(found.valid.all())
        largest[normals] = float(torch.linalg.vector_norm(found.shading_normal.diff(dim=0), dim=1).max())
    assert largest["smooth"] < 0.01 < 0.03 < largest["analytic"]


MITSUBA = [
    (([0.3, -1, 1.2], [0.15, 1.1, -0.25]), [2.279259, 0.0, -0.095467, 0.995433, 0.000774, -0.081324, 0.996687]),
    (([2.0, 2.5, 0.9], [-0.8, -0.7, -0.2]), [1.571948, 0.639189, 0.249058, 0.727604, 0.890687, 0.187191, 0.414291]),
    (([0.6, 1.3, 0.58], [0.3, 0.2, 0.9]), [0.140525, 0.0, -0.081935, 0.996638, 0.073825, 0.006556, 0.99725]),
    (([0.7, 1.2, 0.6], [-0.9, 0.4, -0.1]), [0.40785, -0.707916, -0.089097, -0.700655, -0.959237, 0.046772, -0.278706]),
    (([0.55, 1.0, -1], [0.05, 0.12, 1.0]), [1.475731, 0.0, -0.098877, -0.9951, 0.042668, -0.096706, -0.994398]),
]


def test_the_numbers_are_mitsubas():
    """t, normal and shading normal of scalar_rgb of Mitsuba 3.9.1, of rays of which some start inside the surface."""
    z, y, x = coordinates(6, 6, 6)
    grid = torch.sqrt((x - 0.5) ** 2 + 1.3 * (y - 0.55) ** 2 + 2 * (z - 0.4) ** 2) - 0.3
    scene = scene_of(grid, to_world=T.translate([0.1, 0.2, 0.3]).scale([1, 2, 0.7]))
    for ray, numbers in MITSUBA:
        o, d = (torch.tensor([v]) for v in ray)
        found = tr.ray_intersect(scene, o, torch.nn.functional.normalize(d, dim=1))
        given = torch.cat([found.t, found.normal[0], found.shading_normal[0]])
        torch.testing.assert_close(given, torch.tensor(numbers), rtol=0, atol=3e-5)


def test_no_ray_slips_through_where_cells_meet():
    """Rays from within a closed surface, to corners and edges of cells among others."""
    n = 17
    grid = dented((n, n, n), 0.004)
    scene = scene_of(grid)
    z, y, x = coordinates(n, n, n)
    corner = torch.stack([x, y, z], -1).reshape(-1, 3)
    generator = torch.Generator().manual_seed(3)
    o = torch.tensor([0.5, 0.45, 0.5], dtype=DOUBLE).expand_as(corner)
    for origin in (o, o + 0.1 * (torch.rand(o.shape, generator=generator, dtype=DOUBLE) - 0.5)):
        for target in (corner, (corner + 0.5 / (n - 1)).index_fill(1, torch.tensor([0]), 0.0)):
            d = target - origin
            far = torch.linalg.vector_norm(d, dim=1) > 0.4
            assert bool(tr.ray_occluded(scene, origin[far], 3 * d[far]).all())
            assert bool(tr.ray_intersect(scene, origin[far], 3 * d[far]).valid.all())


def test_there_is_nothing_without_a_change_of_sign():
    scene = scene_of(torch.ones(4, 4, 4, 1))
    o, d = rays(torch.eye(4, dtype=DOUBLE))
    assert not bool(tr.ray_intersect(scene, o, d).valid.any())
    assert not bool(tr.ray_occluded(scene, o, d).any())
    assert bool(torch.isfinite(scene.bounding_box()).all())
    assert not bool(tr.render(lit(torch.ones(4, 4, 4, 1)), spp=1).any())


def test_distances_are_limited():
    scene = scene_of(coordinates(3, 3, 3)[0][..., None] - 0.5)
    o, d = torch.tensor([[0.3, 0.2, 3.0]]).expand(3, 3), torch.tensor([[0.0, 0.0, -1.0]]).expand(3, 3)
    limit = torch.tensor([2.4, 2.6, float("inf")])
    assert tr.ray_intersect(scene, o, d, limit).valid.tolist() == [False, True, True]
    assert tr.ray_occluded(scene, o, d, limit).tolist() == [False, True, True]


@pytest.mark.parametrize("normals", tr.sdfgrid.NORMALS)
def test_derivatives_of_hits_of_any_mode(normals):
    grid = dented((4, 5, 4), 0.02)
    scene = scene_of(grid, DOUBLE, normals=normals, to_world=PLACES["sheared"])
    o, d = rays(PLACES["sheared"].matrix.to(DOUBLE), 32)
    hits = tr.ray_intersect(scene, o, d)
    assert int(hits.valid.sum()) >= 10
    o, d = o[hits.valid], d[hits.valid]

    def outputs(g: torch.Tensor, m: torch.Tensor, o: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
        found = tr.ray_intersect(scene, o, d, params={"ball.grid": g, "ball.to_world": m})
        return torch.cat([found.t[:, None], found.position, found.normal, found.shading_normal], 1)

    matrix = scene["ball"].to_world.detach().clone()
    free = torch.ones(4, 4, dtype=DOUBLE)
    free[3] = 0
    inputs = [x.clone().requires_grad_() for x in (grid, matrix, o, d)]
    assert torch.autograd.gradcheck(
        lambda g, m, o, d: outputs(g, matrix + (m - matrix) * free, o, d),
        inputs,
        atol=1e-5,
        check_forward_ad=True,
        fast_mode=True,
    )
    assert torch.autograd.gradgradcheck(lambda g: outputs(g, matrix, o, d), inputs[:1], atol=1e-4, fast_mode=True)
