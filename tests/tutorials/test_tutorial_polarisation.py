"""The tutorials of polarised light and of the achromat at a small size: what they find, and every announced file."""

from __future__ import annotations

import math

import pytest
import torch
from tutorial_pictures import drawn

import torchrender as tr


def test_polarised_ball(tutorial, tmp_path, capsys):
    ball = tutorial("polarised_ball")
    result = ball.run(tmp_path, resolution=24, spp=16, spp_photograph=256, iterations=80, rate=0.2, points=3)
    # From 0.68 away; a full run ends within 0.01 with polarisation.
    assert result["Stokes"]["index"] < 0.55 and result["Stokes"]["alpha"] < 0.1
    assert result["Stokes"]["index"] < result["intensity"]["index"]
    assert "noise allows: eta" in capsys.readouterr().out
    assert drawn(tmp_path, "photograph", "stokes", "intensity", "error", "valleys")
    names = tr.polarization.channel_names()
    assert tr.io.read_image(tmp_path / "photograph.exr", channels=names).shape == (24, 24, 12)


def test_metals_and_their_unknowns(tutorial):
    """Reflectance and edge tint become the index that they were made of."""
    metal = tutorial("polarised_ball").Metal
    eta, k = torch.tensor([0.2, 1.3, 4.4]), torch.tensor([3.9, 7.6, 5.2])
    numbers = metal.numbers(metal.unknown(eta, k, 0.15))
    for name, value in (("eta", eta), ("k", k), ("alpha", torch.tensor(0.15))):
        torch.testing.assert_close(numbers[name], value, rtol=2e-3, atol=0)


@pytest.mark.parametrize(("material", "iterations", "rate"), [("glass", 60, 0.2), ("plastic", 100, 0.1)])
def test_glass_and_plastic_are_found_too(tutorial, tmp_path, material, iterations, rate):
    settings = {"material": material, "iterations": iterations, "rate": rate}
    result = tutorial("polarised_ball").run(tmp_path, resolution=16, spp=16, spp_photograph=256, points=0, **settings)
    assert result["Stokes"]["index"] < (0.05 if material == "glass" else 0.07)  # from 0.14


def test_ellipsometer(tutorial, tmp_path, capsys):
    result = tutorial("ellipsometer").run(tmp_path, iterations=8)
    assert result["calibrated"]["n"] < 0.03 and result["calibrated"]["k"] < 2e-3
    assert result["by the labels"]["n"] > 0.1
    printed = capsys.readouterr().out.splitlines()
    assert sum("psi, Delta" in line for line in printed) == 2 and drawn(tmp_path, "error", "fit")


def test_angles_of_ellipsometry(tutorial):
    """Of gold and silicon; and that pictures are those of a rotating quarter-wave plate: the light's Stokes vector
    are harmonics of its angle."""
    ellipsometer = tutorial("ellipsometer")
    assert ellipsometer.psi_and_delta(0.183, 3.43, 70) == pytest.approx((43.650, 108.127), abs=1e-3)
    assert ellipsometer.psi_and_delta(3.88, 0.019, 75) == pytest.approx((1.200, 172.844), abs=1e-3)
    scenes = [ellipsometer.instrument(angle, "Au", 632.8) for angle in ellipsometer.ANGLES]
    with torch.no_grad():
        found = ellipsometer.pictures(scenes, torch.cat([torch.tensor([0.183, 3.43]).double(), ellipsometer.LABELS]))
    constant, second, fourth, *others = torch.fft.rfft(found, norm="forward").T
    assert float(torch.stack(others).abs().max()) < 1e-12
    i = 2 * constant.real - 4 * fourth.real
    seen = torch.stack([8 * fourth.real, 8 * fourth.imag.abs(), 4 * second.imag.abs()]) / i
    for angle, (q, u, v) in zip(ellipsometer.ANGLES, seen.T.tolist(), strict=True):
        psi, delta = (math.radians(x) for x in ellipsometer.psi_and_delta(0.183, 3.43, angle))
        assert q == pytest.approx(math.cos(2 * psi), abs=1e-6)
        expected = (abs(math.sin(2 * psi) * f(delta)) for f in (math.cos, math.sin))
        assert (u, v) == pytest.approx(tuple(expected), abs=1e-6)


def test_shape_from_polarisation(tutorial, tmp_path, capsys):
    settings = {"size": 16, "resolution": 24, "iterations": 70, "save_every": 35, "material": "Cr"}
    shape = tutorial("shape_from_polarisation")
    result = shape.run(tmp_path, **settings)
    # From 1: flat.
    assert result["Stokes"]["heights"] < 0.45
    assert result["Stokes"]["heights"] < 0.8 * result["intensity"]["heights"]
    assert result["Stokes"]["normals"] < result["intensity"]["normals"]
    assert drawn(tmp_path, "photograph", "heights", "error") and "normals" in capsys.readouterr().out
    assert tr.io.read_image(tmp_path / "stokes.exr").shape == (16, 16, 1)
    assert shape.run(tmp_path, **settings) == result  # nothing is left to do
    with pytest.raises(ValueError, match=r"noise 0\.001 \(now 0\.1\)"):
        shape.run(tmp_path, **settings, noise=0.1)


def test_achromat(tutorial, tmp_path, capsys):
    result = tutorial("achromat").run(tmp_path, resolution=32, spp=4, iterations=3, points=2)
    assert result["achromat"] < result["thin achromat"] / 5
    assert result["achromat"] < result["single lens"] / 4
    assert result["single lens"] < result["thin single lens"]
    assert "curvatures" in capsys.readouterr().out and drawn(tmp_path, "loss", "spots", "focus")


def test_the_thin_achromat(tutorial):
    """It has the power that is wanted, and the same at F and C."""
    achromat = tutorial("achromat")
    curvatures = achromat.thin("N-BK7", "F2").double()
    powers = []
    for line in achromat.LINES.values():
        at = line - 360
        n1, n2 = (torch.lerp(t[int(at)], t[int(at) + 1], at % 1) for t in map(tr.spectrum.glass, ("N-BK7", "F2")))
        powers.append((n1 - 1) * (curvatures[0] - curvatures[1]) + (n2 - 1) * (curvatures[1] - curvatures[2]))
    assert float(powers[1]) == pytest.approx(1 / achromat.FOCUS, rel=1e-5)
    assert abs(float(powers[0] - powers[2])) < 2e-4 * float(powers[1])  # a single lens of crown: 1.6e-2


def test_a_flint_in_place_of_a_crown_is_refused(tutorial, tmp_path):
    with pytest.raises(ValueError, match=r"crown: expected a glass with a larger Abbe number than F2"):
        tutorial("achromat").run(tmp_path, crown="SF10")


def test_sizes(settings_of):
    three = ("--iterations", "3")
    for name in ("polarised_ball", "achromat", "ellipsometer"):
        assert settings_of(name, *three) == {"iterations": 3}
    assert settings_of("shape_from_polarisation", *three) == {"iterations": 3, "restart": False}
    full = {"size": 128, "resolution": 128, "iterations": 400, "material": "Cu", "restart": True}
    assert settings_of("shape_from_polarisation", "--full", "--material", "Cu", "--restart") == full
