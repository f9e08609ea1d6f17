"""Reconstruction filters: their weights, films that are divided by sums with negative parts, and their derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from oracle.film import camera_samples
from oracle.world import World

import torchrender as tr
from torchrender.wavefront.film import filter_weight

LOBED = [
    {"type": "mitchell"},
    {"type": "mitchell", "B": 0.1, "C": 0.7},
    {"type": "catmullrom"},
    {"type": "lanczos"},
    {"type": "lanczos", "lobes": 2},
]
IDS = ["mitchell", "mitchell-BC", "catmullrom", "lanczos", "lanczos-2"]


def weight(rfilter: dict, x: np.ndarray) -> np.ndarray:
    """Of a sample at distance x: Mitchell and Netravali 1988, eq. 8; a sinc windowed by a wider one."""
    x = np.abs(x)
    if rfilter["type"] == "lanczos":
        lobes = rfilter.get("lobes", 3)
        return np.where(x < lobes, np.sinc(x) * np.sinc(x / lobes), 0.0)
    b, c = (0.0, 0.5) if rfilter["type"] == "catmullrom" else (rfilter.get("B", 1 / 3), rfilter.get("C", 1 / 3))
    inner = (12 - 9 * b - 6 * c) * x**3 + (-18 + 12 * b + 6 * c) * x**2 + 6 - 2 * b
    outer = (-b - 6 * c) * x**3 + (6 * b + 30 * c) * x**2 + (-12 * b - 48 * c) * x + 8 * b + 24 * c
    return np.where(x < 1, inner, np.where(x < 2, outer, 0.0)) / 6


def scene_of(rfilter: dict, dtype: torch.dtype = torch.float64, size: int = 10, **film) -> tr.Scene:
    """A sheet of coloured light that fills the view."""
    texels = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(3))
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 60,
                "to_world": tr.Transform.look_at([0.1, 0.2, 1], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": rfilter, **film},
            },
            "sheet": {
                "type": "rectangle",
                "to_world": tr.Transform.scale([2.0, 2.0, 1.0]),
                "emitter": {"type": "area", "radiance": {"type": "bitmap", "data": texels, "raw": True}},
            },
        },
        dtype=dtype,
    )


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_image_is_the_weighted_mean_of_the_samples(rfilter):
    """Every sample, with the value that it has alone, weighted and summed in NumPy."""
    scene = scene_of(rfilter)
    image = tr.render(scene, spp=4, seed=7).numpy()
    positions, rays, _, _ = camera_samples(World(scene), 7, 4, 0)
    hits = tr.ray_intersect(scene, rays.origins, rays.directions)
    texture = scene.sheet.emitter.radiance
    uv = hits.uv * torch.tensor([7.0, 5.0]).double() - 0.5
    low = torch.floor(uv).long()
    values = 0
    for dx in (0, 1):
        for dy in (0, 1):
            share = torch.where(torch.tensor([dx, dy]) == 1, uv - low, 1 - (uv - low)).prod(1)
            values = values + texture.data[(low[:, 1] + dy) % 5, (low[:, 0] + dx) % 7] * share[:, None]
    x, y = positions.numpy().T
    by_column = weight(rfilter, np.arange(10)[:, None] + 0.5 - x)  # (10, N)
    by_row = weight(rfilter, np.arange(10)[:, None] + 0.5 - y)
    total = np.einsum("rn,cn,nk->rck", by_row, by_column, values.detach().numpy())
    weights = np.einsum("rn,cn->rc", by_row, by_column)
    np.testing.assert_allclose(image, total / weights[..., None], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
@pytest.mark.parametrize("border", [False, True])
def test_a_constant_stays_constant(rfilter, border):
    """Sums with negative parts are divided by: what is 0.7 everywhere is 0.7 in every pixel."""
    scene = scene_of(rfilter, sample_border=border)
    scene.sheet.emitter.radiance = 0.7
    image = tr.render(scene, spp=2, seed=1)
    torch.testing.assert_close(image, torch.full_like(image, 0.7), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_parts_equal_the_whole(rfilter):
    scene = scene_of(rfilter, torch.float32)
    whole = tr.render(scene, spp=3, seed=5)
    assert torch.equal(tr.render(scene, spp=3, seed=5, crop=(2, 3, 5, 6)), whole[2:7, 3:9])
    pixels = torch.tensor([[0, 0], [9, 4], [5, 5], [5, 5]])
    assert torch.equal(tr.render(scene, spp=3, seed=5, pixels=pixels), whole[pixels[:, 0], pixels[:, 1]])


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_the_derivative_is_that_of_the_same_samples(rfilter):
    """The image is linear in the texels: with correlated samples the gradient is exact, and forward mode agrees."""
    scene = scene_of(rfilter)
    texels = scene.sheet.emitter.radiance.data
    texels.requires_grad_()
    adjoint = torch.randn(10, 10, 3, generator=torch.Generator().manual_seed(2)).double()
    image = tr.render(scene, spp=2, seed=4, correlated=True, seed_grad=4)
    gradient = torch.autograd.grad((image * adjoint).sum(), texels)[0]
    expected = float((image * adjoint).detach().sum())
    assert math.isclose(float((gradient * texels.detach()).sum()), expected, rel_tol=1e-8, abs_tol=1e-8)
    tangent = torch.randn(texels.shape, generator=torch.Generator().manual_seed(6)).double()
    name = "sheet.emitter.radiance.data"
    _, moved = torch.func.jvp(
        lambda t: tr.render(scene, spp=2, seed=4, correlated=True, seed_grad=4, params={name: t}),
        (texels.detach(),),
        (tangent,),
    )
    assert math.isclose(float((moved * adjoint).sum()), float((gradient * tangent).sum()), rel_tol=1e-8, abs_tol=1e-8)


@pytest.mark.parametrize("rfilter", [LOBED[0], LOBED[3]], ids=["mitchell", "lanczos"])
def test_adaptive_gradients_reach_negative_lobes(rfilter):
    """An adjoint of one pixel: the samples of all pixels that its lobes reach count, in expectation as without.

    The mean of 200 runs of each: |z| < 5.5 for every texel, exceeded by chance in less than 1e-3 of all tests.
    """
    scene = scene_of(rfilter, torch.float32)
    fine = torch.rand(40, 40, 1, generator=torch.Generator().manual_seed(3))  # about a texel a pixel
    scene.sheet.emitter.radiance = {"type": "bitmap", "data": fine, "raw": True}
    texels = scene.sheet.emitter.radiance.data
    texels.requires_grad_()
    runs: dict[bool, list[torch.Tensor]] = {True: [], False: []}
    for adaptive, found in runs.items():
        for seed in range(200):
            image = tr.render(scene, spp=1, spp_grad=4, seed=seed, adaptive_grad=adaptive)
            found.append(torch.autograd.grad(image[5, 5].sum(), texels)[0].double())
    a, b = (torch.stack(runs[key]) for key in (True, False))
    z = (a.mean(0) - b.mean(0)) / ((a.var(0) + b.var(0)) / 200).sqrt().clamp_min(1e-9)
    assert float(z.abs().max()) < 5.5
    assert float(a.mean(0).min()) < -1e-3  # there are negative lobes


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_first_hits_are_means_beside_outlines(rfilter):
    """Depth is one between those of the samples, also where a negative lobe alone reaches the object."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": rfilter},
            },
            "ball": {"type": "sphere"},
        },
        dtype=torch.float64,
    )
    depth = tr.render(scene, outputs=("depth",), spp=4, seed=0).depth
    seen = depth[depth.isfinite()]
    assert 100 < len(seen) < 24 * 24
    assert float(seen.min()) >= 3 - 1e-9 and float(seen.max()) <= 4


