"""Sun and sky: the formula by hand, the sun's place, light that is neither lost nor made, derivatives, errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

import torchrender as tr
from torchrender import daylight

SUN = (0.5, 0.6, -0.4)


def spectrum_of(d: np.ndarray, sun: np.ndarray, turbidity: float) -> np.ndarray:
    """Luminance (kcd / m^2) and chromaticity of the sky, Preetham et al. 1999, appendix A.2, as printed there."""
    T = turbidity
    theta_s = math.acos(sun[1])
    chi = (4 / 9 - T / 120) * (math.pi - 2 * theta_s)
    powers = np.array([theta_s**3, theta_s**2, theta_s, 1])
    Yz = (4.0453 * T - 4.9710) * math.tan(chi) - 0.2155 * T + 2.4192
    mx = np.array([[0.00166, -0.00375, 0.00209, 0], [-0.02903, 0.06377, -0.03202, 0.00394],
                   [0.11693, -0.21196, 0.06052, 0.25886]])  # fmt: skip
    my = np.array([[0.00275, -0.00610, 0.00317, 0], [-0.04214, 0.08970, -0.04153, 0.00516],
                   [0.15346, -0.26756, 0.06670, 0.26688]])  # fmt: skip
    haze = np.array([T * T, T, 1])
    tables = {
        "Y": (Yz, [0.1787 * T - 1.4630, -0.3554 * T + 0.4275, -0.0227 * T + 5.3251, 0.1206 * T - 2.5771,
                   -0.0670 * T + 0.3703]),
        "x": (haze @ mx @ powers, [-0.0193 * T - 0.2592, -0.0665 * T + 0.0008, -0.0004 * T + 0.2125,
                                   -0.0641 * T - 0.8989, -0.0033 * T + 0.0452]),
        "y": (haze @ my @ powers, [-0.0167 * T - 0.2608, -0.0950 * T + 0.0092, -0.0079 * T + 0.2102,
                                   -0.0441 * T - 1.6537, -0.0109 * T + 0.0529]),
    }  # fmt: skip

    def perez(c, theta, gamma):
        a, b, c, d, e = c
        return (1 + a * math.exp(b / math.cos(theta))) * (1 + c * math.exp(d * gamma) + e * math.cos(gamma) ** 2)

    theta, gamma = math.acos(d[1]), math.acos(float(d @ sun))
    return np.array([z * perez(c, theta, gamma) / perez(c, 0, theta_s) for z, c in tables.values()])


@pytest.mark.parametrize("turbidity", [2.0, 3.5, 6.0, 10.0])
def test_sky_is_the_formula(turbidity):
    rows = 16
    texels = tr.sky(torch.tensor(SUN, dtype=torch.float64), turbidity, height=rows).numpy()
    assert texels.shape == (rows, 2 * rows, 3)
    sun = np.array(SUN) / np.linalg.norm(SUN)
    for row, column in ((0, 0), (3, 5), (5, 28), (7, 16)):
        theta, phi = row * math.pi / (rows - 1), (column + 0.5) * math.pi / rows
        d = np.array([math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi)])
        Y, x, y = spectrum_of(d, sun, turbidity)
        Y *= 1000 / (683.002 * 106.856895)
        xyz = Y * np.array([x / y, 1, (1 - x - y) / y])
        # IEC 61966-2-1
        to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
        np.testing.assert_allclose(texels[row, column], np.linalg.solve(to_xyz, xyz), rtol=2e-3, atol=1e-5)
    assert (texels[rows // 2 :] == 0).all()


@pytest.mark.parametrize("turbidity", [2.0, 6.0, 10.0])
@pytest.mark.parametrize("height", [0.0, 0.02, 0.5, 1.0])
def test_every_sky_is_bright_and_finite(turbidity, height):
    """From sunset to noon, a horizontal plane gets 0.4 to 120 klx of the sky."""
    sun = [math.sqrt(1 - height**2), height, 0.0]
    texels = tr.sky(sun, turbidity, height=64).double()
    assert bool(torch.isfinite(texels).all()) and bool((texels >= 0).all())
    cosine = torch.cos(torch.arange(64, dtype=torch.float64) * math.pi / 63).clamp(min=0)
    weights = (daylight._solid_angles(64) * cosine)[:, None, None]
    lux = (texels * weights).sum((0, 1)) @ torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64) * 72984
    assert 4e2 < lux < 1.2e5
    power = daylight.sun(sun, turbidity)
    assert bool(torch.isfinite(power).all()) and bool((power >= 0).all())


def test_sunlight():
    """At noon, in clear air, about 100 klx, redder than above the atmosphere; redder and weaker the lower it stands."""
    luminance = torch.tensor([0.2126, 0.7152, 0.0722])
    high, low, lowest = (daylight.sun([math.cos(a), math.sin(a), 0.0], 2.5) for a in (1.5, 0.5, 0.1))
    assert 8e4 < float(high @ luminance) * 72984 < 1.1e5
    for more, less in ((high, low), (low, lowest)):
        assert bool((more > less).all()) and more[2] / more[0] > less[2] / less[0]
    # Mitsuba 3.9.1's sunsky, turbidity 3, sun at 45 degrees, integrated over the disc
    theirs = torch.tensor([1.4697, 1.2071, 0.8891])
    ratio = daylight.sun([1.0, 1.0, 0.0], 3.0) / theirs
    assert bool(((ratio > 0.85) & (ratio < 1.0)).all())


@pytest.mark.parametrize("height", [2, 3, 16, 61, 256])
@pytest.mark.parametrize("direction", [(0, 1, 0), SUN, (0, 0, -1), (1, 1e-3, 0)])
def test_disc_has_the_irradiance_it_was_given(height, direction):
    """Integrated as the emitter itself interpolates: a bilinear map, by midpoints much finer than its texels."""
    colour = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64)
    direction = torch.tensor(direction, dtype=torch.float64)
    texels = daylight.sun_disc(direction, colour, height=height, sun_aperture=2.0)
    fine = max(20 * (height - 1), 400)
    theta = (torch.arange(fine, dtype=torch.float64) + 0.5) * (math.pi / fine)
    rows = texels.sum(1)  # the bilinear weights of a row's texels have the same integral
    at = theta / math.pi * (height - 1)
    low = at.floor().long().clamp(max=height - 2)
    share = (at - low)[:, None]
    between = rows[low] * (1 - share) + rows[low + 1] * share
    total = (between * torch.sin(theta)[:, None]).sum(0) * (math.pi / fine) * (math.pi / height)
    torch.testing.assert_close(total, colour, rtol=1e-3, atol=0)
    if height >= 61:
        middle = (texels[..., :1] * daylight._directions(height, direction)).sum((0, 1))
        cosine = float(middle @ direction / middle.norm() / direction.norm())
        assert math.degrees(math.acos(min(1.0, cosine))) < 60 / height


def test_position_of_the_sun():
    """Example of Reda and Andreas, "Solar Position Algorithm", NREL/TP-560-34302, table A5.1, here without refraction.

    Golden, Colorado, 17 October 2003, 12:30:30: azimuth 194.34024 degrees, elevation 39.872046 before refraction.
    """
    east, north, up = daylight.sun_position(39.742476, -105.1786, -7, 2003, 10, 17, 12, 30, 30)
    assert math.degrees(math.asin(up)) == pytest.approx(39.872046, abs=0.01)
    assert math.degrees(math.atan2(east, north)) % 360 == pytest.approx(194.34024, abs=0.015)
    assert math.hypot(east, north, up) == pytest.approx(1, abs=1e-12)
    # Solstice in June: at noon of the sun it stands in the zenith of 23.44 degrees north.
    best = max(daylight.sun_position(23.44, 0, 0, 2012, 6, 20, 12, minute)[2] for minute in range(10))
    assert best == pytest.approx(1, abs=1e-5)
    with pytest.raises(ValueError, match="day is out of range"):
        daylight.sun_position(0, 0, 0, 2011, 2, 29, 12)


# --------------------------------------------------------------------------------------------------------- plugin


def make(dtype=torch.float32, **settings):
    sky = {"type": "sunsky", "height": 32, **settings}
    camera = tr.PerspectiveCamera.look_at([0, 2, 6], [0, 0.5, 0], fov=40, size=(6, 8), filter="box")
    floor = {"type": "rectangle", "to_world": tr.Transform.rotate([1, 0, 0], -90).scale(5)}
    return tr.load_dict(
        {"type": "scene", "camera": camera, "sky": sky, "floor": floor, "ball": {"type": "sphere"}}, dtype=dtype
    )


UPRIGHT = tr.Transform.rotate([1, 0, 0], -90)  # +z of the sky to +y of the world


def test_plugin_is_an_environment_map():
    """Light from where `sun_direction` says, under any `to_world`; scales; parameters of an environment map."""
    scene = make(sun_direction=SUN, to_world=UPRIGHT, turbidity=4.0, sky_scale=0.5, sun_scale=2.0, sampling_weight=3.0)
    expected = 0.5 * tr.sky(SUN, 4.0, height=32) + daylight.sun_disc(SUN, 2 * daylight.sun(SUN, 4.0), height=32)
    torch.testing.assert_close(scene.sky.data, expected, rtol=1e-4, atol=1e-4)
    assert scene.sky.type == "envmap" and float(scene.sky.sampling_weight) == 3
    names = {n for n, _ in scene.sky.named_parameters()}
    assert names == {"data", "scale", "to_world", "sampling_weight"}
    d = torch.tensor(SUN) / torch.tensor(SUN).norm()
    turned = tr.Transform.rotate([1, 2, 3], 10).matrix @ UPRIGHT.matrix
    for to_world in (UPRIGHT, turned):
        sun = make(sun_direction=SUN, to_world=to_world, sky_scale=0.0, sun_aperture=8.0).sky
        seen = sun.to_world[:3, :3].double() @ (
            sun.data.double().sum(-1, keepdim=True) * daylight._directions(32, torch.ones((), dtype=torch.float64))
        ).sum((0, 1))
        assert math.degrees(math.acos(min(1.0, float(seen @ d.double() / seen.norm())))) < 1.5
    assert make(sun_scale=0.0).sky.data.max() < 1 < make().sky.data.max()


def test_place_and_time_are_mitsubas():
    """The sun's direction of Mitsuba 3.9.1's sunsky, without parameters and at Sydney on a morning in January."""
    sydney = {"latitude": -33.87, "longitude": 151.21, "timezone": 10.0}
    sydney |= {"year": 2024, "month": 1, "day": 15, "hour": 8.0, "minute": 30.0}
    for place, expected in (({}, (0.0513851, 0.691748, 0.720308)), (sydney, (-0.00761789, -0.749696, 0.661739))):
        texels = make(**place, sky_scale=0.0).sky
        again = make(sun_direction=expected, sky_scale=0.0).sky
        torch.testing.assert_close(texels.data, again.data, rtol=0, atol=5e-3 * float(again.data.max()))


def test_xml(tmp_path):
    text = """<scene version="3.0.0"><emitter type="sunsky" id="sky"><integer name="height" value="64"/>
      <float name="hour" value="12"/><integer name="month" value="3"/><float name="turbidity" value="2.5"/>
      <boolean name="complex_sun" value="false"/>
      <transform name="to_world"><rotate x="1" angle="-90"/></transform></emitter>
      <emitter type="sunsky" id="other"><integer name="height" value="64"/>
      <vector name="sun_direction" x="0" y="1" z="1"/><rgb name="albedo" value="0.1, 0.2, 0.3"/></emitter></scene>"""
    (tmp_path / "a.xml").write_text(text)
    with pytest.warns(tr.SubstitutionWarning, match="other: albedo is left out"):
        scene = tr.load_file(tmp_path / "a.xml")
    assert scene.sky.data.shape == scene.other.data.shape == (64, 128, 3)
    again = make(hour=12, month=3, turbidity=2.5, to_world=UPRIGHT, height=64)
    torch.testing.assert_close(scene.sky.data, again.sky.data)


def test_files_of_mitsuba_0_6(tmp_path):
    """Their up is +y; sky and sun are types of their own."""
    emitters = "".join(
        f"""<emitter type="{kind}" id="{kind}"><float name="turbidity" value="4"/><integer name="height" value="32"/>
        <vector name="sunDirection" x="0.5" y="0.6" z="-0.4"/>{more}</emitter>"""
        for kind, more in {
            "sunsky": '<float name="sunScale" value="0.5"/>',
            "sky": '<float name="scale" value="3"/>',
            "sun": '<transform name="toWorld"><rotate y="1" angle="90"/></transform>',
        }.items()
    )
    (tmp_path / "a.xml").write_text(f'<scene version="0.6.0">{emitters}</scene>')
    scene = tr.load_file(tmp_path / "a.xml")
    sky = tr.sky(SUN, 4.0, height=32)
    sun = daylight.sun_disc(SUN, daylight.sun(SUN, 4.0), height=32)
    near = {"rtol": 1e-3, "atol": 1e-4 * float(sun.max())}
    torch.testing.assert_close(scene["sunsky"].data, sky + 0.5 * sun, **near)
    torch.testing.assert_close(scene["sky"].data, 3 * sky, **near)
    torch.testing.assert_close(scene["sunsky"].to_world[:3, :3], torch.eye(3), rtol=0, atol=1e-6)
    # The map is turned with its frame, and the sun in it turned back: it stands where it was in the world.
    turned = scene["sun"].to_world[:3, :3]
    torch.testing.assert_close(turned, tr.Transform.rotate([0, 1, 0], 90).matrix[:3, :3].float(), rtol=0, atol=1e-6)
    again = torch.tensor(SUN) @ turned
    torch.testing.assert_close(scene["sun"].data, daylight.sun_disc(again, daylight.sun(SUN, 4.0), height=32), **near)


def test_stand_in_for_a_day_that_passes():
    day = {"type": "timed_sunsky", "turbidity": 5.0, "window_start_time": 9.0, "start_year": 2025}
    with pytest.warns(tr.SubstitutionWarning, match="by 'sunsky' without start_year, window_start_time"):
        scene = tr.load_dict({"type": "scene", "day": day}, unsupported="substitute")
    assert scene.day.data.shape == (512, 1024, 3)


def test_saved_and_loaded_again(tmp_path):
    scene = make(sun_direction=SUN, to_world=UPRIGHT)
    scene.save(tmp_path / "a.xml")
    again = tr.load_file(tmp_path / "a.xml")
    torch.testing.assert_close(again.sky.data, scene.sky.data)
    torch.testing.assert_close(again.sky.to_world, scene.sky.to_world)


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ({"turbidity": 11}, r"sky\.turbidity: expected 2 to 10, got 11"),
        ({"turbidity": "hazy"}, r"sky\.turbidity: expected numbers"),
        ({"sun_direction": [0, 0, -1]}, r"sky\.sun_direction: the sun is below the horizon: -90 degrees"),
        ({"sun_direction": [0, 0, 0]}, r"sky\.sun_direction: expected a finite direction that is not zero"),
        ({"sun_direction": [math.inf, 0, 0]}, r"sky\.sun_direction: expected a finite direction"),
        ({"sun_direction": [1, 0]}, r"sky\.sun_direction: expected three numbers"),
        ({"sun_direction": SUN, "hour": 3}, r"sky: .* sun_direction, or place and time \(hour\), but not both"),
        ({"hour": 23.5}, "sky: sunsky: the sun is below the horizon at this place and time"),
        ({"hour": 25}, r"sky\.hour: expected 0 to 24, got 25"),
        ({"day": 2.5}, r"sky\.day: expected an integer"),
        ({"month": 2, "day": 30}, "sky: day is out of range for month"),
        ({"year": 10**400}, r"sky\.year: expected 1900 to 2100"),
        ({"latitude": torch.ones((), requires_grad=True)}, r"sky\.latitude: has no derivative; give sun_direction"),
        ({"height": 1}, r"sky\.height: expected at least 2, got 1"),
        ({"height": 10**6}, r"sky\.height: expected at most 4096 rows"),
        ({"sun_scale": -1}, r"sky\.sun_scale: expected a factor of at least 0, got -1"),
        ({"sky_scale": math.nan}, r"sky\.sky_scale: expected a factor"),
        ({"sun_aperture": 0}, r"sky: .*sun_aperture: expected degrees in \(0, 90\], got 0"),
        ({"turbidty": 3}, "sky: sunsky has no parameter 'turbidty'; did you mean 'turbidity'"),
        ({"to_world": tr.Transform.scale([1, 2, 1])}, r"sky\.to_world: .* may turn and move"),
    ],
)
def test_errors(properties, message):
    with pytest.raises(ValueError, match=message):
        make(**properties)


def test_errors_of_the_functions():
    with pytest.raises(ValueError, match=r"sky\.sun_direction: the sun is below the horizon: -45 degrees"):
        tr.sky([1.0, -1.0, 0.0])
    with pytest.raises(ValueError, match=r"sun\.turbidity: expected 2 to 10, got 1\.5"):
        daylight.sun(SUN, 1.5)
    with pytest.raises(ValueError, match=r"sun_disc\.irradiance: expected three numbers"):
        daylight.sun_disc(SUN, 2.0)


# ----------------------------------------------------------------------------------------------------- derivatives


@pytest.mark.parametrize(
    "function",
    [
        lambda d, t: tr.sky(d, t, height=6),
        daylight.sun,
        lambda d, t: daylight.sun_disc(d, t * torch.ones(3).to(d), height=6, sun_aperture=60.0),
    ],
)
def test_gradcheck(function):
    direction = torch.tensor(SUN, dtype=torch.float64, requires_grad=True)
    turbidity = torch.tensor(3.3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, (direction, turbidity), check_forward_ad=True, fast_mode=True)


def test_derivative_with_the_sun_in_the_zenith_is_finite():
    direction = torch.tensor([0.0, 1.0, 0.0], requires_grad=True)
    (tr.sky(direction, height=16).sum() + daylight.sun(direction).sum()).backward()
    assert bool(torch.isfinite(direction.grad).all())


# An image whose samples are those of the BSDFs is linear in the map, so that differences of it are not noisy.
DIRECT = tr.DirectIllumination(emitter_samples=0, bsdf_samples=4)
RENDER = {"spp": 64, "seed": 1, "correlated": True, "integrator": DIRECT}
VALUES = {
    "sun_direction": torch.tensor(SUN, dtype=torch.float64),
    "turbidity": torch.tensor(3.0, dtype=torch.float64),
    "sun_scale": torch.tensor(1.5, dtype=torch.float64),
}


def given_to_the_plugin(**values):
    scene = make(torch.float64, sun_aperture=30.0, to_world=UPRIGHT, **values)
    return tr.render(scene, **RENDER)


def given_as_texels(sun_direction, turbidity, sun_scale):
    disc = daylight.sun_disc(
        sun_direction, daylight.sun(sun_direction, turbidity) * sun_scale, height=32, sun_aperture=30.0
    )
    texels = tr.sky(sun_direction, turbidity, height=32) + disc
    return tr.render(make(torch.float64, to_world=UPRIGHT), params={"sky.data": texels}, **RENDER)


@pytest.mark.parametrize("image_of", [given_to_the_plugin, given_as_texels])
@pytest.mark.parametrize("name", VALUES)
def test_derivatives_of_an_image(image_of, name):
    """Differences, reverse mode and forward mode."""
    tangent = torch.tensor([0.3, -0.5, 0.4] if name == "sun_direction" else 1.0, dtype=torch.float64)
    h = 1e-5
    below, above = (image_of(**{**VALUES, name: VALUES[name] + s * h * tangent}) for s in (-1, 1))
    difference = (above - below) / (2 * h)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(VALUES[name], tangent)
        primal, forward = forward_ad.unpack_dual(image_of(**{**VALUES, name: dual}))
    assert float(difference.abs().max()) > 1e-2 * float(primal.max())
    torch.testing.assert_close(forward, difference, rtol=1e-4, atol=1e-5 * float(difference.abs().max()))
    leaf = VALUES[name].clone().requires_grad_()
    weights = torch.rand(primal.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    (image_of(**{**VALUES, name: leaf}) * weights).sum().backward()
    assert float((leaf.grad * tangent).sum()) == pytest.approx(float((forward * weights).sum()), rel=1e-9)
