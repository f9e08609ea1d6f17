"""Dispersive glass: directions and energies against closed forms, and against glass that does not disperse."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from spectral_objects import DOUBLE, GRID, assert_mean, assert_same_mean, camera, load, runs, waves

import torchrender as tr

sp = tr.spectrum
pytestmark = pytest.mark.core
LINES = {"F": 486.13, "d": 587.56, "C": 656.27}  # nm
# Deviation in degrees of prisms of 60 degrees at the minimum: 2 asin(n / 2) - 60 with n of the catalogue.
PRISMS = {
    "N-BK7": {"F": 39.138, "d": 38.647, "C": 38.429},
    "SF10": {"F": 61.675, "d": 59.566, "C": 58.728},
    "F2": {"F": 49.381, "d": 48.196, "C": 47.708},
}


def glass(table: torch.Tensor | dict | float, **more) -> dict:
    return {"type": "dispersivedielectric", "int_ior": table, "ext_ior": 1.0, **more}


def band(center: float) -> dict:
    return {"type": "irregular", "wavelengths": [center - 1, center, center + 1], "values": [0, 1, 0]}


def normal_reflectance(n: torch.Tensor) -> torch.Tensor:
    return ((n - 1) / (n + 1)).square()


# ---------------------------------------------------------------------------------------------------------- directions
def prism(name: str, incidence: float, lamp: dict, place: tr.Transform, line: float) -> tr.Scene:
    """A pencil of light, followed from its end, through the middles of both faces of a prism in the plane y = 0."""
    s = math.sqrt(3)
    corners = [(x, y, z) for y in (-1, 1) for x, z in ((0, s), (-1, 0), (1, 0))]
    faces = [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (0, 2, 5), (0, 5, 3), (1, 4, 5), (1, 5, 2)]
    entry, normal = np.array([-0.5, 0, s / 2]), np.array([-s / 2, 0, 0.5])
    along = np.array([0.5, 0, s / 2])  # up the face; light comes from below it
    back = math.cos(incidence) * normal - math.sin(incidence) * along
    hat = {"type": "specfilm", "width": 8, "height": 8, "line": band(line)}
    objects = {
        "camera": camera(fov=1e-5, origin=entry + 2 * back, target=entry, film=hat),
        "prism": tr.Mesh(
            vertex_positions=torch.tensor(corners, dtype=DOUBLE),
            faces=torch.tensor(faces),
            bsdf=glass({"type": "glass", "name": name}),
        ),
        "lamp": {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": lamp}},
    }
    return load(objects, depth=3)


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("name", PRISMS)
def test_prisms_at_minimum_deviation(name, line):
    """What arrives at a far screen whose brightness grows across it says where it arrives."""
    deviation = math.radians(PRISMS[name][line])
    s, distance, half = math.sqrt(3), 1000.0, 40.0
    leave, incidence = np.array([0.5, 0, s / 2]), deviation / 2 + math.pi / 6
    forward = np.array([math.cos(deviation / 2), 0, -math.sin(deviation / 2)])
    came = forward * np.array([1, 1, -1])  # both are alike to the base
    # the screen is not where light is expected, but half a degree off
    turned = deviation / 2 + math.radians(0.5)
    middle = leave + distance * np.array([math.cos(turned), 0, -math.sin(turned)])
    place = tr.Transform.look_at(list(middle), list(leave), [0, 1, 0]).scale(half)
    ramp = {"type": "bitmap", "data": torch.tensor([[[1.0], [2.0]]], dtype=DOUBLE), "raw": True, "wrap_mode": "clamp"}
    seen = [runs(prism(name, incidence, lamp, place, LINES[line]), 64).mean() for lamp in (ramp, 1.0)]
    u = 0.25 + 0.5 * (float(seen[0] / seen[1]) - 1)
    assert 0.26 < u < 0.74
    axis = np.asarray(place.matrix, dtype=np.float64)[:3, 0]
    found = middle + (2 * u - 1) * axis - leave
    cosine = float(found @ came / np.linalg.norm(found))
    assert math.degrees(math.acos(cosine)) == pytest.approx(PRISMS[name][line], abs=1e-3)


# ------------------------------------------------------------------------------------------------------------ energies
def test_reflection_by_wavelength():
    index = sp.cauchy(torch.tensor(1.4, dtype=DOUBLE), torch.tensor(0.06, dtype=DOUBLE))
    window = {"type": "rectangle", "bsdf": glass(index, specular_transmittance=0.0)}
    scene = load({"camera": camera(32, fov=0.01), "window": window, "sky": {"type": "constant", "radiance": waves(1)}})
    assert_mean(runs(scene, 64), sp.to_rgb(normal_reflectance(index) * waves(1)))


def slab(index, depth: int = 40, size: int = 32, dtype=DOUBLE) -> tr.Scene:
    """A pane before a lamp, seen straight through."""
    objects = {
        "camera": camera(size, fov=0.01),
        "pane": {"type": "cube", "to_world": tr.Transform.scale([5, 5, 0.3]), "bsdf": glass(index)},
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 0, -2]),
            "emitter": {"type": "area", "radiance": waves(2)},
        },
    }
    return load(objects, dtype=dtype, depth=depth)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_two_refractions(dtype):
    """Of all reflections within a pane 2 n / (n^2 + 1) comes through."""
    index = sp.cauchy(torch.tensor(1.4, dtype=DOUBLE), torch.tensor(0.06, dtype=DOUBLE))
    assert_mean(runs(slab(index, dtype=dtype), 64), sp.to_rgb(2 * index / (index**2 + 1) * waves(2)))


def test_energy_is_kept():
    """Inside and around a diamond, in a sky of one brightness: nothing is to be seen of it."""
    ball = {"type": "sphere", "bsdf": glass({"type": "glass", "name": "diamond"})}
    scene = load(
        {"camera": camera(16, fov=20), "ball": ball, "sky": {"type": "constant", "radiance": waves(4)}}, depth=-1
    )
    assert_mean(runs(scene, 64), sp.to_rgb(waves(4)))


# ---------------------------------------------------------------------------------- glass that does not disperse
def sphere(bsdf: dict, variant: str = "spectral", depth: int = 8, dtype=DOUBLE, film=None, **settings) -> tr.Scene:
    """A ball before a smooth grey sky, which is brighter to one side."""
    theta, phi = np.linspace(0, np.pi, 33)[:, None], np.linspace(0, 2 * np.pi, 64, endpoint=False)[None]
    sky = 1 + 0.6 * np.sin(theta) * np.cos(phi + 1) + 0.3 * np.cos(theta)
    objects = {
        "camera": camera(16, fov=40, origin=(0, 0, 4), film=film),
        "sky": {"type": "envmap", "data": torch.tensor(sky[..., None], dtype=DOUBLE)},
        "ball": {"type": "sphere", "bsdf": bsdf},
    }
    return load(objects, variant, dtype, depth, **settings)


def blocks(scene: tr.Scene, first: int, spp: int = 32) -> torch.Tensor:
    with torch.no_grad():
        images = torch.stack([tr.render(scene, spp=spp, seed=first + i) for i in range(24)])
    return images.reshape(24, 4, 4, 4, 4, -1).mean((2, 4))


def test_a_constant_index():
    """Then it is a dielectric, with the noise of colour of single wavelengths."""
    flat = torch.full((471,), 1.5, dtype=DOUBLE)
    plain = blocks(sphere({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}), 0)
    assert_same_mean(blocks(sphere(glass(flat)), 100), plain)
    assert_same_mean(blocks(sphere(glass(1.5)), 200), plain)
    # in rgb nothing is split, and the paths are the same
    images = [
        tr.render(sphere(bsdf, "rgb"), spp=8, seed=1)
        for bsdf in (glass(1.5), {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    ]
    assert torch.allclose(*images, rtol=1e-12, atol=1e-12)


def test_dispersion_is_the_mean_of_wavelengths():
    """Of images in `mono` of 12 wavelengths a run, each a band's share: from 450 to 650 nm, of strong dispersion."""
    index = {"type": "cauchy", "A": 1.4, "B": 0.04}
    box = {"type": "regular", "wavelength_min": 450.0, "wavelength_max": 650.0, "values": [1.0, 1.0]}
    found = blocks(sphere(glass(index), film={"type": "specfilm", "box": box}), 0) / 200
    light = sp.d65()
    images = []
    for run in range(24):  # the midpoints of cells, jittered by runs
        places = 450 + (torch.arange(12) + (run + 0.5) / 24) * 200 / 12
        total = 0
        for i, at in enumerate(places.tolist()):
            scene = sphere(glass(index), "mono", wavelength=at)
            brightness = float(np.interp(at, GRID, light))
            total = total + brightness * tr.render(scene, spp=8, seed=1000 + 12 * run + i) / 12
        images.append(total)
    means = torch.stack(images).reshape(24, 4, 4, 4, 4, 1).mean((2, 4))
    assert_same_mean(found, means, systematic=1e-3)


