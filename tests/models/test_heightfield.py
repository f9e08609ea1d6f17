"""Ray queries for height fields, and height fields as parts of scenes."""

from __future__ import annotations

import copy
import pickle

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


def rough(rows: int, columns: int, amplitude: float, seed: int = 0) -> torch.Tensor:
    """Heights of independent numbers around 0.3."""
    generator = torch.Generator().manual_seed(seed)
    return 0.3 + amplitude * (2 * torch.rand(rows, columns, generator=generator, dtype=DOUBLE) - 1)


def field(heights: torch.Tensor, **more: object) -> dict:
    return {"type": "heightfield", "heights": heights, **more}


def scene_of(heights: torch.Tensor, dtype: torch.dtype = torch.float32, **more: object) -> tr.Scene:
    return tr.load_dict({"type": "scene", "lens": field(heights, **more)}, dtype=dtype)


def rays(heights: torch.Tensor, matrix: torch.Tensor, n: int = 240, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays from above, from below, from within the range of heights, and nearly parallel to the plane; world space."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return 2 * torch.rand(*shape, generator=generator, dtype=DOUBLE) - 1

    low, high = (float(x) for x in torch.aminmax(heights))
    spread = high - low + 0.02
    o, d = uniform(n, 3), uniform(n, 3)
    kind = torch.arange(n) % 4
    o[:, :2] *= 1.2
    o[:, 2] = torch.where(kind == 0, high + 1.0, torch.where(kind == 1, low - 1.0, low + spread * (o[:, 2] + 1) / 2))
    d[:, 2] = torch.where(kind == 0, -1.0, torch.where(kind == 1, 1.0, torch.where(kind == 2, 0.05, 1.0) * d[:, 2]))
    world = o @ matrix[:3, :3].T + matrix[:3, 3]
    return world, d @ matrix[:3, :3].T


def first_hits(heights: torch.Tensor, interpolation: str, o: torch.Tensor, d: torch.Tensor, steps: int = 1000):
    """Distances of rays in object space by a search in small steps and bisection, in double precision; infinite
    at a miss. And the least distance between ray and surface, along z, of rays that miss."""
    low, high = (float(x) for x in torch.aminmax(heights))
    corner = torch.tensor([[-1, -1, low - 1e-3], [1, 1, high + 1e-3]], dtype=DOUBLE)
    a, b = (corner[0] - o) / d, (corner[1] - o) / d
    enter = torch.minimum(a, b).amax(1).clamp_min(0)
    leave = torch.maximum(torch.maximum(a, b).amin(1), enter)

    def above(t: torch.Tensor) -> torch.Tensor:
        p = o[:, None] + d[:, None] * t[..., None]
        return p[..., 2] - tr.heightfield.evaluate(heights, (p[..., :2] + 1) / 2, interpolation)[0]

    t = enter[:, None] + (leave - enter)[:, None] * torch.linspace(0, 1, steps, dtype=DOUBLE)
    f = above(t)
    change = (f[:, 1:] < 0) != (f[:, :1] < 0)
    hit = change.any(1) & (leave > enter)
    index = change.int().argmax(1)
    low_t, high_t = t.gather(1, index[:, None]), t.gather(1, index[:, None] + 1)
    for _ in range(50):
        middle = (low_t + high_t) / 2
        same = (above(middle) < 0) == (f[:, :1] < 0)
        low_t, high_t = torch.where(same, middle, low_t), torch.where(same, high_t, middle)
    return torch.where(hit, high_t[:, 0], torch.inf), torch.where(leave > enter, f.abs().amin(1), torch.inf)


SIZES = {
    "1x1": (1, 1, 0.05),
    "2x3": (2, 3, 0.3),
    "3x200": (3, 200, 0.05),
    "64x64": (64, 64, 0.05),
    "steep": (9, 7, 0.8),
}


@pytest.mark.parametrize("interpolation", tr.heightfield.INTERPOLATIONS)
@pytest.mark.parametrize("size", SIZES)
def test_rays_meet_the_surface_where_a_search_finds_it(size, interpolation):
    heights = rough(*SIZES[size])
    o, d = rays(heights, torch.eye(4, dtype=DOUBLE))
    expected, gap = first_hits(heights, interpolation, o, d)
    sure = torch.isfinite(expected) | (gap > 1e-3)  # others nearly touch it
    for name, place in PLACES.items():
        matrix = place.matrix.to(DOUBLE)
        world = o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T
        for dtype, tolerance in ((torch.float32, 5e-5), (DOUBLE, 1e-9)):
            scene = scene_of(heights, dtype, interpolation=interpolation, to_world=place)
            hits = tr.ray_intersect(scene, *world)
            assert torch.equal(hits.valid, ~torch.isinf(hits.t))
            wrong = sure & (hits.valid != torch.isfinite(expected))
            both = hits.valid & torch.isfinite(expected)
            assert int(both.sum()) > 60
            near = (hits.t.double() - expected).abs() <= tolerance * (1 + expected)
            # a ray that nearly touches a crest may be on the other side of it in single precision
            assert int(wrong.sum()) + int((both & ~near).sum()) <= 1, name
            assert torch.equal(tr.ray_occluded(scene, *world), hits.valid)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("interpolation", tr.heightfield.INTERPOLATIONS)
def test_points_and_normals_are_those_of_the_surface(interpolation, dtype):
    heights = rough(12, 17, 0.1)
    tolerance = 2e-5 if dtype == torch.float32 else 1e-11
    for name, place in PLACES.items():
        matrix = place.matrix.to(DOUBLE)
        o, d = rays(heights, matrix)
        flip = name == "turned"
        scene = scene_of(heights, dtype, interpolation=interpolation, to_world=place, flip_normals=flip)
        hits = tr.ray_intersect(scene, o, d)
        uv = hits.uv[hits.valid].double()
        z, z_u, z_v = tr.heightfield.evaluate(scene["lens"].heights.detach().double(), uv, interpolation)
        local = torch.cat([2 * uv - 1, z[:, None]], 1)
        up = torch.stack([-z_u / 2, -z_v / 2, torch.ones_like(z)], 1) @ torch.linalg.inv(matrix[:3, :3])
        normal = torch.nn.functional.normalize(up, dim=1) * (-1 if flip else 1)
        position = local @ matrix[:3, :3].T + matrix[:3, 3]
        valid = hits.valid
        torch.testing.assert_close(hits.position[valid].double(), position, rtol=tolerance, atol=tolerance)
        torch.testing.assert_close(hits.normal[valid].double(), normal, rtol=0, atol=30 * tolerance)
        assert torch.equal(hits.normal, hits.shading_normal) and torch.equal(hits.uv, hits.barycentric)
        assert bool((hits.prim_id[valid] == 0).all())
        along = o[valid] + d[valid] * hits.t[valid, None].double()
        torch.testing.assert_close(along, position, rtol=20 * tolerance, atol=20 * tolerance)


def test_distances_are_limited():
    scene = scene_of(torch.full((4, 4), 0.5))
    o, d = torch.tensor([[0.1, 0.2, 3.0]]).expand(3, 3), torch.tensor([[0.0, 0.0, -1.0]]).expand(3, 3)
    limit = torch.tensor([2.4, 2.6, float("inf")])
    assert tr.ray_intersect(scene, o, d, limit).valid.tolist() == [False, True, True]
    assert tr.ray_occluded(scene, o, d, limit).tolist() == [False, True, True]
    assert float(tr.ray_intersect(scene, o, d).t[0]) == pytest.approx(2.5, rel=1e-6)


@pytest.mark.parametrize("others", [("card",), ("ball",), ("card", "ball", "bump")])
def test_the_nearest_of_several_shapes_is_found(others):
    """Beside faces that are listed, beside Embree's shapes, and beside a second height field."""
    shapes = {
        "lens": field(rough(20, 20, 0.1)),
        "card": {"type": "rectangle", "to_world": T.translate([0, 0, 0.35]).rotate([1, 0, 0], 10)},
        "ball": {"type": "sphere", "center": [0.3, 0.1, 0.2], "radius": 0.4},
        "bump": field(rough(5, 6, 0.2, seed=3), to_world=T.translate([0, 0.1, 0.1]).rotate([0, 1, 0], 20).scale(0.7)),
    }
    o, d = (x.float() for x in rays(rough(20, 20, 0.1), torch.eye(4, dtype=DOUBLE), 2000))
    chosen = ("lens", *others)
    alone = [tr.ray_intersect(tr.load_dict({"type": "scene", n: shapes[n]}), o, d) for n in chosen]
    together = tr.load_dict({"type": "scene", **{n: shapes[n] for n in chosen}})
    hits = tr.ray_intersect(together, o, d)
    expected, index = torch.stack([h.t for h in alone]).min(0)
    torch.testing.assert_close(hits.t, expected, rtol=1e-5, atol=1e-5)
    clear = torch.stack([h.t for h in alone]).sort(0).values.diff(dim=0)[0].nan_to_num(1.0) > 1e-4
    assert torch.equal(hits.shape_id[hits.valid & clear], index[hits.valid & clear].int())
    assert len(set(hits.shape_id[hits.valid].tolist())) == len(chosen)
    assert torch.equal(tr.ray_occluded(together, o, d), hits.valid)
    box = together.bounding_box()
    assert bool(
        (hits.position[hits.valid] >= box[0] - 1e-5).all() and (hits.position[hits.valid] <= box[1] + 1e-5).all()
    )


# -------------------------------------------------------------------------------------------------------------- images
def lit(shape: object, dtype: torch.dtype = torch.float32) -> tr.Scene:
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 4},
            "camera": {
                "type": "perspective",
                "fov": 35,
                "to_world": T.look_at([1, -3, 3], [0, 0, 0.2], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
            },
            "lens": shape,
            "floor": {"type": "rectangle", "to_world": T.translate([0, 0, -0.5]).scale(3)},
            "lamp": {
                "type": "rectangle",
                "to_world": T.translate([0.5, 0, 3]).rotate([1, 0, 0], 180).scale(0.6),
                "emitter": {"type": "area", "radiance": 5.0},
            },
        },
        dtype=dtype,
    )


