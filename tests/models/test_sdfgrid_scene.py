"""Grids of signed distances as parts of scenes: files, changes, images, light in and around them."""

from __future__ import annotations

import copy
import pickle
import warnings

import pytest
import torch
from sdf_grids import DOUBLE, PAINT, PLACES, T, coordinates, dented, lit, rays, scene_of, shape

import torchrender as tr


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
