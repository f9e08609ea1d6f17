"""Ray queries for grids of signed distances, and grids as parts of scenes."""

from __future__ import annotations

import copy
import pickle
import warnings

import pytest
import torch

import torchrender as tr

DOUBLE = torch.float64
T = tr.Transform
SHEAR = torch.tensor([[1.0, 0.2, 0, 0], [0, 1, 0.1, 0], [0.1, 0, 0.7, 0], [0, 0, 0, 1]])
PLACES = {
    "object": T(),
    "turned": T.translate([0.3, -0.2, 1]).rotate([1, 2, 0.5], 50).scale([2, 1.5, 0.8]),
    "mirrored": T.rotate([0, 1, 0], 30).scale([-1, 1, 1.2]),
    "sheared": T.translate([0, 0, -2]) @ T(SHEAR),
}


def coordinates(*n: int) -> tuple[torch.Tensor, ...]:
    """z, y, x of a grid (D, H, W)."""
    return torch.meshgrid(*(torch.linspace(0, 1, k, dtype=DOUBLE) for k in n), indexing="ij")


def dented(n: tuple[int, int, int], noise: float, seed: int = 0) -> torch.Tensor:
    """A ball with numbers that are off by chance: (D, H, W, 1)."""
    z, y, x = coordinates(*n)
    generator = torch.Generator().manual_seed(seed)
    off = noise * (2 * torch.rand(n, generator=generator, dtype=DOUBLE) - 1)
    return (torch.sqrt((x - 0.5) ** 2 + (y - 0.45) ** 2 + (z - 0.5) ** 2) - 0.35 + off)[..., None]


def slanted(n: tuple[int, int, int], noise: float) -> torch.Tensor:
    """The same of a plane, which leaves the cube on all sides."""
    z, y, x = coordinates(*n)
    generator = torch.Generator().manual_seed(2)
    return (0.3 * x - 0.2 * y + z - 0.55 + noise * (2 * torch.rand(n, generator=generator, dtype=DOUBLE) - 1))[
        ..., None
    ]


def shape(grid: torch.Tensor, **more: object) -> dict:
    return {"type": "sdfgrid", "grid": grid, **more}


def scene_of(grid: torch.Tensor, dtype: torch.dtype = torch.float32, **more: object) -> tr.Scene:
    return tr.load_dict({"type": "scene", "ball": shape(grid, **more)}, dtype=dtype)


