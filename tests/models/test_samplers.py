"""Every sampler against its density (chi-square), its weight (value over density) and the directions it may give.

Significance 0.01 for the whole file, corrected for its number of chi-square tests.
"""

from __future__ import annotations

import math

import pytest
import torch
from uniform_numbers import direction, uniform

import torchrender as tr

N = 200_000
TESTS = 20  # chi-square tests below


def scene_of(**objects) -> tr.Scene:
    camera = {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}}
    return tr.load_dict({"type": "scene", "camera": camera, **objects}, dtype=torch.float64)


def with_bsdf(bsdf: dict) -> tr.testing.BsdfProbe:
    scene = scene_of(ball={"type": "sphere", "bsdf": bsdf})
    return tr.testing.BsdfProbe(scene, "ball.bsdf")


SMOOTH = {
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.8]}},
    "twosided": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.7}},
}


# ---------------------------------------------------------------------------------------------------------------- BSDFs
@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("theta", [0, 40, 80, 120])
def test_bsdf_samples_follow_their_density(name, theta):
    probe, wi = with_bsdf(SMOOTH[name]), direction(theta)
    wo, weight, pdf, _, delta = probe.sample(wi, uniform(N))
    assert not delta.any()
    if theta > 90 and name == "diffuse":  # black from behind
        assert not pdf.any() and not weight.any()
        return
    result = tr.testing.chi2_test(wo, lambda w: probe.eval(wi, w).pdf, tests=TESTS)
    assert result, result.message
    value, density = probe.eval(wi, wo)
    torch.testing.assert_close(density, pdf, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(value / density[:, None], weight, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", SMOOTH)
def test_reciprocity(name):
    probe = with_bsdf(SMOOTH[name])
    wi, wo = (torch.nn.functional.normalize(uniform(1000, s) - 0.5, dim=1) for s in (2, 3))
    there, back = probe.eval(wi, wo).value, probe.eval(wo, wi).value
    torch.testing.assert_close(there * wi[:, 2:].abs(), back * wo[:, 2:].abs(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("theta", [0, 45, 85])
def test_a_white_diffuse_surface_reflects_everything(theta):
    _, weight, *_ = with_bsdf({"type": "diffuse", "reflectance": 1.0}).sample(direction(theta), uniform(1000))
    torch.testing.assert_close(weight, torch.ones_like(weight))


def test_null_passes_on():
    wi = direction(70)
    wo, weight, pdf, eta, delta = with_bsdf({"type": "null"}).sample(wi, uniform(10))
    torch.testing.assert_close(wo, -wi.expand(10, 3))
    assert delta.all() and (weight == 1).all() and (pdf == 1).all() and (eta == 1).all()


# Values of the dielectric with reflectance 0.3 and transmittance 0.6 at normal incidence, eta 1.5, as Mitsuba 3's tests
# have them; Fresnel reflectance there is ((1.5 - 1) / (1.5 + 1))^2 = 0.04.
def test_dielectric_at_normal_incidence():
    bsdf = {
        "type": "dielectric",
        "int_ior": 1.5,
        "ext_ior": 1.0,
        "specular_reflectance": 0.3,
        "specular_transmittance": 0.6,
    }
    probe = with_bsdf(bsdf)
    u = torch.tensor([[0.0, 0, 0], [0.5, 0, 0]], dtype=torch.float64)
    wo, weight, pdf, eta, delta = probe.sample(direction(0), u)
    torch.testing.assert_close(weight[:, 0], torch.tensor([0.3, 0.6 / 1.5**2], dtype=torch.float64))
    torch.testing.assert_close(pdf, torch.tensor([0.04, 0.96], dtype=torch.float64))
    torch.testing.assert_close(eta, torch.tensor([1.0, 1.5], dtype=torch.float64))
    assert wo[:, 2].tolist() == [1, -1] and delta.all()
    inside = probe.sample(-direction(0), u)
    torch.testing.assert_close(inside.weight[:, 0], torch.tensor([0.3, 0.6 * 1.5**2], dtype=torch.float64))
    torch.testing.assert_close(inside.eta, torch.tensor([1.0, 1 / 1.5], dtype=torch.float64))


# Reflectance at 45, 80 degrees from outside and 45 from inside (total internal reflection), and the refracted angle:
# Born and Wolf, section 1.5.2.
@pytest.mark.parametrize(
    ("theta", "reflectance", "refracted"),
    [(45, 0.050239911012235954, 28.1255057020557), (80, 0.387704354691473, 41.03641052520335), (135, 1.0, None)],
)
def test_dielectric_fresnel(theta, reflectance, refracted):
    probe = with_bsdf({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    wi = direction(theta)
    samples = probe.sample(wi, uniform(1000))
    reflected = samples.wo[:, 2] * wi[2] > 0
    torch.testing.assert_close(
        samples.pdf[reflected], torch.full_like(samples.pdf[reflected], reflectance), rtol=1e-6, atol=0
    )
    if refracted is None:
        assert reflected.all()
    else:
        cosine = samples.wo[~reflected][:, 2].abs()
        torch.testing.assert_close(cosine, torch.full_like(cosine, math.cos(math.radians(refracted))))


def test_an_interface_between_equal_media_is_not_there():
    probe = with_bsdf({"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.3})
    for theta in (0, 30, 89.9, 150):
        samples = probe.sample(direction(theta), uniform(100))
        torch.testing.assert_close(samples.wo, -direction(theta).expand(100, 3))
        torch.testing.assert_close(samples.weight, torch.ones_like(samples.weight))


def test_conductor_with_a_real_index_reflects_like_a_dielectric():
    metal = with_bsdf({"type": "conductor", "eta": 1.5, "k": 0.0})
    glass = with_bsdf({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    for theta in (0, 30, 60, 85):
        reflectance = glass.sample(direction(theta), torch.zeros(1, 3)).pdf
        torch.testing.assert_close(
            metal.sample(direction(theta), torch.zeros(1, 3)).weight[:, 0], reflectance, rtol=1e-6, atol=0
        )
    assert metal.sample(direction(120), torch.zeros(1, 3)).pdf.item() == 0


# ------------------------------------------------------------------------------------------------------------- emitters
def rectangle(emitter: dict) -> dict:
    place = tr.Transform.translate([0.3, 0.2, 2.0]) @ tr.Transform.rotate([0, 1, 0], 160)
    return {"type": "rectangle", "to_world": place, "emitter": emitter}


def image(h: int, w: int, seed: int = 5) -> torch.Tensor:
    return torch.rand(h, w, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def bright_spot() -> torch.Tensor:
    data = 0.05 + 0.1 * image(16, 32)
    data[4, 20] = 30.0
    return data


LIGHTS = {
    "rectangle": {"lamp": rectangle({"type": "area", "radiance": 3.0})},
    "textured rectangle": {
        "lamp": rectangle({"type": "area", "radiance": {"type": "bitmap", "data": image(4, 8), "raw": True}})
    },
    "sphere": {
        "lamp": {
            "type": "sphere",
            "center": [1.0, 0.5, 1.0],
            "radius": 0.7,
            "emitter": {"type": "area", "radiance": 1.0},
        }
    },
    "sphere from inside": {
        "lamp": {"type": "sphere", "radius": 2.0, "flip_normals": True, "emitter": {"type": "area", "radiance": 1.0}}
    },
    "disk": {
        "lamp": {
            "type": "disk",
            "to_world": tr.Transform.translate([0, 0, -1.5]) @ tr.Transform.scale([1.0, 0.6, 1.0]),
            "emitter": {"type": "area", "radiance": 1.0},
        }
    },
    "cube": {
        "lamp": {
            "type": "cube",
            "to_world": tr.Transform.translate([0, 0.5, 3.0]),
            "emitter": {"type": "area", "radiance": 1.0},
        }
    },
    "constant": {"sky": {"type": "constant", "radiance": 0.5}},
    "envmap": {"sky": {"type": "envmap", "data": image(12, 24)}},
    "envmap with a bright spot": {
        "sky": {"type": "envmap", "data": bright_spot(), "to_world": tr.Transform.rotate([1, 0, 0], 50)}
    },
    "sky and lamp": {
        "sky": {"type": "envmap", "data": image(8, 16)},
        "lamp": {
            "type": "sphere",
            "center": [0.0, 3.0, 0.0],
            "radius": 1.0,
            "emitter": {"type": "area", "radiance": 2.0},
        },
    },
}


@pytest.mark.parametrize("name", LIGHTS)
def test_emitter_samples_follow_their_density(name):
    scene = scene_of(**LIGHTS[name])
    p = torch.tensor([0.1, -0.2, 0.15], dtype=torch.float64)
    samples = tr.testing.sample_emitters(scene, p, uniform(N))
    valid = samples.pdf > 0
    result = tr.testing.chi2_test(
        samples.direction,
        lambda d: tr.testing.emitter_density(scene, p, d).pdf,
        valid=visible(scene, name, p, samples) & valid,
        tests=TESTS,
        tolerance=3e-3,  # edges of lights cut through the cells of the quadrature
    )
    assert result, result.message


def visible(scene: tr.Scene, name: str, p: torch.Tensor, samples) -> torch.Tensor:
    """Samples that arrive: a density in a direction belongs to what is met first."""
    limit = torch.where(samples.distance.isinf(), samples.distance, samples.distance * 0.999)
    return ~tr.ray_occluded(scene, p.expand_as(samples.direction), samples.direction, limit)


@pytest.mark.parametrize("name", LIGHTS)
def test_emitter_samples_and_rays_see_the_same(name):
    scene = scene_of(**LIGHTS[name])
    p = torch.tensor([0.1, -0.2, 0.15], dtype=torch.float64)
    samples = tr.testing.sample_emitters(scene, p, uniform(4000, 9))
    seen = visible(scene, name, p, samples) & (samples.pdf > 0)
    assert seen.float().mean() > 0.15
    found = tr.testing.emitter_density(scene, p, samples.direction)
    # rays are traced in single precision: a few go past an edge
    close = ((found.pdf - samples.pdf).abs() < 1e-3 * samples.pdf)[seen]
    assert close.float().mean() > 0.995
    error = (found.radiance - samples.radiance).abs().amax(1)[seen]
    assert (error < 1e-3 * samples.radiance.abs().max()).float().mean() > 0.99


def test_point_light():
    light = {"type": "point", "position": [1.0, 2.0, 3.0], "intensity": {"type": "rgb", "value": [4, 5, 6]}}
    scene = scene_of(lamp=light)
    samples = tr.testing.sample_emitters(scene, torch.zeros(1, 3), torch.full((1, 3), 0.5))
    torch.testing.assert_close(samples.distance, torch.tensor([14.0], dtype=torch.float64).sqrt())
    torch.testing.assert_close(samples.radiance[0] * 14, torch.tensor([4.0, 5.0, 6.0], dtype=torch.float64))
    assert samples.pdf.item() == 1


def test_sampling_weights_choose_among_emitters():
    lamps = {
        f"lamp{i}": {"type": "point", "position": [float(i), 1.0, 0.0], "intensity": 1.0, "sampling_weight": w}
        for i, w in enumerate([1.0, 3.0, 0.0, 4.0])
    }
    samples = tr.testing.sample_emitters(scene_of(**lamps), torch.zeros(1, 3), uniform(80_000))
    x = (samples.direction[:, 0] / samples.direction[:, 1]).round()
    frequency = torch.stack([(x == i).double().mean() for i in range(4)])
    expected = torch.tensor([1.0, 3.0, 0.0, 4.0], dtype=torch.float64) / 8
    # four frequencies at 4.5 standard deviations: significance 3e-5
    assert ((frequency - expected).abs() <= 4.5 * (expected * (1 - expected) / 80_000).sqrt()).all()
    torch.testing.assert_close(samples.pdf, expected[x.long()])


# --------------------------------------------------------------------------------------------------- random numbers
def test_philox_known_answer_and_uniformity():
    from torchrender import backends

    core = backends.ready()
    numbers = torch.tensor([core.philox(3, 0, pixel, sample, 1) for pixel in range(64) for sample in range(64)])
    assert ((numbers >= 0) & (numbers < 1)).all()
    assert (numbers * 2**24 == (numbers * 2**24).round()).all()
    counts = torch.stack([torch.histc(numbers[:, i].double(), 64, 0, 1) for i in range(4)])
    statistic = ((counts - 64) ** 2 / 64).sum(1)
    assert all(tr.testing.chi2_p_value(float(x), 63) > 0.01 / TESTS for x in statistic)
    assert core.philox(3, 0, 1, 2, 1) != core.philox(4, 0, 1, 2, 1) != core.philox(3, 1, 1, 2, 1)
