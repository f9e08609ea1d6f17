"""Ray queries on the emulated device: a tree of our own finds what Embree finds, late and in any order."""

from __future__ import annotations

import math

import pytest
import sdf_grids
import torch
from test_queries import all_shapes, grid

import torchrender as tr


def shapes(dtype: torch.dtype = torch.float32) -> tr.Scene:
    pipe = {"type": "cylinder", "p0": [-1.0, -1.0, 0.5], "p1": [1.0, 1.0, 0.8], "radius": 0.2}
    return tr.load_dict({**all_shapes(), "pipe": pipe}, dtype=dtype)


TILTED = tr.Transform.rotate([1, 0, 0], 25) @ tr.Transform.scale([0.6, 0.5, 0.4])


def mesh(vertices: torch.Tensor, faces: torch.Tensor) -> tr.Scene:
    return tr.load_dict({"type": "scene", "mesh": tr.Mesh(vertices, faces)})


def ball(n: int = 24) -> tuple[torch.Tensor, torch.Tensor]:
    """A closed mesh around the origin, of 2 n (n - 1) bumpy triangles."""
    theta = torch.linspace(0, math.pi, n + 1)[1:-1, None]
    phi = torch.arange(2 * n) * (math.pi / n)
    radius = 1 + 0.2 * torch.sin(7 * theta + 3 * phi)
    rows = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos() + 0 * phi], 2) * radius[..., None]
    vertices = torch.cat([rows.reshape(-1, 3), torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])])
    top, bottom, faces = len(vertices) - 2, len(vertices) - 1, []
    for j in range(2 * n):
        k = (j + 1) % (2 * n)
        last = (n - 2) * 2 * n
        faces += [[top, j, k], [bottom, last + k, last + j]]
        for i in range(0, last, 2 * n):
            faces += [[i + j, i + 2 * n + j, i + 2 * n + k], [i + j, i + 2 * n + k, i + k]]
    return vertices, torch.tensor(faces, dtype=torch.int32)


