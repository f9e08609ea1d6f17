"""Rough dielectric interfaces: sampler, limits, symmetry, energy and numbers at the ends of their ranges.

Significance 0.01 for all chi-square tests together, and again for the z-tests of images. The images of
`reference_scenes.py`, the derivatives and the oracle are tested where those of all models are.
"""

from __future__ import annotations

import math

import pytest
import torch
from uniform_numbers import direction, uniform

import torchrender as tr

N = 100_000
INTERFACES = [("ggx", 0.3, 1.5), ("ggx", 0.8, 0.7), ("beckmann", 0.3, 0.8), ("beckmann", 1.0, 1.5)]
ANGLES = [20, 80, 120, 175]
DISTRIBUTIONS = ["ggx", "beckmann"]


def rough(distribution: str, alpha: float, eta: float, **more) -> dict:
    return {"type": "roughdielectric", "distribution": distribution, "alpha": alpha, "eta": eta, **more}


def probe(bsdf: dict, dtype: torch.dtype = torch.float64) -> tr.testing.BsdfProbe:
    scene = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    return tr.testing.BsdfProbe(tr.load_dict(scene, dtype=dtype), "ball.bsdf")


def directions(n: int, seed: int) -> torch.Tensor:
    """Directions (n, 3), not uniform, of either side."""
    return torch.nn.functional.normalize(uniform(n, seed) - 0.5, dim=1)


# -------------------------------------------------------------------------------------------------------------- sampler
@pytest.mark.parametrize("theta", ANGLES)
@pytest.mark.parametrize(("distribution", "alpha", "eta"), INTERFACES)
def test_samples_follow_their_density(distribution, alpha, eta, theta):
    of, wi = probe(rough(distribution, alpha, eta, specular_reflectance=0.7)), direction(theta)
    found = of.sample(wi, uniform(N))
    assert not found.delta.any()
    valid = found.pdf > 0
    result = tr.testing.chi2_test(
        found.wo, lambda w: of.eval(wi, w).pdf, valid=valid, tests=len(INTERFACES) * len(ANGLES)
    )
    assert result, result.message
    value, density = of.eval(wi, found.wo[valid])
    torch.testing.assert_close(density, found.pdf[valid], rtol=1e-9, atol=0)
    torch.testing.assert_close(value / density[:, None], found.weight[valid], rtol=1e-9, atol=0)
    reflected = found.wo[valid][:, 2] * wi[2] > 0
    index = eta if wi[2] > 0 else 1 / eta
    expected = torch.where(reflected, 1.0, index).to(torch.float64)
    torch.testing.assert_close(found.eta[valid], expected, rtol=1e-6, atol=0)
    assert reflected.any()
    if index > 1:  # else grazing light is reflected totally
        assert not reflected.all()


@pytest.mark.parametrize(("distribution", "alpha", "eta"), INTERFACES)
def test_weights_are_at_most_one(distribution, alpha, eta):
    """Of visible normals: what is left of a sample is its masking, times the squared index of radiance."""
    of = probe(rough(distribution, alpha, eta))
    for theta in ANGLES:
        found = of.sample(direction(theta), uniform(2000))
        share = found.weight * found.eta[:, None].square()
        assert float(share.max()) <= 1 + 1e-9
        assert float(share.min()) >= 0


