"""Every BSDF of the cases that are compared with Mitsuba: sampler, reciprocity, energy, precision and ends of ranges.

Significance 0.01 for all chi-square tests together. Derivatives are tested in the scenes that contain the models.
"""

from __future__ import annotations

import bsdf_cases
import pytest
import torch
from bsdf_probes import directions, probe
from uniform_numbers import direction, uniform

import torchrender as tr

N = 40_000
ANGLES = [15, 75, 130]
REDNER = {"type": "redner", "diffuse_reflectance": 0.3, "specular_reflectance": bsdf_cases.rgb(0.2, 0.5, 0.7)}
CASES = bsdf_cases.ALL_SMOOTH | {f"redner_{r}": {**REDNER, "roughness": r} for r in (0.05, 0.4, 1.0)}
ROUGH = {  # with alpha or roughness close to 0, the limit that each approaches
    "roughconductor": ({"distribution": "ggx", "material": "Au"}, {"type": "conductor", "material": "Au"}),
    "roughplastic": ({"distribution": "beckmann"}, {"type": "plastic"}),
}


@pytest.mark.parametrize("theta", ANGLES)
@pytest.mark.parametrize("name", CASES)
def test_samples_follow_their_density(name, theta):
    of, wi = probe(CASES[name]), direction(theta)
    found = of.sample(wi, uniform(N))
    valid = (found.pdf > 0) & ~found.delta
    if theta > 90 and not valid.any():  # black from behind
        assert not of.eval(wi, directions(1000, 5)).value.any()
        return
    tests = len(CASES) * len(ANGLES)
    result = tr.testing.chi2_test(found.wo, lambda w: of.eval(wi, w).pdf, valid=valid, tests=tests, tolerance=3e-3)
    assert result, result.message
    value, density = of.eval(wi, found.wo[valid])
    torch.testing.assert_close(density, found.pdf[valid], rtol=1e-9, atol=0)
    torch.testing.assert_close(value / density[:, None], found.weight[valid], rtol=1e-9, atol=0)
    assert float(found.weight.max()) < 3  # times up to 1.6^2 where light leaves the denser side


@pytest.mark.parametrize("name", [n for n in CASES if not n.startswith("hair")])  # where on a fibre depends on wi
def test_reciprocity_of_reflection(name):
    of = probe(CASES[name])
    wi, other = directions(3000, 2), directions(3000, 3)
    wi[:, 2].abs_(), other[:, 2].abs_()
    mirrored = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    wo = torch.nn.functional.normalize(torch.where(wi[:, :1] > 0, other, mirrored + 0.3 * other), dim=1)
    there, back = of.eval(wi, wo).value, of.eval(wo, wi).value
    torch.testing.assert_close(there * wi[:, 2:], back * wo[:, 2:], rtol=1e-9, atol=1e-12)
    assert (there > 0).double().mean() > 0.9


@pytest.mark.parametrize("name", [n for n in CASES if n.startswith(("roughc", "plastic", "roughp", "pplastic"))])
@pytest.mark.parametrize("theta", [0, 60, 85])
def test_nothing_is_gained(name, theta):
    """With white paint and without absorption at most all light comes back: of samples the mean of their weights."""
    white = {"diffuse_reflectance": 1.0, "specular_reflectance": 1.0}
    bsdf = {key: value for key, value in CASES[name].items() if key not in ("material", "nonlinear")}
    bsdf |= white if "plastic" in name else {"specular_reflectance": 1.0}
    found = probe(bsdf).sample(direction(theta), uniform(N))
    mean, error = found.weight.mean(), found.weight[:, 0].std() / N**0.5
    assert mean <= 1 + 4 * error + 2e-3  # the fit of diffuse reflectance is 0.1 % away
    assert mean > 0.2


@pytest.mark.parametrize("name", CASES)
def test_single_precision_gives_the_values_of_double(name):
    wi, wo = (torch.nn.functional.normalize(torch.from_numpy(v).double(), dim=1) for v in bsdf_cases.directions())
    single, double = (probe(CASES[name], dtype).eval(wi.to(dtype), wo.to(dtype)) for dtype in DTYPES)
    for a, b in zip(single, double, strict=True):
        torch.testing.assert_close(a.double(), b, rtol=2e-3, atol=1e-5 * float(b.max()))


