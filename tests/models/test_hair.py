"""Hair by itself: energy, symmetry, where its lobes are, pigments, and Mitsuba's values to their precision.

Samplers, precision and the ends of ranges are in test_bsdfs.py, derivatives in test_native_bsdf.py and
test_motion_derivatives.py, images and gradients against Mitsuba's in test_references.py, light tracing in
test_particle_oracle.py and test_particle_images.py.
"""

from __future__ import annotations

import math
from unittest import mock

import bsdf_cases
import numpy as np
import pytest
import reference_scenes
import torch
from bsdf_models import DECLARED, in_plain_pytorch
from bsdf_probes import directions, probe
from oracle.bsdf import MODELS
from oracle.bsdf.hair import Hair
from uniform_numbers import uniform

import torchrender as tr

pytestmark = pytest.mark.once  # in double precision, which does not depend on it

CLEAR = {"type": "hair", "sigma_a": 0.0}


def towards(inclination: float, azimuth: torch.Tensor | float) -> torch.Tensor:
    """Unit vectors (N, 3) of an inclination against the plane across the fibre, and azimuths against the normal."""
    azimuth = torch.atleast_1d(torch.as_tensor(azimuth, dtype=torch.float64))
    c, s = math.cos(inclination), torch.full_like(azimuth, math.sin(inclination))
    return torch.stack([c * torch.sin(azimuth), s, c * torch.cos(azimuth)], 1)


def midpoints(low: float, high: float, n: int) -> torch.Tensor:
    return low + (high - low) * (torch.arange(n, dtype=torch.float64) + 0.5) / n


def all_directions(n: int = 500) -> torch.Tensor:
    """Directions (n n, 3) that share the sphere evenly."""
    sine, phi = torch.meshgrid(midpoints(-1, 1, n), midpoints(-math.pi, math.pi, n), indexing="ij")
    across = (1 - sine.square()).sqrt()
    return torch.stack([across * torch.sin(phi), sine, across * torch.cos(phi)], -1).reshape(-1, 3)


# ------------------------------------------------------------------------------------------------------------- energy
ROUGH = [(0.15, 0.3), (0.3, 0.15), (0.6, 0.6), (1.0, 1.0)]