@pytest.mark.parametrize("bsdf", [{"type": "diffuse", "reflectance": 0.6}, {"type": "dielectric", "int_ior": 1.5}])
def test_an_image_is_that_of_the_surface_as_a_fine_mesh(bsdf):
    """With the same light, shadows and chains of refraction. Significance 0.01 for both together."""
    heights = rough(6, 7, 0.4).float()
    v, f, n, uv = tr.heightfield.mesh(heights, T.scale([1, 1, 0.8]), (160, 160))
    smooth = lit(field(heights, to_world=T.scale([1, 1, 0.8]), bsdf=bsdf))
    mesh = lit(tr.Mesh(v, f, n, uv, bsdf=bsdf))
    images = [
        tr.testing.mean_and_variance(lambda s, scene=scene: tr.render(scene, spp=16, seed=s), seeds)
        for scene, seeds in ((smooth, range(16)), (mesh, range(100, 116)))
    ]
    result = tr.testing.z_test(
        images[0][0],
        images[1][0],
        variance=images[0][1],
        reference_variance=images[1][1],
        block=6,
        significance=0.01,
        tests=2,
    )
    assert result, result.message


# ---------------------------------------------------------------------------------------------------- parts of scenes
def test_what_is_wrong_is_named():
    with pytest.raises(ValueError, match=r"lens\.heights: .*not finite"):
        scene_of(torch.tensor([[0.0, float("nan")]]))
    with pytest.raises(ValueError, match=r"lens\.heights: expected heights of shape \(H, W\)"):
        scene_of(torch.zeros(3))
    with pytest.raises(ValueError, match=r"lens\.heights: expected heights of shape \(H, W\) with H, W > 0"):
        scene_of(torch.zeros(0, 3))
    with pytest.raises(ValueError, match=r"lens\.heights: expected a floating-point tensor"):
        scene_of(torch.zeros(3, 3, dtype=torch.int64))
    with pytest.raises(ValueError, match="give one of heights, bitmap and filename; got none"):
        tr.load_dict({"type": "scene", "lens": {"type": "heightfield"}})
    with pytest.raises(ValueError, match=r"lens\.emitter: a height field cannot emit"):
        scene_of(torch.zeros(2, 2), emitter={"type": "area"})
    with pytest.raises(ValueError, match="bspline"):
        scene_of(torch.zeros(2, 2), interpolation="cubic")
    scene = scene_of(torch.zeros(2, 2))
    o, d = torch.zeros(1, 3), torch.ones(1, 3)
    for heights, message in (
        (torch.full((2, 2), float("inf")), r"lens\.heights: has values that are not finite"),
        (torch.full((2, 2), 1e30), "lens: field 'heights': expected heights up to 1e18"),
        (torch.zeros(2, 2, 1), r"lens\.heights.*: expected shape \(H, W\)"),
    ):
        with pytest.raises(ValueError, match=message):
            tr.ray_intersect(scene, o, d, params={"lens.heights": heights})
    assert not bool(tr.ray_intersect(scene, o, -d).valid)  # and goes on