def rays(matrix: torch.Tensor, n: int = 300, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays from around and from within the unit cube, some along its axes; in the world."""
    generator = torch.Generator().manual_seed(seed)
    o, target = (torch.rand(n, 3, generator=generator, dtype=DOUBLE) for _ in range(2))
    kind = torch.arange(n) % 4
    o = torch.where((kind < 2)[:, None], 3 * o - 1, o)
    d = target - o
    axis = torch.arange(n) % 3
    along = torch.eye(3, dtype=DOUBLE)[axis] * torch.where(d.gather(1, axis[:, None]) < 0, -1.0, 1.0)
    d = torch.where((kind == 3)[:, None], along, d)
    return o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T


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


def test_what_is_wrong_is_named():
    with pytest.raises(ValueError, match=r"ball\.grid: .*not finite"):
        scene_of(torch.full((2, 2, 2, 1), float("nan")))
    for bad in (torch.zeros(3, 3), torch.zeros(2, 2, 2, 2), torch.zeros(1, 3, 3, 1), torch.zeros(3, 3, 1)):
        with pytest.raises(ValueError, match=r"ball\.grid: expected distances of shape \(D, H, W, 1\)"):
            scene_of(bad)
    with pytest.raises(ValueError, match=r"ball\.grid: expected a floating-point tensor"):
        scene_of(torch.zeros(3, 3, 3, 1, dtype=torch.int64))
    with pytest.raises(ValueError, match="give one of grid and filename; got none"):
        tr.load_dict({"type": "scene", "ball": {"type": "sdfgrid"}})
    with pytest.raises(ValueError, match=r"ball\.emitter: a grid of distances cannot emit"):
        scene_of(torch.zeros(2, 2, 2), emitter={"type": "area"})
    with pytest.raises(ValueError, match="smooth"):
        scene_of(torch.zeros(2, 2, 2), normals="flat")
    with pytest.raises(ValueError, match=r"points: expected .*\(\.\.\., 3\)"):
        tr.sdfgrid.evaluate(torch.zeros(2, 2, 2, 1), torch.zeros(4, 2))
    with pytest.raises(ValueError, match=r"grid: expected a tensor of shape \(D, H, W, 1\)"):
        tr.sdfgrid.evaluate(torch.zeros(2, 2, 2), torch.zeros(4, 3))
    dents = {"type": "bitmap", "data": torch.rand(4, 4, 1), "raw": True}
    for bsdf in (
        {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4},
        {"type": "principled", "anisotropic": 0.5},
        {"type": "twosided", "bsdf": {"type": "bumpmap", "heights": dents, "bsdf": {"type": "diffuse"}}},
    ):
        with pytest.raises(
            ValueError, match="ball: field 'bsdf': expected a bsdf without directions along the surface"
        ):
            tr.ray_intersect(scene_of(dented((4, 4, 4), 0.0), bsdf=bsdf), torch.zeros(1, 3), torch.ones(1, 3))
    tr.render(lit(dented((4, 4, 4), 0.0), material={"type": "principled"}), spp=1)
    scene = scene_of(dented((4, 4, 4), 0.0))
    o, d = torch.full((1, 3), -1.0), torch.ones(1, 3)
    for grid, message in (
        (torch.full((2, 2, 2, 1), float("inf")), r"ball\.grid: has values that are not finite"),
        (torch.full((2, 2, 2, 1), 1e30), "ball: field 'grid': expected values up to 1e18"),
        (torch.zeros(2, 2, 2), r"ball.*grid.*: expected .*\(D, H, W, 1\)"),
        (torch.zeros(2, 2, 1, 1), r"ball.*grid.*: expected .*\(D, H, W, 1\)"),
    ):
        with pytest.raises(ValueError, match=message):
            tr.ray_intersect(scene, o, d, params={"ball.grid": grid})
    assert bool(tr.ray_intersect(scene, o, d).valid)  # and goes on


def test_files_have_grids(tmp_path):
    grid = dented((4, 6, 5), 0.1).float()
    tr.io.write_volume(tmp_path / "ball.vol", grid)
    loaded = tr.SdfGrid(filename=str(tmp_path / "ball.vol"))
    assert torch.equal(loaded.grid.detach(), grid)
    place = PLACES["turned"]
    scene = scene_of(grid, normals="analytic", flip_normals=True, to_world=place)
    scene.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    o, d = rays(place.matrix.to(DOUBLE), 40)
    for a, b in zip(tr.ray_intersect(scene, o, d), tr.ray_intersect(again, o, d), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_changes_are_seen_and_make_nothing_else_again(dtype):
    flat = coordinates(5, 5, 5)[0][..., None]
    scene = scene_of(flat - 0.5, dtype)
    line = torch.linspace(0.05, 0.95, 5)
    x, y = torch.meshgrid(line, line, indexing="ij")
    o = torch.stack([x.flatten(), y.flatten(), torch.full((25,), 2.9)], 1)
    d = torch.tensor([0.0, 0.0, -1.0]).expand_as(o)

    def heights(**more) -> list[float]:
        return tr.ray_intersect(scene, o, d, **more).position[:, 2].tolist()

    assert heights() == pytest.approx([0.5] * 25)
    before = scene.updates
    assert before["sdf_grids"] == 1
    ball = scene["ball"]
    with torch.no_grad():
        ball.grid += 0.25
    assert heights() == pytest.approx([0.25] * 25)
    ball.grid.data[:] = flat.to(dtype) - 0.75  # without a word
    assert heights() == pytest.approx([0.75] * 25)
    heights()
    assert scene.updates == {**before, "sdf_grids": 3}
    with torch.no_grad():
        ball.to_world[2, 3] = 1.0
    assert heights() == pytest.approx([1.75] * 25)
    assert scene.updates == {**before, "sdf_grids": 3}
    given = coordinates(3, 7, 4)[0][..., None].to(dtype) - 0.4  # of another size, in this call alone
    assert heights(params={"ball.grid": given}) == pytest.approx([1.4] * 25)
    assert heights() == pytest.approx([1.75] * 25)
    with torch.no_grad():  # a plane of that height
        ball.grid[:] = (0.3 * coordinates(5, 5, 5)[2] + flat[..., 0] - 0.5)[..., None]
    before = tr.ray_intersect(scene, o, d).position
    finer = tr.optim.upsample(scene, "ball.grid", (9, 6, 13))
    assert finer.shape == (9, 6, 13, 1) and ball.grid is finer
    torch.testing.assert_close(tr.ray_intersect(scene, o, d).position, before)
    with torch.no_grad():
        ball.grid[:] = coordinates(9, 6, 13)[0][..., None] - 0.75
    for other in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert tr.ray_intersect(other, o, d).position[:, 2].tolist() == pytest.approx([1.75] * 25)


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


# One a channel, so that the colour says which way a normal points (Woodham, "Photometric method for determining surface
# orientation from multiple images", 1980).
LAMPS = [
    ([3.5, 0.5, 3.5], [60.0, 0.0, 0.0]),
    ([-1.0, 3.1, 3.5], [0.0, 60.0, 0.0]),
    ([-1.0, -2.1, 3.5], [0.0, 0.0, 60.0]),
]

PAINT = {"type": "diffuse", "reflectance": 0.8}


def lit(grid: torch.Tensor, rfilter: str = "box", material: dict = PAINT) -> tr.Scene:
    """Seen so near that there is nothing else in view."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 10,
                "to_world": T.look_at([0.6, 0.5, 3], [0.5, 0.5, 0.5], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 20, "height": 20, "rfilter": {"type": rfilter}},
            },
            "ball": shape(grid, bsdf=material),
            **{
                f"lamp{i}": {"type": "point", "position": position, "intensity": {"type": "rgb", "value": colour}}
                for i, (position, colour) in enumerate(LAMPS)
            },
        }
    )


