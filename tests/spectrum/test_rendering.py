"""Spectral images against closed forms: integrals over wavelengths of products of tables.

Tests of means are Student's over pixels or seeds, see `spectral_objects`.
"""

from __future__ import annotations

import math

import pytest
import torch
from spectral_objects import (
    DOUBLE,
    GRID,
    assert_mean,
    assert_same_mean,
    camera,
    colour,
    diffuse,
    load,
    plate,
    runs,
    waves,
)

import torchrender as tr
from torchrender.scene.spectral import wavelengths

sp = tr.spectrum
pytestmark = pytest.mark.core


def double(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=DOUBLE)


LIGHTS = {
    "table": waves(1, 0.0, 2.0),
    "A": sp.illuminant_a(),
    "daylight": sp.d65(),
    "ones": torch.ones(471, dtype=DOUBLE),
    "line": sp.irregular([587.5, 588, 590, 590.5], double(0, 60, 60, 0)),
}


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("name", LIGHTS)
def test_light_times_reflectance(name, dtype):
    reflectance, light = waves(2), LIGHTS[name]
    expected = sp.to_rgb(reflectance * light) / math.pi
    assert_mean(runs(plate(reflectance, light, dtype=dtype), 64), expected, name)


def test_colours_come_back():
    """Of white light; red, green and blue of light and reflectance each stand for a spectrum."""
    for rgb in ((0.8, 0.2, 0.1), (0.05, 0.6, 0.3), (0.5, 0.5, 0.5), (0.0, 0.1, 0.9)):
        assert_mean(runs(plate(colour(*rgb), math.pi)), double(*rgb), f"{rgb}")
        assert_mean(runs(plate(1.0, colour(*(40 * c for c in rgb)))), 40 / math.pi * double(*rgb), f"light {rgb}")
        both = sp.upsample(double(*rgb)), sp.upsample(double(0.9, 0.5, 0.2), light=True)
        tables = [scale * sp.sigmoid(torch.stack(c)) for *c, scale in both]
        expected = sp.to_rgb(tables[0] * tables[1], sp.d65()) / math.pi
        assert_mean(runs(plate(colour(*rgb), colour(0.9, 0.5, 0.2))), expected, f"both {rgb}")


def test_light_that_is_seen():
    """The sky alone, without anything in it: a constant, a map, a lamp."""
    light = waves(5, 0.0, 3.0)
    assert_mean(runs(load({"camera": camera(), "sky": {"type": "constant", "radiance": light}})), sp.to_rgb(light))
    data = double(0.2, 0.7, 0.4).expand(4, 8, 3)
    assert_mean(
        runs(load({"camera": camera(), "sky": {"type": "envmap", "data": data}})), double(0.2, 0.7, 0.4), "map", 2e-3
    )
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "blackbody", "temperature": 3000.0}}}
    expected = sp.to_rgb(sp.blackbody(double(3000.0)[0]))
    assert_mean(runs(load({"camera": camera(), "lamp": lamp})), expected)


def test_metamers():
    """Two patches that are alike in daylight and not in lamplight."""
    weights = (sp.responses() * sp.d65()[:, None]).T
    wave = torch.sin(2 * torch.pi * (GRID - 360) / 110) + 0.5 * torch.cos(2 * torch.pi * (GRID - 360) / 70)
    black = wave - weights.T @ torch.linalg.solve(weights @ weights.T, weights @ wave)
    pair = [torch.full_like(GRID, 0.4), 0.4 + 0.3 * black / black.abs().max()]
    day = [runs(plate(table, math.pi * sp.d65()), 256) for table in pair]
    for patch in day:
        assert_mean(patch, sp.to_rgb(pair[0], sp.d65()), "in daylight")
    seen = [runs(plate(table, math.pi * sp.illuminant_a()), 256) for table in pair]
    for patch, table in zip(seen, pair, strict=True):
        assert_mean(patch, sp.to_rgb(table * sp.illuminant_a()), "in lamplight")
    expected = double([0.738, 0.330, 0.093], [0.778, 0.314, 0.101])
    assert torch.allclose(torch.stack([patch.mean(0) for patch in seen]), expected, rtol=0, atol=3e-3)
    assert float((day[0].mean(0) - day[1].mean(0)).abs().max()) < 2e-3


# Standard deviation over mean of a pixel's luminance with 4 and 16 samples, at most; measured 10 to 15 % below. Samples
# of independent wavelengths have 0.056 and 0.028 in daylight.
NOISE = {"daylight": (0.036, 0.006), "line": (0.13, 0.031)}


