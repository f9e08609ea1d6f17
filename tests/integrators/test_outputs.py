"""Outputs besides radiance: against ray queries through the same film positions, closed forms, and each other."""

from __future__ import annotations

import pickle
import warnings

import pytest
import reference_scenes
import torch
from output_scenes import ALL, INFINITE, REAL, scene_of, square

import torchrender as tr
from torchrender.first_hit_call import IDENTIFIERS, OUTPUTS


# ----------------------------------------------------------------------------------------------- against ray queries
def camera_rays(scene: tr.Scene, positions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays through film positions (N, 2) (row, column) in pixels."""
    camera = scene.sensors[0]
    height, width = camera.film.height, camera.film.width
    matrix = camera.to_world.detach().double()
    slope = torch.tan(torch.deg2rad(camera.x_fov.detach().double()) / 2)
    x = 2 * (positions[:, 1] / width + float(camera.principal_point_offset_x))
    y = 2 * (positions[:, 0] / height + float(camera.principal_point_offset_y))
    local = torch.stack([(1 - x) * slope, (1 - y) * slope * height / width, torch.ones_like(x)], 1)
    local = local / local.norm(dim=1, keepdim=True)
    directions = local @ matrix[:3, :3].T
    return matrix[:3, 3] + directions * (float(camera.near_clip) / local[:, 2:]), directions


def film_positions(height: int, width: int, spp: int, seed: int) -> torch.Tensor:
    """Where the camera's samples are on the film: (height, width, spp, 2), row and column."""
    core = tr.backends.ready()
    found = torch.empty(height, width, spp, 2, dtype=torch.float64)
    for y in range(height):
        for x in range(width):
            for s in range(spp):
                u = core.philox(seed, 0, (y + 32768) << 16 | (x + 32768), s, 0)
                found[y, x, s] = torch.tensor([y + u[1], x + u[0]])
    return found


@pytest.mark.parametrize("name", ["shapes", "mesh", "area"])
def test_outputs_are_averages_of_what_rays_hit(name):
    """The same film positions, their rays made here and traced by `ray_intersect`."""
    size, spp = 12, 3
    scene = scene_of(name, size, dtype=torch.float64)
    positions = film_positions(size, size, spp, seed=7).reshape(-1, 2)
    hits = tr.ray_intersect(scene, *camera_rays(scene, positions))
    assert 0.2 < float(hits.valid.double().mean()) < 0.99
    matrix = scene.sensors[0].to_world.detach()
    relative = hits.position - matrix[:3, 3]
    values = {
        "depth": relative @ matrix[:3, 2],
        "distance": relative.norm(dim=1),
        "position": hits.position,
        "normal": hits.normal,
        "shading_normal": hits.shading_normal,
        "normal_camera": hits.normal @ matrix[:3, :3],
        "shading_normal_camera": hits.shading_normal @ matrix[:3, :3],
        "uv": hits.uv,
    }
    found = tr.render(scene, spp=spp, seed=7, outputs=(*values, *IDENTIFIERS))
    count = hits.valid.reshape(size, size, spp).sum(2)
    for output, value in values.items():
        value = value.reshape(size * size * spp, -1)
        value = torch.where(hits.valid[:, None], value, 0).reshape(size, size, spp, -1).sum(2)
        missed = torch.tensor(float("inf") if output in INFINITE else 0.0, dtype=torch.float64)
        expected = torch.where(count[..., None] > 0, value / count[..., None].clamp(min=1), missed)
        actual = getattr(found, output).reshape(expected.shape)
        # rays are made in another order of operations here, and hits of curved shapes have single precision
        torch.testing.assert_close(actual, expected, rtol=1e-4, atol=1e-4, msg=lambda m, o=output: f"{o}: {m}")

    centres = torch.cartesian_prod(torch.arange(size) + 0.5, torch.arange(size) + 0.5).double()
    middle = tr.ray_intersect(scene, *camera_rays(scene, centres))
    assert torch.equal(found.shape_id.flatten(), middle.shape_id)
    assert torch.equal(found.prim_id.flatten(), middle.prim_id)
    assert found.shape_id.dtype == torch.int32 and found.prim_id.dtype == torch.int32


def test_filters_weight_samples():
    """A Gaussian average of depths over a slanted plate, pixel by pixel, from the film positions."""
    size, spp = 5, 4
    scene = square(size=size, rfilter="gaussian", dtype=torch.float64)
    with torch.no_grad():
        turned = tr.Transform.rotate([0, 1, 0], 25) @ tr.Transform.scale([9, 9, 1])
        scene.get_parameter("plate.to_world").copy_(torch.as_tensor(turned.matrix))
    positions = film_positions(size, size, spp, seed=3).reshape(-1, 2)
    depth = 5 - tr.ray_intersect(scene, *camera_rays(scene, positions)).position[:, 2]
    pixels = torch.cartesian_prod(torch.arange(size) + 0.5, torch.arange(size) + 0.5)
    offsets = (pixels[:, None] - positions[None]).abs()
    weights = torch.where(offsets < 2, torch.exp(-2 * offsets**2) - torch.exp(torch.tensor(-8.0)), 0).prod(2)
    found = tr.render(scene, spp=spp, seed=3, outputs=("depth",), sampler="independent").depth
    torch.testing.assert_close(found.flatten(), (weights * depth).sum(1) / weights.sum(1), rtol=1e-6, atol=1e-6)


# ------------------------------------------------------------------------------------------------------ closed forms
def test_plane_and_misses():
    scene = square(size=12)
    found = tr.render(scene, spp=16, seed=1, outputs=("rgb", "alpha", *REAL, *IDENTIFIERS))
    inside = found.shape_id == 0
    covered, missed = found.alpha == 1, found.alpha == 0
    assert bool(inside.any()) and bool(missed.any()) and bool((~covered & ~missed).any())
    hit = ~missed  # a pixel that is half covered has the depth of its covered half
    torch.testing.assert_close(found.depth[hit], torch.full_like(found.depth[hit], 5.0), rtol=1e-6, atol=0)
    assert bool((found.depth[missed] == float("inf")).all()) and bool((found.position[missed] == float("inf")).all())
    for name in ("normal", "shading_normal", "uv", "albedo"):
        assert bool((getattr(found, name)[missed] == 0).all())
    assert bool((found.distance[hit] >= found.depth[hit] * (1 - 1e-6)).all())
    for name in ("normal", "shading_normal"):
        towards_camera = torch.tensor([0.0, 0.0, 1.0]).expand(int(hit.sum()), 3)
        torch.testing.assert_close(getattr(found, name)[hit], towards_camera)
        torch.testing.assert_close(getattr(found, f"{name}_camera")[hit], -towards_camera)
    torch.testing.assert_close(found.uv[hit], (found.position[hit][:, :2] + 1) / 2, rtol=1e-5, atol=1e-6)
    assert bool(((found.shape_id == -1) == (found.prim_id == -1)).all()) and bool((found.shape_id[missed] == -1).all())


def test_sphere_normals_point_away_from_its_centre():
    ball = {"type": "sphere", "center": [0.2, -0.1, 1.0], "radius": 0.8, "bsdf": {"type": "dielectric"}}
    scene = square(size=24, ball=ball)
    found = tr.render(scene, spp=1, seed=1, outputs=("position", "normal", "shading_normal", "shape_id"))
    near = (found.position - torch.tensor([0.2, -0.1, 1.0])).norm(dim=2)
    on_ball = (near - 0.8).abs() < 1e-4
    assert int(on_ball.sum()) > 20
    expected = (found.position[on_ball] - torch.tensor([0.2, -0.1, 1.0])) / 0.8
    torch.testing.assert_close(found.normal[on_ball], expected, rtol=0, atol=2e-4)
    torch.testing.assert_close(found.shading_normal[on_ball], expected, rtol=0, atol=2e-4)


@pytest.mark.parametrize(
    ("bsdf", "albedo"),
    [
        ({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.5, 0.9]}}, (0.1, 0.5, 0.9)),
        ({"type": "conductor", "specular_reflectance": 0.7, "eta": 0.2, "k": 3.0}, (0.7, 0.7, 0.7)),
        ({"type": "dielectric"}, (1, 1, 1)),
        ({"type": "dielectric", "specular_transmittance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}, (0.2, 0.4, 0.6)),
        ({"type": "null"}, (1, 1, 1)),
        (
            {
                "type": "twosided",
                "front": {"type": "diffuse", "reflectance": 0.3},
                "rear": {"type": "diffuse", "reflectance": 0.8},
            },
            (0.3, 0.3, 0.3),
        ),
    ],
    ids=lambda v: v["type"] if isinstance(v, dict) else "",
)
def test_albedo_of_models(bsdf, albedo):
    scene = square(bsdf)
    found = tr.render(scene, spp=2, seed=1, outputs=("albedo", "shape_id"))
    seen = found.albedo[found.shape_id == 0]
    torch.testing.assert_close(seen, torch.tensor(albedo, dtype=torch.float32).expand_as(seen))
    if bsdf["type"] == "twosided":
        with torch.no_grad():
            scene.get_parameter("plate.to_world").copy_(torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0])))
        behind = tr.render(scene, spp=2, seed=1, outputs=("albedo",)).albedo[found.shape_id == 0]
        torch.testing.assert_close(behind, torch.full_like(behind, 0.8))