def random_rays(n: int, reach: float, dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(7)
    origins = (torch.rand(n, 3, generator=random, dtype=dtype) - 0.5) * 2 * reach
    return origins, torch.randn(n, 3, generator=random, dtype=dtype)


def check_equal(found: tr.queries.Hits, expected: tr.queries.Hits, others: float, off: float = 2e-4) -> None:
    """The same hits, but for a share of rays that pass edges so closely that rounding decides."""
    same = (found.shape_id == expected.shape_id) & (found.prim_id == expected.prim_id)
    assert float((~same).double().mean()) <= others
    assert torch.equal(found.valid, found.shape_id >= 0)
    for name in ("t", "position", "normal", "shading_normal", "uv", "barycentric"):
        a, b = getattr(found, name)[same], getattr(expected, name)[same]
        torch.testing.assert_close(a, b, rtol=off, atol=off, msg=lambda text, name=name: f"{name}: {text}")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_hits_are_those_of_embree(device, dtype):
    scene = shapes(dtype)
    for o, d in (grid(61, dtype), random_rays(20000, 3, dtype)):
        limits = torch.where(torch.arange(len(o)) % 3 == 0, 2.0, math.inf).to(dtype)
        device("cpu")
        expected, hidden = tr.ray_intersect(scene, o, d, limits), tr.ray_occluded(scene, o, d, limits)
        device("emulated")
        found, occluded = tr.ray_intersect(scene, o, d, limits), tr.ray_occluded(scene, o, d, limits)
        assert set(found.shape_id.tolist()) == {-1, *range(12)}
        check_equal(found, expected, 2e-4)
        assert torch.equal(occluded, found.valid)
        assert float((occluded != hidden).double().mean()) <= 1e-4


def test_rays_that_are_none_hit_nothing(device):
    bad = torch.tensor([[0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [math.inf, 0.0, 1.0]])
    o = torch.tensor([[0.0, 0.0, 3.0]]).expand(3, 3)
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    assert not tr.ray_intersect(scene, o, bad).valid.any()
    down = torch.tensor([[0.0, 0.0, -1.0]])
    assert not tr.ray_occluded(scene, o[:1], down, -1.0).any() and not tr.ray_occluded(scene, o[:1], down, 0.0).any()
    assert tr.ray_occluded(scene, o[:1], down).all()
    empty = tr.load_dict({"type": "scene", "sky": {"type": "constant"}})
    assert not tr.ray_intersect(empty, o, down.expand(3, 3)).valid.any()
    assert tr.ray_intersect(scene, o[:0], down[:0]).t.shape == (0,)


def test_no_ray_leaves_a_closed_mesh(device):
    vertices, faces = ball()
    corners = vertices[faces.long()]
    weights = torch.rand(len(faces), 1, generator=torch.Generator().manual_seed(3))
    edges = corners[:, 0] * weights + corners[:, 1] * (1 - weights)
    origins, anywhere = random_rays(20000, 0.2)
    targets = torch.cat([vertices, edges, corners.mean(1)])
    for shift in (0.0, 100.0):
        scene = mesh(vertices + shift, faces)
        for origin in (torch.zeros(1, 3), torch.tensor([[0.1, -0.2, 0.05]])):
            assert tr.ray_intersect(scene, (origin + shift).expand_as(targets), targets - origin).valid.all()
        assert tr.ray_occluded(scene, origins + shift, anywhere).all()


def test_ties_and_orders_do_not_matter(device):
    # three in one place, of which the first counts; and corners in which six triangles meet
    square = {"type": "rectangle"}
    twins = tr.load_dict({"type": "scene", "a": square, "b": {**square, "flip_normals": True}, "c": square})
    vertices, faces = ball(9)
    inside = random_rays(3000, 0.6)[0] * torch.tensor([1.0, 1.0, 0.0])
    for scene, targets in ((twins, inside), (mesh(vertices, faces), vertices)):
        o = torch.tensor([[0.1, 0.2, 3.0]]).expand_as(targets)
        first = tr.ray_intersect(scene, o, targets - o)
        for _ in range(4):  # every launch has an order of its own
            again = tr.ray_intersect(scene, o, targets - o)
            assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
        turned = torch.randperm(len(targets), generator=torch.Generator().manual_seed(5))
        again = tr.ray_intersect(scene, o, (targets - o)[turned])
        assert all(torch.equal(a[turned], b) for a, b in zip(first, again, strict=True))
        if scene is twins:
            assert set(first.shape_id.tolist()) == {0}


def test_rays_follow_what_moves(device):
    vertices, faces = ball()
    scene = mesh(vertices, faces)
    o, d = random_rays(4000, 1.5)
    tr.ray_intersect(scene, o, d)
    bent = vertices + 0.02 * torch.sin(5 * vertices[:, [1, 2, 0]])
    scrambled = vertices[torch.randperm(len(vertices), generator=torch.Generator().manual_seed(2))]
    for moved in (bent, scrambled, vertices):
        parameter = "mesh.vertex_positions"
        found = tr.ray_intersect(scene, o, d, params={parameter: moved})
        anew = tr.ray_intersect(mesh(moved, faces), o, d)
        assert all(torch.equal(a, b) for a, b in zip(found, anew, strict=True))
        device("cpu")
        check_equal(found, tr.ray_intersect(scene, o, d, params={parameter: moved}), 2e-3)
        device("emulated")


@pytest.mark.parametrize("interpolation", ["bspline", "bilinear"])
def test_rays_follow_height_fields(device, interpolation):
    """Of two in one scene, one of which is larger than the blocks of 64 cells whose heights are looked at together."""
    x, y = torch.meshgrid(torch.linspace(-1, 1, 150), torch.linspace(-1, 1, 90), indexing="ij")
    heights = 0.2 * torch.sin(9 * x) * torch.cos(7 * y + x)
    field = {"type": "heightfield", "interpolation": interpolation}
    other = {**field, "heights": heights[::9, ::13], "to_world": tr.Transform.translate([0.3, 0.2, 0.7]) @ TILTED}
    objects = {"type": "scene", "first": {**field, "heights": heights}, "second": other}
    scene = tr.load_dict(objects)
    o, d = random_rays(20000, 1.5)
    for changed in (heights, 0.7 * heights + 0.1, heights.flip(0)):
        params = {"first.heights": changed}
        device("emulated")
        found, occluded = (f(scene, o, d, params=params) for f in (tr.ray_intersect, tr.ray_occluded))
        device("cpu")
        check_equal(found, tr.ray_intersect(scene, o, d, params=params), 2e-4)
        assert {0, 1} < set(found.shape_id.tolist()) and torch.equal(occluded, found.valid)


@pytest.mark.parametrize("place", sdf_grids.PLACES.values(), ids=sdf_grids.PLACES)
def test_rays_follow_grids_of_distances(device, place):
    """Of two in one scene, one of them with empty blocks of many cells, as its numbers change, also to none at all."""
    fine, coarse = sdf_grids.dented((40, 25, 33), 0.003), sdf_grids.dented((6, 5, 4), 0.05)
    other = sdf_grids.shape(coarse, to_world=tr.Transform.translate([0.4, 0.5, 0.3]) @ tr.Transform(place))
    scene = tr.load_dict({"type": "scene", "fine": sdf_grids.shape(fine, to_world=place), "coarse": other})
    o, d = (x.float() for x in sdf_grids.rays(scene.fine.to_world.detach().double(), 6000))
    for changed in (fine, fine + 0.1, fine.flip(0), fine.abs() + 0.1, fine):
        params = {"fine.grid": changed.float()}
        device("emulated")
        found, occluded = (f(scene, o, d, params=params) for f in (tr.ray_intersect, tr.ray_occluded))
        device("cpu")
        check_equal(found, tr.ray_intersect(scene, o, d, params=params), 2e-3, 2e-3)  # some graze it
        assert 1 in found.shape_id and torch.equal(occluded, found.valid)
        assert (0 in found.shape_id) == bool((changed < 0).any())


@pytest.mark.parametrize("name", ["cpu", "tree", "emulated"])
def test_rays_through_the_corner_of_an_empty_grid(device, name):
    """Where its box is a point: there is no cell to begin in."""
    device(name)
    scene = tr.load_dict({"type": "scene", "none": sdf_grids.shape(torch.full((200, 200, 200, 1), 0.5))})
    o = torch.tensor([[0.0, 0, 4], [0, 0, -4], [1, 1, 1], [0, 4, 0], [-4, 0, 0]])
    d = torch.nn.functional.normalize(-o, dim=1)
    assert not tr.ray_intersect(scene, o, d).valid.any()
    assert not tr.ray_occluded(scene, o, d).any()


def test_derivatives_are_those_of_the_cpu(device):
    gradients = []
    for name in ("cpu", "emulated"):
        device(name)
        scene = shapes(torch.float64)
        o, d = grid(9)
        parameters = [*scene.train_only("*.vertex_positions"), *scene.train_only("*.center"), o.requires_grad_()]
        hits = tr.ray_intersect(scene, o, d)
        (hits.t[hits.valid].sum() + (hits.normal * hits.position.nan_to_num(posinf=0.0)).sum()).backward()
        gradients.append([p.grad for p in parameters if p.grad is not None])
    assert len(gradients[0]) == len(gradients[1]) > 1
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"type": "linearcurve", "control_points": torch.arange(12.0).reshape(4, 3), "radii": 0.1}, "a linearcurve"),
        ({"type": "bsplinecurve", "control_points": torch.arange(12.0).reshape(4, 3), "radii": 0.1}, "a bsplinecurve"),
    ],
)
def test_shapes_that_are_not_there_are_refused_by_name(device, shape, words):
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere"}, "odd": shape})
    o, d = torch.zeros(1, 3), torch.ones(1, 3)
    expected = f"odd: devices have everything but curves so far, got {words}; with TORCHRENDER_BACKEND=cpu rays"
    for query in (tr.ray_intersect, tr.ray_occluded):
        with pytest.raises(ValueError, match=expected):
            query(scene, o, d)
    device("cpu")
    assert tr.ray_intersect(scene, o, d).valid.all()


def test_what_is_not_there_is_refused(device):
    scene = tr.load_dict({"type": "scene", "sky": {"type": "constant"}, "ball": {"type": "sphere"}})
    alone = r"ray queries, images and their derivatives \(tr.ray_intersect, tr.ray_occluded, tr.render\) so far; with"
    with pytest.raises(RuntimeError, match="probe: TORCHRENDER_BACKEND=emulated has " + alone):
        tr.testing.sample_emitters(scene, torch.zeros(1, 3), torch.zeros(1, 3))