def test_images_give_heights(tmp_path):
    heights = rough(4, 6, 0.1).float()
    tr.io.write_image(tmp_path / "lens.exr", heights[..., None])
    loaded = tr.HeightField(filename=str(tmp_path / "lens.exr"))
    torch.testing.assert_close(loaded.heights.detach(), heights, rtol=1e-3, atol=1e-3)
    assert torch.equal(tr.HeightField(bitmap=heights.numpy()).heights, heights)
    with pytest.raises(ValueError, match="bitmap: expected an image of one channel"):
        tr.HeightField(bitmap=torch.zeros(3, 3, 3))


def down(n: int) -> tuple[torch.Tensor, torch.Tensor]:
    line = torch.linspace(-0.9, 0.9, n)
    x, y = torch.meshgrid(line, line, indexing="ij")
    o = torch.stack([x.flatten(), y.flatten(), torch.full((n * n,), 2.9)], 1)
    return o, torch.tensor([0.0, 0.0, -1.0]).expand_as(o)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_changes_are_seen_and_make_nothing_else_again(dtype):
    scene = lit(field(torch.zeros(5, 5)), dtype)
    o, d = down(7)
    tr.ray_intersect(scene, o, d)
    before = scene.updates
    assert before["height_fields"] == 1
    lens = scene["lens"]
    with torch.no_grad():
        lens.heights += 0.25
    assert tr.ray_intersect(scene, o, d).position[:, 2].tolist() == pytest.approx([0.25] * 49)
    lens.heights.data[:] = 0.5  # without a word
    assert tr.ray_intersect(scene, o, d).position[:, 2].tolist() == pytest.approx([0.5] * 49)
    tr.ray_intersect(scene, o, d)
    assert scene.updates == {**before, "height_fields": 3}
    with torch.no_grad():
        lens.to_world[2, 3] = 1.0
    assert tr.ray_intersect(scene, o, d).position[:, 2].tolist() == pytest.approx([1.5] * 49)
    assert scene.updates == {**before, "height_fields": 3}
    given = torch.full((9, 3), 1.5, dtype=dtype)  # of another size, in this call alone
    found = tr.ray_intersect(scene, o, d, params={"lens.heights": given}).position[:, 2]
    assert found.tolist() == pytest.approx([2.5] * 49)
    assert tr.ray_intersect(scene, o, d).position[:, 2].tolist() == pytest.approx([1.5] * 49)


