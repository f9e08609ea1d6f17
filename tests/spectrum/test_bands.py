"""Films of bands of wavelengths, responses of sensors, and `mono` scenes at one wavelength."""

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

sp = tr.spectrum
pytestmark = pytest.mark.core
REFLECTANCE, LIGHT = waves(2), waves(1, 0.0, 2.0)


def film(bands: dict, **more) -> dict:
    """As a dict of the format that Mitsuba documents."""
    return {**camera()["film"], "type": "specfilm", **bands, **more}


def regular(values: torch.Tensor, low: float = 360.0, high: float = 830.0) -> dict:
    return {"type": "regular", "wavelength_min": low, "wavelength_max": high, "values": values.tolist()}


def integral(table: torch.Tensor) -> torch.Tensor:
    """Over wavelengths in nm, of what is quadratic or so in between."""
    ends = table.new_ones(471)
    ends[[0, -1]] = 0.5
    return table @ ends


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_bands_are_integrals(count, dtype):
    """Of radiance times response; in the order of the dict, under their names."""
    names = [f"{'zyxwvut'[i]}_{i}" for i in range(count)]
    tables = torch.stack([waves(30 + i, 0.0, 2.0**i) for i in range(count)])
    scene = plate(REFLECTANCE, LIGHT, {"type": "specfilm", **dict(zip(names, map(regular, tables)))}, dtype=dtype)
    assert scene.sensors[0].film.channels == tuple(names)
    expected = integral(tables * REFLECTANCE * LIGHT) / math.pi
    found = runs(scene, 64)
    for i in range(count):  # each to its own size
        assert_mean(found[:, i : i + 1], expected[i : i + 1], names[i])
    batch = tr.render(scene, sensor=[0, 0], layout="bchw", spp=1)
    assert batch.shape == (2, count, 16, 16) and batch.dtype == dtype


@pytest.mark.parametrize("width", [0.2, 1.0, 2.0, 35.0])
def test_narrow_bands_keep_their_integrals(width):
    at = 543.3
    hat = {"type": "irregular", "wavelengths": [at - width, at, at + width], "values": [0.0, 3.0, 0.0]}
    scene = plate(REFLECTANCE, LIGHT, {"type": "specfilm", "hat": hat})
    fine = torch.linspace(at - width, at + width, 4001, dtype=DOUBLE)
    seen = (1 - (fine - at).abs() / width) * 3 / math.pi
    for table in (REFLECTANCE, LIGHT):
        below = (fine - 360).floor().long()
        seen = seen * torch.lerp(table[below], table[below + 1], fine - 360 - below)
    assert_mean(runs(scene, 64), torch.trapezoid(seen, fine)[None], systematic=2e-3)


def test_the_film_as_an_object():
    responses = {"a": waves(40), "b": 1.0, "c": {"type": "blackbody", "temperature": 3000.0}}
    scene = plate(REFLECTANCE, LIGHT)
    scene.sensors[0].film = tr.Film(16, 16, filter=tr.ReconstructionFilter("box"), bands=responses)
    tables = torch.stack([waves(40), torch.ones_like(GRID), sp.blackbody(torch.tensor(3000.0, dtype=DOUBLE))])
    expected = integral(tables * REFLECTANCE * LIGHT) / math.pi
    found = runs(scene, 64) / expected
    assert_mean(found, torch.ones_like(expected))


def test_outputs_beside_bands():
    scene = plate(REFLECTANCE, LIGHT, {"type": "specfilm", **{f"b{i}": regular(waves(i)) for i in range(4)}})
    found = tr.render(scene, spp=4, seed=1, outputs=("rgb", "alpha", "variance", "second_moment", "depth"))
    assert found.rgb.shape == found.variance.shape == found.second_moment.shape == (16, 16, 4)
    assert found.alpha.shape == found.depth.shape == (16, 16)
    assert torch.equal(found.rgb, tr.render(scene, spp=4, seed=1))
    # samples of one pixel have hues in turn: the variance of independent ones is an upper estimate
    assert bool((found.variance.mean((0, 1)) > 0.5 * found.rgb.var((0, 1))).all())


