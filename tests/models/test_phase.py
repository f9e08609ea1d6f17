"""Phase functions by themselves: samplers, values and integrals.

Significance 0.01 for all chi-square tests and means of samples in this file together.
"""

from __future__ import annotations

import math

import pytest
import torch
from phase_cases import (
    ARITHMETIC,
    AXIS,
    GRID,
    PHASES,
    PLACE,
    TABLE,
    UP,
    at_cosines,
    directions,
    over_the_sphere,
    probe_of,
    uniform,
)

import torchrender as tr

N = 60_000
CHI2_TESTS = 39  # chi-square tests below
MEANS = 9  # means of samples below


# ------------------------------------------------------------------------------------------------------------- samplers
@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("name", PHASES)
def test_samples_follow_their_density(name, arithmetic):
    probe, exact = probe_of(PHASES[name], arithmetic), probe_of(PHASES[name])
    wo = probe.sample(AXIS, uniform(N, 3), PLACE)
    result = tr.testing.chi2_test(wo, lambda w: exact.eval(AXIS, w, PLACE), tests=CHI2_TESTS)
    assert result, result.message
    assert (probe.eval(AXIS, wo, PLACE) > 0).all()


def test_arithmetics_sample_alike():
    """The same numbers give the same directions, to rounding; 37 is no multiple of a packet's width."""
    for name, phase in PHASES.items():
        expected = probe_of(phase).sample(AXIS, uniform(37, 3), PLACE)
        for arithmetic in ("single", "packets"):
            found = probe_of(phase, arithmetic).sample(AXIS, uniform(37, 3), PLACE)
            torch.testing.assert_close(found.double(), expected, rtol=0, atol=3e-4, msg=f"{name}, {arithmetic}")


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("g", [-0.99, 0.99, 0.9999])
def test_narrow_lobes_are_sampled(g, arithmetic):
    """The share of the lobe within the angle of each sample is uniform, and independent of the azimuth; the share is
    the closed form of Henyey and Greenstein's cumulative distribution, in 1 - |cos|."""
    wo = probe_of({"type": "hg", "g": g}, arithmetic).sample(UP, uniform(N, 3)).double()
    cosine, a = wo[:, 2] * math.copysign(1, g), abs(g)
    squared = wo[:, :2].square().sum(1)
    t = torch.where(cosine > 0, squared / (1 + cosine), 1 - cosine)  # without cancellation
    share = (1 - a * a) / (2 * a) * (1 / (1 - a) - ((1 - a) ** 2 + 2 * a * t) ** -0.5)
    azimuth = torch.atan2(wo[:, 1], wo[:, 0]) / (2 * math.pi) % 1
    square = torch.stack([share.clamp(0, 1), azimuth], dim=1)
    result = tr.testing.chi2_test(square, lambda x: torch.ones(len(x)), domain="square", tests=CHI2_TESTS)
    assert result, result.message


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("g", [-0.9, -1e-5, 0.5])
def test_the_mean_cosine_of_samples_is_g(g, arithmetic):
    cosine = probe_of({"type": "hg", "g": g}, arithmetic).sample(AXIS, uniform(N, 3, seed=3)).double() @ AXIS
    # the mean of cos^2 is (1 + 2 g^2) / 3: that of the second Legendre polynomial is g^2
    z = (cosine.mean() - g) / math.sqrt((1 - g * g) / 3 / N)
    assert float(tr.testing.normal_p_value(z)) > tr.testing.sidak(0.01, MEANS), f"{float(z):.2f} standard errors"


def test_the_tails_of_uniform_numbers():
    """0 and the largest number below 1 give unit vectors in every arithmetic."""
    low, high = torch.zeros(1, 3), torch.full((1, 3), 1 - 2.0**-24)
    u = torch.cat(
        [
            torch.where(torch.tensor(bits), high, low)
            for bits in torch.cartesian_prod(*[torch.arange(2)] * 3).bool().tolist()
        ]
    )
    extremes = [{"type": "hg", "g": g} for g in (-0.9999, 0.9999)]
    for phase in (*PHASES.values(), *extremes):
        for arithmetic in ARITHMETIC:
            wo = probe_of(phase, arithmetic).sample(AXIS, u, PLACE).double()
            torch.testing.assert_close(wo.norm(dim=1), torch.ones(8, dtype=torch.float64), rtol=1e-6, atol=0)