def test_copies_state_and_finer_heights():
    heights = rough(6, 5, 0.2).float()
    scene = lit(field(heights))
    o, d = down(9)
    z = tr.ray_intersect(scene, o, d).position[:, 2]
    for other in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert torch.equal(tr.ray_intersect(other, o, d).position[:, 2], z)
    other = lit(field(torch.zeros(6, 5)))
    other.load_state_dict(scene.state_dict())
    assert torch.equal(tr.ray_intersect(other, o, d).position[:, 2], z)

    (parameter,) = scene.train_only("lens.heights")
    optimizer = torch.optim.Adam([parameter], lr=0.01)
    tr.ray_intersect(scene, o, d).position[:, 2].sum().backward()
    optimizer.step()
    finer = tr.optim.upsample(scene, "lens.heights", (12, 10), optimizer)
    assert finer.shape == (12, 10) and scene["lens"].heights is finer
    expected = tr.optim.resample(parameter.detach(), (12, 10), "clamp")
    assert torch.equal(finer.detach(), expected)
    tr.ray_intersect(scene, o, d).position[:, 2].sum().backward()
    optimizer.step()
    assert not torch.equal(finer.detach(), expected)


def test_derivatives_of_hits_of_any_mode():
    heights = rough(4, 5, 0.3)
    scene = scene_of(heights, DOUBLE, to_world=PLACES["sheared"])
    o, d = rays(heights, PLACES["sheared"].matrix.to(DOUBLE), 16)
    hits = tr.ray_intersect(scene, o, d)
    assert int(hits.valid.sum()) >= 5
    o, d = o[hits.valid], d[hits.valid]

    def outputs(h: torch.Tensor, m: torch.Tensor, o: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
        found = tr.ray_intersect(scene, o, d, params={"lens.heights": h, "lens.to_world": m})
        return torch.cat([found.t[:, None], found.position, found.normal, found.uv], 1)

    matrix = scene["lens"].to_world.detach().clone()
    free = torch.ones(4, 4, dtype=DOUBLE)
    free[3] = 0
    inputs = [x.clone().requires_grad_() for x in (heights, matrix, o, d)]
    assert torch.autograd.gradcheck(
        lambda h, m, o, d: outputs(h, matrix + (m - matrix) * free, o, d),
        inputs,
        atol=1e-5,
        check_forward_ad=True,
        fast_mode=True,
    )
    assert torch.autograd.gradgradcheck(lambda h: outputs(h, matrix, o, d), inputs[:1], atol=1e-4, fast_mode=True)