@pytest.mark.parametrize(("distribution", "alpha", "eta"), INTERFACES)
def test_reciprocity(distribution, alpha, eta):
    """f(wi, wo) / n_i^2 = f(wo, wi) / n_o^2, with the index n on the side of a direction (Veach 1997, section 5.2)."""
    of = probe(rough(distribution, alpha, eta, specular_reflectance=0.7, specular_transmittance=0.4))
    wi = directions(4000, 2)
    wo = torch.cat([directions(2000, 3), torch.nn.functional.normalize(0.3 * directions(2000, 4) - wi[2000:], dim=1)])
    there, back = of.eval(wi, wo).value, of.eval(wo, wi).value
    refracted = wi[:, 2] * wo[:, 2] < 0
    inside = torch.tensor(eta, dtype=torch.float64)
    index = torch.where(wi[:, 2] > 0, inside, 1 / inside)
    index = torch.where(refracted, index, 1.0)
    scaled = there * (wi[:, 2].abs() * index.square())[:, None]
    torch.testing.assert_close(scaled, back * wo[:, 2:].abs(), rtol=1e-8, atol=1e-12)
    assert (there[refracted] > 0).any()
    assert (there[~refracted] > 0).any()


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("theta", [0, 45, 70, 110, 150])
def test_with_little_roughness_it_is_smooth_glass(distribution, theta):
    more = {"specular_reflectance": 0.7, "specular_transmittance": 0.4}
    glass = probe({"type": "dielectric", "eta": 1.5, **more})
    u, wi = uniform(5000), direction(theta)
    smooth, found = glass.sample(wi, u), probe(rough(distribution, 1e-3, 1.5, **more)).sample(wi, u)
    same = (
        found.wo[:, 2] * smooth.wo[:, 2] > 0
    )  # where the facet's reflectance is on the other side of u, a few are not
    assert same.double().mean() > 0.99
    turn = (found.wo - smooth.wo).norm(dim=1)[same]
    assert turn.median() < 0.005
    assert (turn < 0.1).double().mean() > 0.99
    mean = found.weight.mean(0)
    torch.testing.assert_close(mean, smooth.weight.mean(0), rtol=0.01, atol=0)  # less masking: about alpha


# --------------------------------------------------------------------------------------------------------------- ranges
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_values_are_finite_at_the_ends_of_all_ranges(distribution, dtype):
    heights = [0.0, 1e-30, 1e-20, 1e-10, 1e-7, 1e-4, 0.5, 1.0]
    heights = torch.tensor(heights + [-z for z in heights], dtype=torch.float64)
    wi = torch.stack([(1 - heights.square()).sqrt(), torch.zeros_like(heights), heights], 1)
    ends = torch.tensor([0.0, 1e-8, 0.3, 1 - 2**-24], dtype=torch.float64)
    u = torch.cartesian_prod(ends, ends, ends)
    wi, u = wi.repeat_interleave(len(u), 0).to(dtype), u.repeat(len(wi), 1).to(dtype)
    turned = wi * torch.tensor([-1, 1, 1], dtype=dtype)
    for alpha in (1e-3, 0.1, 10.0):
        for eta in (1e-3, 0.7, 1 - 1e-6, 1.0, 1 + 1e-6, 1.5, 1e3):
            of = probe(rough(distribution, alpha, eta), dtype)
            found = of.sample(wi, u)
            for name in ("wo", "weight", "pdf", "eta"):
                assert torch.isfinite(getattr(found, name)).all(), (name, alpha, eta)
            assert found.pdf.min() >= 0
            share = found.weight * found.eta[:, None].square()
            assert share.max() <= 1 + (1e-2 if dtype == torch.float32 else 1e-6), (alpha, eta)
            torch.testing.assert_close(found.wo.norm(dim=1), torch.ones_like(found.pdf), rtol=1e-5, atol=0)
            for wo in (wi, -wi, turned, -turned, found.wo):
                value, pdf = of.eval(wi, wo)
                assert torch.isfinite(value).all(), (alpha, eta)
                assert torch.isfinite(pdf).all(), (alpha, eta)
            grazing = of.eval(wi, torch.tensor([[0.6, 0.8, 0.0]], dtype=dtype).expand_as(wi))
            assert not grazing.value.any()
            assert not grazing.pdf.any()