# --------------------------------------------------------------------------------------------------------------- values
# By `eval_pdf` of Mitsuba 3.9.1 (scalar_rgb), for the angles 0, 30, ..., 180 degrees between the directions of travel.
MITSUBA = [
    (
        {"type": "hg", "g": 0.4},
        [0.30946800, 0.20933582, 0.10089020, 0.05350353, 0.03430698, 0.02650449, 0.02436045],
    ),
    (
        {"type": "hg", "g": -0.7},
        [0.00826064, 0.00913539, 0.01252259, 0.02231418, 0.05779891, 0.27753288, 1.50312912],
    ),
    ({"type": "hg"}, [3.58099103, 0.22331664, 0.03721120, 0.01364039, 0.00751636, 0.00544335, 0.00491219]),
    ({"type": "isotropic"}, [0.07957747] * 7),
    (
        {"type": "rayleigh"},
        [0.11936620, 0.10444543, 0.07460387, 0.05968310, 0.07460387, 0.10444543, 0.11936620],
    ),
    (
        {"type": "tabphase", "values": "0.5, 1.0, 2.0, 4.0"},
        [0.18189137, 0.16361475, 0.11368210, 0.06820926, 0.03978873, 0.02730557, 0.02273642],
    ),
    (
        {"type": "tabphase", "values": "0, 0.3, 0, 1.5, 1"},
        [0.13839561, 0.15693709, 0.20759340, 0.0, 0.04151868, 0.01112490, 0.0],
    ),
    (
        {
            "type": "blendphase",
            "weight": {"type": "constvolume", "value": 0.25},
            "a": {"type": "hg", "g": 0.4},
            "b": {"type": "rayleigh"},
        },
        [0.26194254, 0.18311322, 0.09431861, 0.05504842, 0.04438120, 0.04598973, 0.04811189],
    ),
]


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize(("phase", "expected"), MITSUBA)
def test_values_of_mitsuba(phase, expected, arithmetic):
    angle = torch.deg2rad(torch.arange(0, 181, 30, dtype=torch.float64))
    found = probe_of(phase, arithmetic).eval(UP, at_cosines(torch.cos(angle)))
    torch.testing.assert_close(found.double(), torch.tensor(expected).double(), rtol=3e-6, atol=3e-8)


@pytest.mark.parametrize("name", PHASES)
def test_phase_functions_scatter_everything(name):
    assert over_the_sphere(probe_of(PHASES[name])) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("g", [-0.9999, -0.99, -0.5, -1e-4, 0, 1e-4, 0.3, 0.99, 0.9999])
def test_hg_has_integral_1_and_mean_cosine_g(g):
    probe = probe_of({"type": "hg", "g": g})
    assert over_the_sphere(probe) == pytest.approx(1, abs=1e-7)
    assert over_the_sphere(probe, lambda cosine: cosine) == pytest.approx(g, abs=1e-7)


@pytest.mark.parametrize("g", [-0.9999, -0.99, 0, 0.99, 0.9999])
def test_narrow_lobes_in_single_precision(g):
    """Relative accuracy at all angles, down to those that only the difference of the vectors resolves."""
    g = float(torch.tensor(g, dtype=torch.float32))
    t = torch.logspace(-11, math.log10(2), 60, dtype=torch.float64)[:-1]  # 1 - |cos|
    sine = torch.sqrt(t * (2 - t))
    wo = torch.stack([sine, torch.zeros_like(t), math.copysign(1, g) * (1 - t)], dim=1).float()
    expected = probe_of({"type": "hg", "g": g}).eval(UP, wo)
    for arithmetic in ("single", "packets"):
        found = probe_of({"type": "hg", "g": g}, arithmetic).eval(UP, wo)
        torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=0)


def test_the_scale_of_a_table_does_not_matter():
    wo = directions(50, 5)
    tables = [probe_of({"type": "tabphase", "values": [1000 * s * v for v in TABLE]}) for s in (0.001, 1.0)]
    torch.testing.assert_close(tables[0].eval(AXIS, wo), tables[1].eval(AXIS, wo), rtol=1e-12, atol=0)


def test_a_blend_follows_its_grid():
    """Between voxels the weight is interpolated, and the value is linear in it."""
    probe = probe_of(PHASES["blend in a grid"])
    wo = directions(1, 6)
    parts = [probe_of(PHASES[n]).eval(AXIS, wo) for n in ("table",)] + [
        probe_of({"type": "hg", "g": -0.2}).eval(AXIS, wo)
    ]
    centre = torch.tensor([[2.5 / 4, 1.5 / 3, 0.5 / 2], [3 / 4, 1.5 / 3, 0.5 / 2]])  # a voxel, and half way along x
    weight = torch.stack([GRID[0, 1, 2, 0], (GRID[0, 1, 2, 0] + GRID[0, 1, 3, 0]) / 2])
    torch.testing.assert_close(probe.eval(AXIS, wo, centre), (1 - weight) * parts[0] + weight * parts[1])


def test_weights_0_and_1_are_the_parts():
    wo, u = directions(20, 8), uniform(9, 3)
    for weight, part in ((0.0, "forward"), (1.0, "rayleigh")):
        blend = {"type": "blendphase", "weight": {"type": "constvolume", "value": weight}}
        probe = probe_of({**blend, "a": PHASES["forward"], "b": PHASES["rayleigh"]})
        torch.testing.assert_close(probe.eval(AXIS, wo), probe_of(PHASES[part]).eval(AXIS, wo))
        torch.testing.assert_close(probe.sample(AXIS, u), probe_of(PHASES[part]).sample(AXIS, u))