DTYPES = (torch.float32, torch.float64)
NUMBERS = ("roughness", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat")
ENDS = [
    *({"type": kind, "alpha": a, **more} for kind in ROUGH for a in (0.0, 1e-4, 1.0) for more in ({}, ROUGH[kind][0])),
    *({"type": "roughplastic", "eta": eta, "diffuse_reflectance": x} for eta in (0.7, 1.0, 3.0) for x in (0.0, 1.0)),
    *(
        {"type": "pplastic", "eta": eta, "alpha": 0.0, "diffuse_reflectance": x}
        for eta in (0.7, 3.0)
        for x in (0.0, 1.0)
    ),
    *({"type": "plastic", "eta": eta, "diffuse_reflectance": x} for eta in (0.7, 1.0, 3.0) for x in (0.0, 1.0)),
    *({"type": "thindielectric", "eta": eta} for eta in (0.7, 1.0, 3.0)),
    *({"type": "redner", "roughness": r, "specular_reflectance": x} for r in (0.0, 1e-4, 1.0) for x in (0.0, 1.0)),
    *({"type": "roughdielectric", "alpha": a} for a in (0.0, 1e-4, 1.0)),
    *(
        {"type": "hair", "longitudinal_roughness": a, "azimuthal_roughness": b, "sigma_a": s, "eta": eta}
        for a, b in ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1.0, 1.0))
        for s, eta in ((0.0, 1.0), (0.0, 1.55), (1e4, 1.0), (1e4, 3.0))
    ),
    *(
        {"type": kind, "alpha_u": a, "alpha_v": b, "distribution": d}
        for kind in ("roughconductor", "roughdielectric")
        for a, b in ((0.0, 1.0), (1.0, 0.0))
        for d in ("beckmann", "ggx")
    ),
    *({"type": "principled", **dict.fromkeys(NUMBERS, x), "base_color": b} for x in (0.0, 1.0) for b in (0.0, 1.0)),
    *({"type": "principled", name: 1.0, "base_color": 0.0} for name in (*NUMBERS, "clearcoat_gloss")),
    {"type": "principled", "eta": 1.0, "spec_trans": 1.0},
    {"type": "principled", "specular": 0.0, "roughness": 0.01, "clearcoat": 1.0, "clearcoat_gloss": 1.0},
    {"type": "principled", "main_specular_sampling_rate": 0.0, "diffuse_reflectance_sampling_rate": 0.0},
]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("bsdf", ENDS, ids=lambda b: "-".join(f"{k}={v}" for k, v in b.items() if k != "type"))
def test_values_are_finite_at_the_ends_of_all_ranges(bsdf, dtype):
    heights = torch.tensor([0.0, 1e-30, 1e-20, 1e-10, 1e-7, 1e-4, 0.5, 1.0], dtype=torch.float64)
    heights = torch.cat([heights, -heights])
    wi = torch.stack([(1 - heights.square()).sqrt(), torch.zeros_like(heights), heights], 1)
    ends = torch.tensor([0.0, 1e-8, 0.3, 1 - 2**-24], dtype=torch.float64)
    u = torch.cartesian_prod(ends, ends, ends)
    wi, u = wi.repeat_interleave(len(u), 0).to(dtype), u.repeat(len(wi), 1).to(dtype)
    turned = wi * torch.tensor([-1, 1, 1], dtype=dtype)
    of = probe(bsdf, dtype)
    found = of.sample(wi, u)
    for name in ("wo", "weight", "pdf", "eta"):
        assert torch.isfinite(getattr(found, name)).all(), name
    assert found.pdf.min() >= 0
    # (a directed lobe that reflects nothing is still sampled: grazing directions are rare there, and weigh more)
    assert found.weight.max() * found.eta.square().min() < (100 if bsdf["type"] == "redner" else 20)
    torch.testing.assert_close(found.wo.norm(dim=1), torch.ones_like(found.pdf), rtol=1e-5, atol=0)
    for wo in (wi, -wi, turned, -turned, found.wo):
        value, pdf = of.eval(wi, wo)
        assert torch.isfinite(value).all()
        assert torch.isfinite(pdf).all()


@pytest.mark.parametrize("kind", ROUGH)
@pytest.mark.parametrize("theta", [0, 45, 70])
def test_with_little_roughness_surfaces_are_smooth(kind, theta):
    settings, smooth = ROUGH[kind]
    u, wi = uniform(20_000), direction(theta)
    expected, found = probe(smooth).sample(wi, u), probe({"type": kind, "alpha": 1e-3, **settings}).sample(wi, u)
    # of what is reflected next to the mirror direction, and of the rest: 5e-3 are 5 standard deviations
    mirrored = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    near = [((s.wo - mirrored).norm(dim=1) < 0.02)[:, None] * s.weight for s in (expected, found)]
    torch.testing.assert_close(near[1].mean(0), near[0].mean(0), rtol=0.02, atol=5e-3)
    torch.testing.assert_close(found.weight.mean(0), expected.weight.mean(0), rtol=0.02, atol=5e-3)


@pytest.mark.parametrize("kind", [*ROUGH, "plastic"])
def test_parameters_out_of_range_have_derivatives_that_lead_back(kind):
    """A step of an optimiser may leave the range: alpha counts as 0.001, with the derivative there."""
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    place = tr.Transform.look_at([0, 0.5, 4], [0, 0, 0])
    objects = {
        "camera": {"type": "perspective", "fov": 20, "to_world": place, "film": film},
        "ball": {"type": "sphere", "bsdf": {"type": kind}},
        "sky": {"type": "envmap", "data": torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(3))},
    }
    scene = tr.load_dict({"type": "scene", **objects}, dtype=torch.float64)
    names = [n for n in ("ball.bsdf.alpha", "ball.bsdf.alpha.value", "ball.bsdf.eta") if n in scene.state_dict()]

    def gradients(values: tuple[float, ...]) -> tuple[torch.Tensor, ...]:
        given = [torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in values]
        image = tr.render(scene, spp=8, seed=1, params=dict(zip(names, given, strict=True)))
        return image.detach(), *torch.autograd.grad(image.square().mean(), given)

    assert names
    number = {"ball.bsdf.eta": 1.0}  # no interface: finite, and not nothing
    out = tuple(number.get(n, -0.1) for n in names)
    counted = tuple(number.get(n, 1e-3) for n in names)
    for found, expected in zip(gradients(out), gradients(counted), strict=True):
        torch.testing.assert_close(found, expected)
        assert torch.isfinite(found).all()