def test_the_light_tracer_has_no_derivative_of_what_moves():
    scene = lit(dented((5, 5, 5), 0.0), "gaussian")
    scene.train_only("ball.grid", "ball.bsdf.reflectance.value")
    tracer = tr.ParticleTracer(max_depth=2)
    with pytest.raises(tr.NotDifferentiableError, match=r"ball\.grid.*particle tracer has none.*sdfgrid"):
        tr.render(scene, integrator=tracer, spp=1)
    scene.train_only("ball.bsdf.reflectance.value")
    tr.render(scene, integrator=tracer, spp=4).sum().backward()


def test_media_inside_end_where_the_surface_does():
    """Transmittance through a ball of a medium that absorbs, beside that of a sphere."""
    n = 40
    z, y, x = (c - 0.5 for c in coordinates(n, n, n))
    grid = (torch.sqrt(x * x + y * y + z * z) - 0.4)[..., None]
    medium = {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.0}
    images = []
    for ball in (
        shape(grid, to_world=T.translate([-0.5, -0.5, -0.5])),
        {"type": "sphere", "radius": 0.4},
    ):
        scene = tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "volpath", "max_depth": 6},
                "camera": {
                    "type": "perspective",
                    "fov": 20,
                    "to_world": T.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}},
                },
                "ball": {**ball, "bsdf": {"type": "null"}, "interior": medium},
                "sky": {"type": "constant", "radiance": 1.0},
            }
        )
        images.append(tr.render(scene, spp=64, seed=2).detach())
    assert float(images[1].min()) < 0.35 < 0.99 < float(images[1].max())
    torch.testing.assert_close(images[0], images[1], rtol=0, atol=0.03)
    assert abs(float((images[0] - images[1]).mean())) < 2e-3