def test_responses_of_sensors():
    """They multiply those of the film: of the observer and of bands."""
    response = waves(50, 0.0, 1.0)
    for bands in ({}, {"one": regular(waves(51)), "two": regular(waves(52))}):
        described = {**camera(film=film(bands) if bands else None), "srf": regular(response)}
        objects = {
            "camera": described,
            "plate": {"type": "rectangle", "to_world": tr.Transform.scale(10), "bsdf": diffuse(REFLECTANCE)},
            "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": LIGHT},
        }
        seen = response * REFLECTANCE * LIGHT / math.pi
        tables = torch.stack([waves(51), waves(52)])
        assert_mean(runs(load(objects), 64), integral(tables * seen) if bands else sp.to_rgb(seen))


def test_the_observer_as_bands():
    """Red, green and blue as three bands are the image without bands. Responses are not negative: of X, Y and Z."""
    xyz = torch.from_numpy(sp.cie.XYZ_TO_RGB).inverse()
    tables = (sp.responses() @ xyz.T).clamp(min=0)
    tables[[0, -1]] *= 2  # the ends of the table of responses have half a nanometre
    bands = dict(zip("XYZ", map(regular, tables.T)))
    found = runs(plate(REFLECTANCE, LIGHT, {"type": "specfilm", **bands}), 64)
    assert_mean(found @ xyz.inverse().T, sp.to_rgb(REFLECTANCE * LIGHT) / math.pi)


@pytest.mark.parametrize("wavelength", [452.0, 589.0, 641.0])
def test_a_band_of_a_nanometre_is_a_wavelength(wavelength):
    """Metal, dispersive glass, coats: by a band, and by `mono`. Not where daylight's table has a corner: within a
    nanometre of it lights, which are relative to it, are quadratic, which is 0.2 % of the band."""
    fields = {
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": diffuse(waves(3)),
        },
        "metal": {
            "type": "sphere",
            "center": [-1.2, -0.3, 0],
            "radius": 0.6,
            "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.3},
        },
        "glass": {
            "type": "sphere",
            "center": [0.1, -0.3, 0.4],
            "radius": 0.6,
            "bsdf": {"type": "dielectric", "int_ior": {"type": "glass", "name": "SF10"}},
        },
        "coat": {
            "type": "sphere",
            "center": [1.4, -0.3, 0],
            "radius": 0.6,
            "bsdf": {"type": "plastic", "diffuse_reflectance": waves(4)},
        },
        "sky": {"type": "constant", "radiance": waves(5, 0.5, 1.0)},
        "sun": {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": waves(6, 1.0, 2.0)},
    }
    hat = {"type": "irregular", "wavelengths": [wavelength - 1, wavelength, wavelength + 1], "values": [0, 1, 0]}
    seen = {"origin": (0, 0.5, 4), "fov": 50}
    band = load({"camera": camera(film={"type": "specfilm", "hat": hat}, **seen), **fields}, depth=6)
    mono = load({"camera": camera(**seen), **fields}, "mono", depth=6, wavelength=wavelength)
    images = []
    for scene, spp, first in ((band, 64, 0), (mono, 64, 1000)):
        blocks = torch.stack([tr.render(scene, spp=spp, seed=first + i) for i in range(24)])
        images.append(blocks.reshape(24, 4, 4, 4, 4, 1).mean((2, 4)))
    assert_same_mean(*images, systematic=1e-3)


def test_mono_without_a_wavelength_is_luminance():
    found = runs(plate(colour(0.8, 0.2, 0.1), math.pi, variant="mono"))
    assert torch.allclose(
        found, torch.tensor(0.8 * 0.2126 + 0.2 * 0.7152 + 0.1 * 0.0722, dtype=DOUBLE), rtol=1e-3, atol=0
    )