def view(bsdf: dict, **objects) -> dict:
    """A ball that a camera looks at, 16 x 16 pixels."""
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 64, "rr_depth": 64},
        "camera": {
            "type": "perspective",
            "fov": 20,
            "to_world": tr.Transform.look_at([0, 0.5, 4], [0, 0, 0]),
            "film": film,
        },
        "ball": {"type": "sphere", "bsdf": bsdf},
        **objects,
    }


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_parameters_out_of_range_have_derivatives_that_lead_back(distribution, dtype):
    """A step of an optimiser may leave the range, or end at an index of 1, where there is no interface."""
    sky = {"type": "envmap", "data": torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(3))}
    scene = tr.load_dict(view(rough(distribution, 0.2, 1.5), sky=sky), dtype=dtype)

    def gradients(alpha: float, eta: float) -> tuple[torch.Tensor, tuple[torch.Tensor, ...]]:
        values = [torch.tensor(x, dtype=dtype, requires_grad=True) for x in (alpha, eta)]
        params = {"ball.bsdf.alpha.value": values[0], "ball.bsdf.eta": values[1]}
        image = tr.render(scene, spp=8, seed=1, params=params, integrator=tr.PathTracer(max_depth=6))
        return image.detach(), torch.autograd.grad(image.square().mean(), values)

    for given, counts_as in (((1e-5, 1.5), (1e-3, 1.5)), ((-0.1, 1.5), (1e-3, 1.5)), ((0.2, 1.0), (0.2, 1.001))):
        image, found = gradients(*given)
        expected, derivatives = gradients(*counts_as)
        torch.testing.assert_close(image, expected)
        torch.testing.assert_close(found, derivatives)
        assert all(torch.isfinite(g) for g in found)
        assert found[0] != 0


# --------------------------------------------------------------------------------------------------------------- images
@pytest.mark.parametrize(
    ("distribution", "alpha", "least", "most"),
    [
        ("ggx", 0.01, 0.995, 1.003),
        ("ggx", 0.5, 0.58, 0.62),
        ("beckmann", 0.01, 0.995, 1.003),
        ("beckmann", 0.5, 0.81, 0.85),
    ],
)
def test_furnace(distribution, alpha, least, most):
    """A ball without absorption under a uniform sky cannot be seen, but for what facets throw onto one another: of that
    what is lost today, since nothing else tells how much.
    """
    scene = tr.load_dict(view(rough(distribution, alpha, 1.5), sky={"type": "constant", "radiance": 1.0}))
    image = tr.render(scene, spp=256, seed=1)
    assert torch.isfinite(image).all()
    assert least < float(image.mean()) < most  # 65536 paths of values of about 1: standard deviation below 0.001


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("side", [1, -1])
def test_light_through_the_surface_by_both_ways_of_sampling(distribution, side):
    """A lamp behind a rough sheet, or before it, found by sampling the lamp, the interface, or both: the same image."""
    sheet = {"type": "rectangle", "to_world": tr.Transform.scale(2), "bsdf": rough(distribution, 0.3, 1.5)}
    place = tr.Transform.look_at([0.4, 0.3, -2.0 * side], [0, 0, 0], [0, 1, 0]) @ tr.Transform.scale(0.5)
    lamp = {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 3.0}}
    scene = view({"type": "null"}, sheet=sheet, lamp=lamp)
    del scene["ball"]
    made = tr.load_dict(scene, dtype=torch.float64)
    means = []
    for emitter, bsdf in ((1, 0), (0, 1), (1, 1)):
        integrator = tr.DirectIllumination(emitter_samples=emitter, bsdf_samples=bsdf, hide_emitters=True)
        runs = [float(tr.render(made, spp=64, seed=s, integrator=integrator).mean()) for s in range(16)]
        means.append((torch.tensor(runs).mean(), torch.tensor(runs).std() / math.sqrt(len(runs))))
    limit = 5  # of a Student variable of at least 15 degrees of freedom: 8 comparisons exceed it with p < 0.002
    for mean, error in means[:2]:
        assert abs(mean - means[2][0]) <= limit * (error.square() + means[2][1].square()).sqrt()
    assert means[2][0] > 0.005
    assert means[2][1] < 0.02 * means[2][0]