def test_an_inversion_finds_the_shape_that_was_seen():
    """From the shading of a ball within its outline, starting from one that is flatter."""
    n = 12
    z, y, x = (c - 0.5 for c in coordinates(n, n, n))
    truth = (torch.sqrt(x * x + y * y + z * z) - 0.4).float()[..., None]
    start = (torch.sqrt(x * x + y * y + 1.6 * z * z) - 0.4).float()[..., None]
    target = tr.render(lit(truth), spp=4, seed=1).detach()
    scene = lit(start)
    (grid,) = scene.train_only("ball.grid")
    optimizer = torch.optim.Adam([grid], lr=2e-3)
    losses = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)  # no silhouette is in view
        for _ in range(80):
            optimizer.zero_grad()
            loss = (tr.render(scene, spp=4, seed=1) - target).square().mean()
            loss.backward()
            optimizer.step()
            losses.append(float(loss.detach()))
    assert losses[-1] < 0.1 * losses[0]
    rays = scene.sensors[0].rays()
    normals = [tr.ray_intersect(s, *rays).shading_normal for s in (scene, lit(truth), lit(start))]
    off, before = (float((normals[i] - normals[1]).norm(dim=1).mean()) for i in (0, 2))
    assert off < 0.2 * before


def test_gradients_in_single_precision_are_those_in_double():
    """Of a path that meets the grid many times; the same samples but for those that rounding sends another way."""
    gradients = []
    for dtype in (torch.float32, DOUBLE):
        scene = tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 4},
                "camera": {
                    "type": "perspective",
                    "fov": 60,
                    "to_world": T.look_at([0.45, 0.5, 0.5], [0.5, 0.52, 0.9], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
                },
                "hall": shape(dented((9, 9, 9), 0.0), flip_normals=True, bsdf=PAINT),
                "bulb": {"type": "point", "position": [0.4, 0.6, 0.45], "intensity": 1.0},
            },
            dtype=dtype,
        )
        values = scene.train_only("hall.grid", "hall.to_world")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tr.MissingTermWarning)  # all of the hall is seen from everywhere
            image = tr.render(scene, spp=64, seed=4)
            weight = torch.linspace(-1, 2, image.numel(), dtype=dtype).reshape(image.shape)
            gradients.append([g.double() for g in torch.autograd.grad((image * weight).mean(), values)])
    for single, double in zip(*gradients, strict=True):
        assert float(double.abs().max()) > 1e-3
        assert float((single - double).norm()) < 5e-3 * float(double.norm())


@pytest.mark.parametrize("normals", tr.sdfgrid.NORMALS)
def test_light_paths_give_the_same_image(normals):
    """With normals for shading that are not the surface's. Significance 0.01 for both together."""
    z, y, x = (c - 0.5 for c in coordinates(7, 7, 7))
    grid = (torch.sqrt(x * x + 1.3 * y * y + z * z) - 0.4).float()[..., None]
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 25,
                "to_world": T.look_at([0.5, 1.5, 3], [0.5, 0.5, 0.5], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "ball": shape(grid, normals=normals, bsdf=PAINT),
            "floor": {"type": "rectangle", "to_world": T.translate([0.5, 0.05, 0.5]).rotate([1, 0, 0], -90).scale(2)},
            "lamp": {
                "type": "rectangle",
                "to_world": T.translate([1.0, 3, 0.8]).rotate([1, 0, 0], 90).scale(0.4),
                "emitter": {"type": "area", "radiance": 8.0},
            },
        }
    )
    images = [
        tr.testing.mean_and_variance(
            lambda s, tracer=tracer, spp=spp: tr.render(scene, integrator=tracer, spp=spp, seed=s),
            range(first, first + 16),
        )
        for tracer, spp, first in ((tr.PathTracer(max_depth=4), 16, 0), (tr.ParticleTracer(max_depth=4), 64, 100))
    ]
    assert float(images[0][0].mean()) > 0.02
    result = tr.testing.z_test(
        images[0][0],
        images[1][0],
        variance=images[0][1],
        reference_variance=images[1][1],
        block=4,
        significance=0.01,
        tests=2,
    )
    assert result, result.message