def reflected_and_path(theta: float, gamma: float, eta: float) -> tuple[float, float]:
    """What the fibre reflects, and how long a way through it is, in radii."""
    cos_i = math.cos(theta) * math.cos(gamma)
    cos_t = math.sqrt(1 - (1 - cos_i**2) / eta**2)
    polarised = (cos_i - eta * cos_t) / (cos_i + eta * cos_t), (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    bravais = math.sqrt(eta**2 - math.sin(theta) ** 2) / math.cos(theta)
    chord = 2 * math.cos(math.asin(math.sin(gamma) / bravais))
    return sum(r * r for r in polarised) / 2, chord / math.sqrt(1 - (math.sin(theta) / eta) ** 2)


@pytest.mark.parametrize(("along", "across"), ROUGH)
@pytest.mark.parametrize(("theta", "gamma"), [(0.0, 0.0), (0.4, -0.9), (-1.1, 1.4)])
def test_all_light_leaves_that_is_not_absorbed(along, across, theta, gamma):
    """The integral over all directions is the sum of the attenuations, 1 without absorption."""
    wo, absorption, eta = all_directions(), (0.0, 0.2, 1.5), 1.5
    hair = {"sigma_a": bsdf_cases.rgb(*absorption), "eta": eta, "scale_tilt": 3.0}
    of = probe({**CLEAR, **hair, "longitudinal_roughness": along, "azimuthal_roughness": across})
    value, density = of.eval(towards(theta, gamma), wo)
    found, total = (4 * math.pi * x.mean(0) for x in (value, density))
    f, path = reflected_and_path(theta, gamma, eta)
    left = torch.exp(-path * torch.tensor(absorption, dtype=torch.float64))
    expected = f + (1 - f) ** 2 * left / (1 - left * f)
    assert float(expected[0]) == pytest.approx(1, abs=1e-12)
    torch.testing.assert_close(found, expected, rtol=3e-4, atol=0)  # of the sum
    assert float(total) == pytest.approx(1, abs=3e-4)


@pytest.mark.parametrize("name", bsdf_cases.HAIR)
def test_no_weight_exceeds_what_leaves_the_fibre(name):
    """Without absorption every sample weighs 1, with it none weighs more than the sum over the lobes."""
    wi, u = directions(3000, 4), uniform(3000)
    clear = {k: v for k, v in bsdf_cases.HAIR[name].items() if "melanin" not in k} | {"sigma_a": 0.0}
    torch.testing.assert_close(probe(clear).sample(wi, u).weight, torch.ones(3000, 3).double(), rtol=1e-9, atol=0)
    weight = probe(bsdf_cases.HAIR[name]).sample(wi, u).weight
    assert float(weight.max()) <= 1 + 1e-9 and float(weight.max()) > 0.5


# ----------------------------------------------------------------------------------------------------------- symmetry
def test_mirrored_across_and_along():
    """Left and right of a fibre are alike; its ends are, unless the scales are tilted."""
    wi, wo = directions(2000, 3), directions(2000, 4)
    sides, ends = (torch.tensor(m, dtype=torch.float64) for m in ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]))
    tilted, straight = probe({"type": "hair", "scale_tilt": 4.0}), probe({"type": "hair", "scale_tilt": 0.0})
    there = tilted.eval(wi, wo).value
    torch.testing.assert_close(tilted.eval(wi * sides, wo * sides).value, there, rtol=1e-9, atol=1e-15)
    torch.testing.assert_close(
        straight.eval(wi * ends, wo * ends).value, straight.eval(wi, wo).value, rtol=1e-9, atol=1e-15
    )
    changed = (tilted.eval(wi * ends, wo * ends).value - there).abs()
    assert float(changed.max()) > 0.1
    turned = probe({"type": "hair", "scale_tilt": -4.0}).eval(wi * ends, wo * ends).value
    torch.testing.assert_close(turned, there, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("theta", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("phi", [0.3, 1.7, 3.0])
def test_reciprocity_across_the_width(theta, phi):
    """Averaged over the width of a hair without tilted scales, between directions of opposite inclination.

    Where on the width it is depends on one direction alone, and so do the attenuations: neither of one offset nor
    between other inclinations is the model reciprocal.
    """
    of = probe({"type": "hair", "scale_tilt": 0.0})
    gamma = torch.asin(midpoints(-1, 1, 400))
    there, back = (
        of.eval(towards(a, gamma), towards(-a, gamma + turn)).value.mean(0)
        for a, turn in ((theta, phi), (-theta, -phi))
    )
    torch.testing.assert_close(there, back, rtol=1e-9, atol=0)
    assert float(there.min()) > 1e-4


# -------------------------------------------------------------------------------------------------------------- lobes
def exit_azimuth(gamma: float, bravais: float, order: int) -> float:
    """Where light leaves a circle that meets it at the angle gamma, `order` times refracted or reflected inside."""
    direction, place = -complex(math.cos(gamma), math.sin(gamma)), complex(1, 0)
    if order == 0:
        return math.atan2(*_parts(_mirrored(direction, place)))
    direction = _refracted(direction, place, 1 / bravais)
    for k in range(order):
        place -= 2 * (direction.conjugate() * place).real * direction  # the other end of the chord
        if k < order - 1:
            direction = _mirrored(direction, place)
    return math.atan2(*_parts(_refracted(direction, place, bravais)))


def _parts(z: complex) -> tuple[float, float]:
    return z.imag, z.real


def _mirrored(d: complex, n: complex) -> complex:
    return d - 2 * (d.conjugate() * n).real * n


def _refracted(d: complex, n: complex, ratio: float) -> complex:
    """Snell's law in the plane: what is along the surface is multiplied by `ratio`."""
    cosine = (d.conjugate() * n).real
    along = ratio * (d - cosine * n)
    return along + math.copysign(math.sqrt(1 - abs(along) ** 2), cosine) * n


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("gamma", [0.2, -0.7, 1.1])
@pytest.mark.parametrize("theta", [0.0, -0.6])
def test_lobes_are_where_a_smooth_fibre_sends_light(order, gamma, theta):
    """By rays through a circle, and at the mirrored inclination, turned by the tilt of the scales."""
    eta, tilt, narrow = 1.5, math.radians(3), 0.06
    bravais = math.sqrt(eta**2 - math.sin(theta) ** 2) / math.cos(theta)
    settings = {"longitudinal_roughness": narrow, "azimuthal_roughness": narrow, "scale_tilt": 3.0, "eta": eta}
    of = probe({**CLEAR, **settings})
    inclination = -theta + (2, -1, -4)[order] * tilt
    phi = exit_azimuth(gamma, bravais, order)
    steps = torch.linspace(-0.01, 0.01, 201, dtype=torch.float64)
    around = of.eval(towards(theta, gamma), towards(inclination, phi + steps)).value[:, 0]
    assert abs(float(steps[around.argmax()])) < 2e-3  # another lobe may lie below it
    along = torch.cat([towards(inclination + float(x), phi) for x in steps])
    assert abs(float(steps[of.eval(towards(theta, gamma), along).value[:, 0].argmax()])) < 2e-3


# ----------------------------------------------------------------------------------------------------------- pigments
def test_pigments_are_an_absorption():
    wi, wo = directions(500, 3), directions(500, 4)
    sum_of = [1.3 * e + 0.2 * p for e, p in zip((0.419, 0.697, 1.37), (0.187, 0.4, 1.05), strict=True)]
    expected = probe({"type": "hair", "sigma_a": bsdf_cases.rgb(*sum_of)}).eval(wi, wo).value
    torch.testing.assert_close(probe({"type": "hair"}).eval(wi, wo).value, expected, rtol=1e-6, atol=0)
    torch.testing.assert_close(probe({"type": "hair", "eumelanin": 1.3}).eval(wi, wo).value, expected)
    half = bsdf_cases.rgb(*(0.5 * s for s in sum_of))
    scaled = probe({"type": "hair", "sigma_a": half, "scale": 2.0}).eval(wi, wo).value
    torch.testing.assert_close(scaled, expected, rtol=1e-6, atol=0)
    dark = probe({"type": "hair", "eumelanin": 8.0}).eval(wi, wo).value
    assert bool((dark <= expected + 1e-12).all()) and float(dark.sum()) < 0.8 * float(expected.sum())
    scene = {"type": "scene", "a": {"type": "sphere", "bsdf": {"type": "hair"}}}
    grey = tr.load_dict(scene, variant="mono").a.bsdf.eumelanin_absorption.value
    assert float(grey) == pytest.approx(0.2126 * 0.419 + 0.7152 * 0.697 + 0.0722 * 1.37, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sigma_a": 0.1, "eumelanin": 1.0}, "hair: give sigma_a, or eumelanin, but not both"),
        ({"sigma_a": 0.1, "pheomelanin_absorption": 1.0}, "hair: give sigma_a, or pheomelanin_absorption, but not"),
        ({"eta": 1.5, "int_ior": 1.5}, "hair: give eta, or int_ior, but not both"),
        ({"int_ior": 1.2, "ext_ior": 1.4}, "eta"),
        ({"longitudinal_roughness": 1.2}, "longitudinal_roughness"),
        ({"azimuthal_roughness": -0.1}, "azimuthal_roughness"),
        ({"eumelanin": -1.0}, "eumelanin"),
        ({"sigma_a": -0.1}, "sigma_a"),
    ],
)
def test_what_makes_no_sense_is_named(given, message):
    with pytest.raises(ValueError, match=message):
        probe({"type": "hair", **given})


def test_hair_lets_light_through_and_has_no_sides():
    with pytest.raises(ValueError, match="a hair cannot be made two-sided"):
        probe({"type": "twosided", "bsdf": {"type": "hair"}})


# ------------------------------------------------------------------------------------------------------ plain PyTorch
def in_pytorch(bsdf: dict, n: int, model: type[Hair] = Hair) -> Hair:
    """The model of the oracle with the parameters of this dict, at n points."""
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}}
    found = dict(tr.load_dict(scene, dtype=torch.float64).ball.bsdf.named_parameters())
    nothing, values = torch.zeros((), dtype=torch.float64), {}
    for field in DECLARED["hair"].fields:
        given = found.get(field.name, found.get(f"{field.name}.value", nothing)).detach()
        color = field.name == "sigma_a" or field.name.endswith("_absorption")
        values[field.name] = given.expand(n, 3) if color else given
    values |= {name: values[name].expand(n) for name in ("eumelanin", "pheomelanin")}
    with mock.patch.dict(MODELS, hair=model):
        plain = in_plain_pytorch("hair", {}, values)
    assert isinstance(plain, model)
    return plain