def test_albedo_of_a_texture_is_the_texture():
    data = torch.rand(6, 6, 3, generator=torch.Generator().manual_seed(1))
    bsdf = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest"}}
    scene = square(bsdf, size=12)
    found = tr.render(scene, spp=1, seed=1, outputs=("albedo", "uv", "alpha"))
    hit = found.alpha == 1
    texel = (found.uv[hit] * 6).long()
    assert torch.equal(found.albedo[hit], data[texel[:, 1], texel[:, 0]])


def test_hidden_emitters_are_not_seen():
    """What the rays of the path tracer pass through is no first surface."""
    description = dict(reference_scenes.SCENES["hidden_and_null"]().scene)
    scene = tr.load_dict(description)
    lamp = list(scene._modules).index("lamp") if "lamp" in scene._modules else None
    assert lamp is not None
    hidden = tr.render(scene, spp=4, seed=1, outputs=("shape_id", "depth", "alpha"))
    seen = tr.render(scene, spp=4, seed=1, outputs=("shape_id", "depth"), integrator=tr.PathTracer(hide_emitters=False))
    differs = hidden.shape_id != seen.shape_id
    assert int(differs.sum()) > 20
    assert len(seen.shape_id[differs].unique()) == 1  # the lamp
    assert bool((hidden.depth[differs] >= seen.depth[differs]).all())