@pytest.mark.parametrize("variant", ["rgb", "mono"])
def test_other_variants_take_the_sodium_line(variant):
    table = sp.glass("SF10")
    n = float(torch.lerp(table[229], table[230], 0.3))  # at 589.3 nm
    expected = tr.render(sphere({"type": "dielectric", "eta": n}, variant), spp=4, seed=1)
    for index in (
        {"type": "glass", "name": "SF10"},
        table,
        {"type": "regular", "values": table.tolist(), "wavelength_min": 360, "wavelength_max": 830},
    ):
        for given in ({"type": "dielectric", "int_ior": index, "ext_ior": 1.0}, {"type": "dielectric", "eta": index}):
            scene = sphere(given, variant)
            assert isinstance(scene.ball.bsdf, tr.DispersiveDielectric)
            assert torch.allclose(tr.render(scene, spp=4, seed=1), expected, rtol=1e-9, atol=1e-12)
    other = sphere({"type": "dielectric", "int_ior": table}, variant)  # in air
    assert float(other.get_parameter("ball.bsdf.eta.value").mean()) == pytest.approx(n / 1.000277, rel=1e-9)


def test_mono_takes_its_wavelength():
    for at in (486.13, 656.27):
        n = float(np.interp(at, GRID, sp.glass("SF10")))
        scene = sphere(
            {"type": "dielectric", "int_ior": {"type": "glass", "name": "SF10"}, "ext_ior": 1.0}, "mono", wavelength=at
        )
        expected = tr.render(sphere({"type": "dielectric", "eta": n}, "mono"), spp=4, seed=1)
        assert torch.allclose(tr.render(scene, spp=4, seed=1), expected, rtol=1e-9, atol=1e-12)