@pytest.mark.parametrize("along", [0.001, 0.01, 0.05, 0.2, 1.0])
def test_lobes_of_any_width(along):
    """Arguments of the Bessel function up to 4e6, near the mirrored inclination."""
    hair = {"type": "hair", "longitudinal_roughness": along, "azimuthal_roughness": 0.5, "scale_tilt": 0.0}
    wi, u = directions(400, 3), uniform(400)
    sine, phi = (along * (u[:, 0] - 0.5) - wi[:, 1]).clamp(-1, 1), 2 * math.pi * u[:, 1]
    across = (1 - sine.square()).clamp(min=0).sqrt()
    wo = torch.stack([across * torch.sin(phi), sine, across * torch.cos(phi)], 1)
    value = probe(hair).eval(wi, wo).value
    expected = in_pytorch(hair, 400).eval(wi, wo, torch.zeros(400, dtype=torch.int64))
    torch.testing.assert_close(value, expected, rtol=1e-9, atol=1e-13 * float(expected.max()))
    assert float((value > 1e-3).double().mean()) > 0.1


# ------------------------------------------------------------------------------------------------------------ Mitsuba
class RoundedHair(Hair):
    """With Mitsuba's Bessel function: eleven terms of the series and, above 12, an asymptotic one with half a term."""

    def bessel(self, x: torch.Tensor) -> torch.Tensor:
        series = sum((0.25 * x.square()) ** k / math.factorial(k) ** 2 for k in range(11))
        far = x.clamp(min=12.0)
        return torch.where(x > 12, torch.exp(1 / (16 * far)) / (2 * math.pi * far).sqrt(), series * torch.exp(-x))


@pytest.mark.parametrize("name", bsdf_cases.HAIR)
def test_values_of_mitsuba_to_their_digits(name):
    """What is 0.6 % apart is that function alone: with it the values are equal to 1e-4."""
    expected = torch.from_numpy(np.load(reference_scenes.DATA / "hair_bsdf_references.npz")[f"{name}.eval"]).double()
    wi, wo = (torch.nn.functional.normalize(torch.from_numpy(d).double(), dim=1) for d in bsdf_cases.directions())
    plain = in_pytorch(bsdf_cases.HAIR[name], len(wi), RoundedHair)
    value = plain.eval(wi, wo, torch.zeros(len(wi), dtype=torch.int64))
    torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-6 * float(expected.max()))