# --------------------------------------------------------------------------------------------------------- variance
@pytest.mark.parametrize(("rfilter", "low", "high"), [("box", 0.85, 1.15), ("gaussian", 0.95, 1.45)])
def test_variance_is_that_of_the_image(rfilter, low, high):
    """The mean of the estimates against the spread of 300 independent images, pooled over the image.

    Measured: the ratio of the two has a standard deviation of 0.04, and a mean of 1.00 with the box and, since the
    samples of neighbouring pixels are not drawn from one distribution, 1.17 with the Gaussian filter.
    """
    scene = scene_of("area", 5, rfilter)
    scene.integrator.max_depth = 2
    settings = {"spp": 24, "sampler": "independent"}  # whose variance is seen in samples
    results = [tr.render(scene, **settings, seed=s, outputs=("rgb", "variance")) for s in range(300)]
    images = torch.stack([r.rgb for r in results]).double()
    estimates = torch.stack([r.variance for r in results]).double()
    assert low < float(estimates.mean(0).sum() / images.var(0).sum()) < high
    passes = tr.render(scene, **settings, seed=0, passes=2, outputs=("variance",)).variance
    torch.testing.assert_close(float(passes.mean()), float(estimates.mean()) / 2, rtol=0.3, atol=0)


def test_variance_of_one_sample_is_unknown_and_of_a_constant_zero():
    scene = square(sky={"type": "constant", "radiance": 2.0})
    scene.get_parameter("plate.bsdf.reflectance.value").data.zero_()
    assert bool((tr.render(scene, spp=1, seed=1, outputs=("variance",)).variance == float("inf")).all())
    found = tr.render(scene, spp=8, seed=1, outputs=("rgb", "variance", "alpha"))
    assert float(found.variance[found.alpha == 0].max()) < 1e-12
    edge = (found.alpha > 0) & (found.alpha < 1)
    share = found.alpha[edge]
    # black or 2 with these frequencies: 4 p (1 - p) / (n - 1)
    expected = (4 * share * (1 - share) / 7).unsqueeze(-1).expand(-1, 3)
    torch.testing.assert_close(found.variance[edge], expected, rtol=1e-4, atol=1e-6)