def noise(scene: tr.Scene, spp: int) -> float:
    pixels = torch.cat([runs(scene, spp, seed) for seed in range(8)]) @ double(0.2126, 0.7152, 0.0722)
    return float(pixels.std() / pixels.mean())


@pytest.mark.parametrize("name", NOISE)
def test_noise_of_colour(name):
    scene = plate(1.0, LIGHTS[name])
    for spp, largest in zip((4, 16), NOISE[name], strict=True):
        assert noise(scene, spp) < largest, spp


def test_wavelengths_go_where_the_light_is(monkeypatch):
    """A line of 2 nm: without the light in their density few find it."""
    aware = noise(plate(1.0, LIGHTS["line"]), 4)
    chosen = wavelengths.positions
    monkeypatch.setattr(wavelengths, "positions", lambda lights, seen: chosen([], seen))
    assert noise(plate(1.0, LIGHTS["line"]), 4) > 5 * aware


def test_light_between_surfaces():
    """Inside a ball that shines and reflects: light / (1 - reflectance)."""
    reflectance, light = waves(3, 0.1, 0.6), waves(4, 0.2, 1.0)
    ball = {
        "type": "sphere",
        "flip_normals": True,
        "bsdf": diffuse(reflectance),
        "emitter": {"type": "area", "radiance": light},
    }
    scene = load({"camera": camera(fov=60, origin=(0, 0, 0.1)), "ball": ball}, depth=-1)
    assert_mean(runs(scene, 32), sp.to_rgb(light / (1 - reflectance)), systematic=3e-4)


def test_white_furnace():
    """A white ball is not to be seen in a sky of its brightness, of whatever spectrum."""
    for light in (1.0, waves(7, 0.2, 1.0)):
        sky = {"type": "constant", "radiance": light}
        ball = {"type": "sphere", "bsdf": diffuse(1.0)}
        scene = load({"camera": camera(fov=10), "ball": ball, "sky": sky}, depth=-1)
        expected = double(1, 1, 1) if isinstance(light, float) else sp.to_rgb(light)
        assert_mean(runs(scene), expected)


def test_grey_scenes_are_those_of_rgb():
    """The same paths: only the noise of white light's colour is added."""
    objects = {
        "camera": camera(fov=50, origin=(0, 0.5, 4)),
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": diffuse(0.6),
        },
        "ball": {"type": "sphere", "bsdf": {"type": "plastic", "diffuse_reflectance": 0.4}},
        "sky": {"type": "constant", "radiance": 0.8},
        "bulb": {"type": "point", "position": [2, 2, 2], "intensity": 5.0},
    }
    images = [tr.render(load(objects, v, depth=4), spp=64, seed=3) for v in ("spectral", "rgb")]
    difference = images[0] - images[1]
    assert float(difference.mean((0, 1)).abs().max()) < 1e-3
    assert float(difference.abs().max()) < 0.04 * float(images[1].max())


def test_fog():
    """Absorption along a line, exp(-extinction * length) by wavelength; with scattering white light stays white."""
    extinction = waves(8, 0.1, 1.5)
    cube = {"type": "cube", "bsdf": {"type": "null"}}
    fog = {"type": "homogeneous", "sigma_t": extinction, "albedo": 0.0}
    sky = {"type": "constant", "radiance": 1.0}
    volpath = {"integrator": {"type": "volpath", "max_depth": -1}, "camera": camera(fov=0.01), "sky": sky}
    scene = load({**volpath, "fog": {**cube, "interior": fog}})
    assert_mean(runs(scene, 64), sp.to_rgb(torch.exp(-2 * extinction), sp.d65()))
    bright = {**volpath, "fog": {**cube, "interior": {**fog, "albedo": 1.0}}}
    assert_mean(runs(load(bright), 64), double(1, 1, 1))


def test_light_tracing_finds_the_same():
    objects = {
        "camera": camera(8, fov=60, origin=(0, 0, 3)),
        "wall": {"type": "rectangle", "to_world": tr.Transform.scale(2), "bsdf": diffuse(waves(2))},
        "lamp": {
            "type": "sphere",
            "center": [0.3, 0.2, 1.2],
            "radius": 0.2,
            "emitter": {"type": "area", "radiance": waves(9, 0.0, 8.0)},
        },
    }
    scene = load(objects, depth=3)
    light = [tr.render(scene, spp=128, seed=s, integrator=tr.ParticleTracer(max_depth=3)) for s in range(24)]
    paths = [tr.render(scene, spp=16, seed=100 + s) for s in range(24)]
    # means of quarters of the image
    light, paths = (torch.stack(i).reshape(24, 2, 4, 2, 4, 3).mean((2, 4)) for i in (light, paths))
    assert_same_mean(light, paths)
