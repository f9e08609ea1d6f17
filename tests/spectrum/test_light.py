"""The observer, lights and values at other wavelengths: published numbers, energy, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.spectrum import cie

sp = tr.spectrum
DOUBLE = torch.float64


def double(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=DOUBLE)


def chromaticity(table: torch.Tensor) -> torch.Tensor:
    xyz = sp.to_rgb(table) @ torch.linalg.inv(torch.from_numpy(cie.XYZ_TO_RGB)).T
    return xyz[..., :2] / xyz.sum(-1, keepdim=True)


def test_whites():
    assert torch.equal(sp.wavelengths(), torch.arange(360, 831, dtype=DOUBLE))
    ones = torch.ones(471, dtype=DOUBLE)
    assert torch.allclose(sp.to_rgb(ones), double(1.2048, 0.9483, 0.9089), atol=4e-4)  # of X = Y = Z = 1
    for seen in (sp.to_rgb(sp.d65()), sp.to_rgb(ones, sp.d65())):
        assert torch.allclose(seen, double(1.0001, 1.0, 0.9999), rtol=0, atol=5e-5)
    # Illuminant A is at (0.44757, 0.40745), D65 at (0.31272, 0.32903): ISO/CIE 11664-2.
    assert torch.allclose(chromaticity(sp.illuminant_a()), double(0.44757, 0.40745), atol=1e-4)
    assert torch.allclose(chromaticity(sp.d65()), double(0.31272, 0.32903), atol=1e-4)
    luminance = sp.responses() @ torch.linalg.inv(torch.from_numpy(cie.XYZ_TO_RGB)).T[:, 1]
    for light in (ones, sp.d65(), sp.illuminant_a()):
        assert float(luminance @ light) == pytest.approx(1, abs=1e-12)


def test_dtypes_are_kept():
    like = torch.zeros((), dtype=torch.float32)
    assert sp.d65(like).dtype == sp.illuminant_a(like).dtype == sp.responses(torch.float32).dtype == torch.float32
    table = torch.rand(2, 3, 471)
    assert sp.to_rgb(table).dtype == torch.float32 and sp.to_rgb(table).shape == (2, 3, 3)
    first = sp.d65()
    first.zero_()  # one's own copy
    assert float(sp.d65().sum()) > 0


def test_black_bodies():
    # 560 nm and 5000 K: 1.277e4 W / (m^2 sr nm)
    kelvin = double(2855.5, 5000)
    light = sp.blackbody(kelvin)
    assert float(light[1, 200]) == pytest.approx(1.277e4, rel=1e-3)
    assert torch.allclose(chromaticity(light), double([0.4476, 0.4074], [0.3451, 0.3516]), atol=1e-4)
    assert torch.equal(sp.blackbody(5000.0), light[1])
    wavelengths, radiance = cie.blackbody(5000.0)
    assert np.array_equal(wavelengths, sp.wavelengths()) and np.allclose(radiance, light[1], rtol=1e-12, atol=0)
    assert torch.autograd.gradcheck(sp.blackbody, kelvin.requires_grad_(), check_forward_ad=True)
    cold = double(1.0).requires_grad_()
    sp.blackbody(cold).sum().backward()
    assert bool(cold.grad.isfinite())


def test_metamers():
    """A grey, and the same with a spectrum of no colour in daylight; in lamplight they differ."""
    at = sp.wavelengths()
    weights = (sp.responses() * sp.d65()[:, None]).T
    wave = torch.sin(2 * torch.pi * (at - 360) / 110) + 0.5 * torch.cos(2 * torch.pi * (at - 360) / 70)
    black = wave - weights.T @ torch.linalg.solve(weights @ weights.T, weights @ wave)
    grey = torch.full_like(at, 0.4)
    pair = torch.stack([grey, grey + 0.3 * black / black.abs().max()])
    daylight, lamplight = sp.to_rgb(pair, sp.d65()), sp.to_rgb(pair, sp.illuminant_a())
    assert torch.allclose(daylight[0], daylight[1], rtol=0, atol=1e-10)
    assert torch.allclose(lamplight, double([0.738, 0.330, 0.093], [0.778, 0.314, 0.101]), atol=2e-3)


def test_values_at_coarse_wavelengths_are_joined_by_lines():
    values = torch.rand(2, 40, generator=torch.Generator().manual_seed(0), dtype=DOUBLE)
    at = torch.linspace(390.3, 741.7, 40, dtype=DOUBLE)
    found = sp.irregular(at, values)
    for row, expected in zip(found, values):
        assert np.allclose(row, np.interp(sp.wavelengths(), at, expected, left=0, right=0), rtol=0, atol=1e-14)
    assert torch.equal(sp.regular(values, 390.3, 741.7), found)
    assert sp.irregular(at, values.float()).dtype == torch.float32
    exact = torch.rand(471, dtype=DOUBLE)
    assert torch.allclose(sp.regular(exact, 360, 830), exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("center", [500.0, 500.25, 500.5, 500.93])
@pytest.mark.parametrize("width", [0.02, 0.3, 0.9])
def test_narrow_lines_keep_their_energy(center, width):
    line = sp.irregular(double(center - width, center, center + width), double(0, 5, 0))
    assert float(line.sum()) == pytest.approx(5 * width, rel=1e-10)
    assert torch.equal(line.nonzero()[:, 0], torch.arange(int(line.nonzero()[0]), int(line.nonzero()[-1]) + 1))
    # on lines that go on for long
    lamp = sp.irregular(double(400, center - width, center, center + width, 700), double(1, 1, 6, 1, 1))
    assert float((lamp[41:340] - 1).sum()) == pytest.approx(5 * width, rel=1e-9)
    assert torch.allclose(lamp[40:139], torch.ones(99, dtype=DOUBLE), rtol=0, atol=1e-12)


@pytest.mark.parametrize("low", [500.0, 500.3, 500.5, 500.8])
@pytest.mark.parametrize("width", [0.2, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 7.7])
def test_bands_keep_their_integrals(low, width):
    """Of a peak, a step at both ends, a trapezoid, a saw."""
    ends = low, low + width / 2, low + width, low + 2.3 * width
    for at, values, expected in (
        (double(*ends[:3]), double(0, 3, 0), 3 * width / 2),
        (double(ends[0], ends[2]), double(2, 1), 1.5 * width),
        (double(*ends), double(0, 1, 1, 0), width * (0.25 + 0.5 + 0.65)),
        (double(*ends, ends[3] + 1e-3), double(0, 4, 1, 3, 0), width * (1 + 1.25 + 2.6) + 1.5e-3),
    ):
        table = sp.irregular(at, values, integral=True)
        assert float(table.sum()) == pytest.approx(expected, rel=1e-9)
        assert bool((table >= 0).all())
    whole = torch.rand(12, dtype=DOUBLE)  # at whole nanometres values are what they are, but for steps
    found = sp.irregular(torch.arange(500.0, 512.0), whole, integral=True)
    assert torch.allclose(found[141:151], whole[1:-1], rtol=0, atol=1e-13)
    assert torch.allclose(found[[140, 151]], whole[[0, -1]] / 2, rtol=0, atol=1e-13)


def test_means_of_fine_values():
    at = torch.linspace(350, 840, 4901, dtype=DOUBLE)
    ramp = sp.irregular(at, at)
    assert torch.allclose(ramp[1:-1], sp.wavelengths()[1:-1], rtol=1e-12, atol=0)
    assert torch.allclose(sp.irregular(at, torch.ones_like(at)), torch.ones(471, dtype=DOUBLE), rtol=1e-10, atol=0)


def test_derivatives_by_values():
    generator = torch.Generator().manual_seed(1)
    for at in (torch.linspace(400, 700, 7), torch.tensor([480.1, 480.4, 480.6, 495, 495.5, 900])):
        values = torch.rand(2, len(at), generator=generator, dtype=DOUBLE).requires_grad_()
        for integral in (False, True):
            made = lambda v, at=at, integral=integral: sp.irregular(at, v, integral=integral)  # noqa: E731
            assert torch.autograd.gradcheck(made, values, check_forward_ad=True)
    table = torch.rand(2, 471, generator=generator, dtype=DOUBLE).requires_grad_()
    assert torch.autograd.gradcheck(lambda t: sp.to_rgb(t, sp.d65()), table, check_forward_ad=True, fast_mode=True)


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: sp.to_rgb(torch.ones(470)), ValueError, r"table: expected shape \(\.\.\., 471\).*\(470,\)"),
        (lambda: sp.to_rgb([1.0] * 471), TypeError, "table: expected a floating-point tensor.*list"),
        (lambda: sp.to_rgb(torch.ones(471), torch.ones(3)), ValueError, "illuminant: .*471"),
        (lambda: sp.irregular([500, 400], torch.ones(2)), ValueError, "wavelengths: .*increasing"),
        (lambda: sp.irregular([400, 500, 600], torch.ones(2)), ValueError, r"values: .*\(\.\.\., 3\).*\(2,\)"),
        (lambda: sp.irregular([400, 500], torch.ones(2, dtype=torch.int64)), TypeError, "values: .*int64"),
        (lambda: sp.regular(torch.ones(1), 400, 500), ValueError, "values: .*at least 2"),
        (lambda: sp.regular(torch.ones(3), 500, 400), ValueError, "low, high: .*increasing"),
        (lambda: sp.blackbody(-3.0), ValueError, "temperature: expected a positive .*-3"),
        (lambda: sp.blackbody("hot"), TypeError, "temperature: .*hot"),
        (lambda: sp.blakbody(1.0), AttributeError, "did you mean 'blackbody'"),
    ],
)
def test_mistakes_are_named(call, kind, message):
    with pytest.raises(kind, match=message):
        call()