# ------------------------------------------------------------------------------------------------------ consistency
@pytest.mark.parametrize("rfilter", ["box", "tent"])
def test_outputs_are_the_same_whatever_else_is_asked_for(rfilter):
    """Bit for bit: any set of outputs, any number of threads, crops, lists of pixels."""
    scene = scene_of("mesh", 20, rfilter)
    whole = tr.render(scene, spp=70, seed=2, outputs=ALL)
    assert type(whole).__name__ == "Outputs" and whole._fields == ALL
    assert torch.equal(whole.rgb, tr.render(scene, spp=70, seed=2))
    for name in ALL:
        assert torch.equal(tr.render(scene, spp=70, seed=2, outputs=(name,))[0], getattr(whole, name)), name
    pixels = torch.tensor([[3, 17], [0, 0], [19, 19], [3, 17], [15, 16]])
    kept = torch.get_num_threads()
    try:
        for threads in (1, 2, 8):
            torch.set_num_threads(threads)
            again = tr.render(scene, spp=70, seed=2, outputs=ALL)
            part = tr.render(scene, spp=70, seed=2, outputs=ALL, crop=(4, 2, 9, 13))
            some = tr.render(scene, spp=70, seed=2, outputs=ALL, pixels=pixels)
            for name in ALL:
                expected = getattr(whole, name)
                assert torch.equal(getattr(again, name), expected), name
                assert torch.equal(getattr(part, name), expected[4:13, 2:15]), name
                assert torch.equal(getattr(some, name), expected[pixels[:, 0], pixels[:, 1]]), name
    finally:
        torch.set_num_threads(kept)


def test_shapes_in_layouts_and_batches():
    scene = square(size=6)
    channels = {n: 3 if c == -1 else c for n, c in OUTPUTS.items() if n in ALL}
    found = tr.render(scene, sensor=[0, 0], spp=2, seed=1, outputs=ALL, layout="bchw")
    for name, count in channels.items():
        assert getattr(found, name).shape == ((2, 6, 6) if count == 0 else (2, count, 6, 6)), name
    alone = tr.render(scene, spp=2, seed=1, outputs=ALL, layout="chw")
    for name in ALL:
        assert torch.equal(getattr(found, name)[1], getattr(alone, name)), name
    mono = tr.render(square(variant="mono"), spp=2, seed=1, outputs=("albedo", "variance", "normal"))
    assert mono.albedo.shape == (6, 6, 1) and mono.variance.shape == (6, 6, 1) and mono.normal.shape == (6, 6, 3)


def test_outputs_are_pickled_and_are_a_tree_to_torch():
    scene = square()
    found = tr.render(scene, spp=2, seed=1, outputs=("rgb", "depth", "shape_id"))
    other = pickle.loads(pickle.dumps(found))
    assert other._fields == found._fields and all(torch.equal(a, b) for a, b in zip(other, found, strict=True))
    reflectance = scene.get_parameter("plate.bsdf.reflectance.value").detach()

    def outputs(value):
        return tr.render(
            scene, spp=2, seed=1, outputs=("albedo", "rgb"), params={"plate.bsdf.reflectance.value": value}
        )

    values, tangents = torch.func.jvp(outputs, (reflectance,), (torch.ones_like(reflectance),))
    assert tangents._fields == values._fields == ("albedo", "rgb")
    assert float(tangents.albedo.max()) == 1


def test_passes_average_over_all_hits():
    """Not over the averages of passes: a pixel that only one pass hits has its value."""
    scene = square(size=14)
    both = tr.render(scene, spp=1, seed=5, passes=2, outputs=("position", "alpha"))
    first, second = (tr.render(scene, spp=1, seed=s, outputs=("position", "alpha")) for s in (5, tr.seeds.mix(5, 1)))
    hits = first.alpha + second.alpha
    assert bool((hits == 1).any())
    finite = [torch.where(r.alpha[..., None] > 0, r.position, 0) for r in (first, second)]
    expected = (finite[0] + finite[1]) / hits[..., None]
    torch.testing.assert_close(both.position[hits > 0], expected[hits > 0], rtol=1e-6, atol=1e-7)