@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_particles_see_the_mean_that_paths_see(rfilter):
    """Light tracing divides by the filter's integral. Means over 30 runs of 16 x 16 pixels: |z| < 5.5 everywhere."""

    def build(integrator: str) -> tr.Scene:
        return tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": integrator, "max_depth": 2},
                "camera": {
                    "type": "perspective",
                    "fov": 50,
                    "to_world": tr.Transform.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": rfilter, "sample_border": True},
                },
                "floor": {"type": "rectangle", "to_world": tr.Transform.scale([0.5, 0.6, 1.0])},
                "bulb": {"type": "point", "position": [0.2, 0.1, 0.7], "intensity": 1.0},
            }
        )

    images = {}
    for integrator, spp in (("path", 16), ("ptracer", 64)):
        scene = build(integrator)
        images[integrator] = torch.stack([tr.render(scene, spp=spp, seed=s).double() for s in range(30)])
    a, b = images["path"], images["ptracer"]
    assert float(a.mean(0).min()) < -1e-4 and float(b.mean(0).min()) < -1e-4
    z = (a.mean(0) - b.mean(0)) / ((a.var(0) + b.var(0)) / 30 + 1e-12).sqrt()
    assert float(z.abs().max()) < 5.5


@pytest.mark.filterwarnings("ignore::torchrender.errors.MissingTermWarning")
@pytest.mark.parametrize("rfilter", LOBED, ids=IDS)
def test_slopes_of_splatted_light(rfilter):
    """The light tracer's derivative by a moving camera, against differences of the image of the same light paths."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "ptracer", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 50,
                "to_world": tr.Transform.look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": rfilter},
            },
            "floor": {"type": "rectangle", "to_world": tr.Transform.scale([3.0, 3.0, 1.0])},
            "bulb": {"type": "point", "position": [0.2, 0.1, 0.7], "intensity": 1.0},
        },
        dtype=torch.float64,
    )
    start, step = scene.camera.to_world.detach().clone(), torch.zeros(4, 4).double()
    step[:3, 3] = torch.tensor([0.3, -0.5, 0.2])

    def image(at: torch.Tensor) -> torch.Tensor:
        settings = {"spp": 8, "seed": 9, "correlated": True, "seed_grad": 9}
        return tr.render(scene, params={"camera.to_world": at}, **settings)

    _, moved = torch.func.jvp(image, (start,), (step,))
    h = 1e-5
    with torch.no_grad():
        difference = (image(start + h * step) - image(start - h * step)) / (2 * h)
    torch.testing.assert_close(moved, difference, rtol=1e-5, atol=1e-6 * float(difference.abs().max()))


def test_the_path_tracer_in_pytorch_has_the_same_weights():
    x = torch.linspace(-3.5, 3.5, 141).double()
    for rfilter in LOBED:
        ours = filter_weight(scene_of(rfilter).sensors[0].film.filter, x).numpy()
        np.testing.assert_allclose(ours, weight(rfilter, x.numpy()), atol=1e-14)


@pytest.mark.parametrize(
    ("rfilter", "message"),
    [
        ({"type": "mitchell", "A": 0.3}, "mitchell has no parameter 'A'"),
        ({"type": "mitchell", "B": 100.0}, "B: expected a number from -8 to 8"),
        ({"type": "lanczos", "lobes": 0}, "lobes: expected"),
        ({"type": "lanczos", "lobes": 99}, "expected 1 to 16 lobes, got 99"),
        ({"type": "lanczos", "lobes": 2.5}, "lobes"),
        ({"type": "catmullrom", "radius": 2.0}, "catmullrom has no parameter 'radius'"),
    ],
)
def test_errors_name_the_place(rfilter, message):
    with pytest.raises((ValueError, TypeError), match=r"camera\.film\.rfilter") as caught:
        scene_of(rfilter)
    assert message in str(caught.value)


def test_filters_are_saved_and_loaded(tmp_path):
    for rfilter in LOBED:
        scene = scene_of(rfilter)
        scene.save(tmp_path / "scene.xml")
        assert tr.load_file(tmp_path / "scene.xml").sensors[0].film.filter == scene.sensors[0].film.filter