# ------------------------------------------------------------------------------------------------------ derivatives
def test_what_has_no_derivative_says_so():
    scene = scene_of("area")
    scene.train_only("floor.bsdf.reflectance.*")
    found = tr.render(scene, spp=2, seed=1, outputs=ALL)
    for name in ("alpha", "variance", *IDENTIFIERS):
        assert not getattr(found, name).requires_grad, name
    assert found.rgb.requires_grad and found.albedo.requires_grad


def test_coverage_of_moving_surfaces_is_warned_about_once():
    scene = scene_of("area")
    scene.train_only("floor.bsdf.reflectance.*")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tr.render(scene, spp=1, outputs=("rgb", "alpha"))  # colours do not move outlines
    (matrix,) = scene.train_only("*.to_world")[:1]
    with pytest.warns(tr.MissingTermWarning) as caught:
        tr.render(scene, spp=1, spp_visibility=0)
        found = tr.render(scene, spp=1, outputs=("alpha",), spp_visibility=0)
        tr.render(scene, spp=1, outputs=("alpha",), spp_visibility=0)
        assert tr.render(scene, spp=1, outputs=("alpha",)).alpha.requires_grad
    assert [("alpha carries no derivative" in str(w.message)) for w in caught] == [False, True]
    assert matrix.requires_grad and not found.alpha.requires_grad


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("variant", ["mono", "rgb"])
def test_derivative_of_albedo(rfilter, variant):
    """Linear in the texels: a finite difference with the same samples is exact, forward and reverse mode alike."""
    scene = scene_of("shapes", 10, rfilter, variant=variant, dtype=torch.float64)
    names, parameters = zip(
        *((n, p) for n, p in scene.named_parameters() if "reflectance" in n and "to_uv" not in n), strict=True
    )
    scene.train_only(*names)
    settings = {"spp": 5, "seed": 3, "correlated": True, "passes": 2}

    def albedo(*values, **more) -> torch.Tensor:
        params = dict(zip(names, values, strict=True))
        return tr.render(scene, params=params, outputs=("albedo",), **settings, **more).albedo

    values = tuple(p.detach() for p in parameters)
    generator = torch.Generator().manual_seed(2)
    tangents = tuple(torch.randn(v.shape, generator=generator, dtype=v.dtype) for v in values)
    base, tangent = torch.func.jvp(albedo, values, tangents)
    moved = albedo(*(v + 0.25 * t for v, t in zip(values, tangents, strict=True)))
    torch.testing.assert_close(tangent, (moved - base) / 0.25, rtol=1e-9, atol=1e-12)
    weight = torch.rand(base.shape, generator=generator, dtype=base.dtype)
    gradients = torch.autograd.grad((albedo(*parameters) * weight).sum(), parameters)
    by_reverse = sum(float((g * t).sum()) for g, t in zip(gradients, tangents, strict=True))
    assert abs(by_reverse - float((tangent * weight).sum())) < 1e-10 * float(tangent.abs().sum())
    # of some pixels: those of the whole
    pixels = torch.tensor([[4, 4], [9, 2], [4, 4]])
    listed = torch.autograd.grad(albedo(*parameters, pixels=pixels).sum(), parameters)
    counts = torch.zeros_like(base)
    counts.index_put_((pixels[:, 0], pixels[:, 1]), torch.ones(3, base.shape[2], dtype=base.dtype), accumulate=True)
    expected = torch.autograd.grad((albedo(*parameters) * counts).sum(), parameters)
    torch.testing.assert_close(listed, expected, rtol=1e-10, atol=1e-13)


def test_derivatives_of_radiance_and_albedo_add_up():
    scene = scene_of("area", dtype=torch.float64)
    (reflectance,) = scene.train_only("floor.bsdf.reflectance.value")

    def gradient(*wanted: str) -> torch.Tensor:
        found = tr.render(scene, spp=3, seed=1, outputs=("rgb", "albedo", "shape_id", "depth"))
        return torch.autograd.grad(sum(getattr(found, n).sum() for n in wanted), reflectance)[0]

    torch.testing.assert_close(gradient("rgb", "albedo"), gradient("rgb") + gradient("albedo"))
