"""Wrong spectra, bands and settings of spectral scenes: errors name the place, what was expected and what came."""

from __future__ import annotations

import math
import re

import pytest
import torch
from spectral_objects import DOUBLE, camera

import torchrender as tr


def scene(
    variant: str = "spectral", *, reflectance=0.5, sky=1.0, bsdf=None, film=None, srf=None, **settings
) -> tr.Scene:
    sensor = camera(4, film=film)
    if srf is not None:
        sensor["srf"] = srf
    objects = {
        "camera": sensor,
        "wall": {"type": "rectangle", "bsdf": bsdf or {"type": "diffuse", "reflectance": reflectance}},
        "sky": {"type": "constant", "radiance": sky},
    }
    return tr.load_dict({"type": "scene", **objects}, variant=variant, **settings)


def pairs(wavelengths, values) -> dict:
    return {"type": "irregular", "wavelengths": wavelengths, "values": values}


def regular(low, high, values) -> dict:
    return {"type": "regular", "wavelength_min": low, "wavelength_max": high, "values": values}


WALL = "wall.bsdf.reflectance.value: "
SPECTRA = {
    "order": (pairs([500, 400], [0.1, 0.2]), WALL + "the wavelengths of a spectrum must increase"),
    "equal": ({"type": "spectrum", "value": [(400, 0.1), (400, 0.2)]}, WALL + "the wavelengths of .* must increase"),
    "no values": (pairs([], []), WALL + ".*two wavelengths or more.*got 0 wavelengths and 0 values"),
    "one value": (regular(400, 700, [0.1]), WALL + ".*two wavelengths or more.*got 1 wavelengths"),
    "too many": (pairs([400, 500], [0.1, 0.2, 0.3]), WALL + ".*got 2 wavelengths and 3 values"),
    "NaN": (pairs([400, 500], [0.1, math.nan]), WALL + "the spectrum has values that are not finite"),
    "infinite": (pairs([400, math.inf], [0.1, 0.1]), WALL + "the spectrum has values that are not finite"),
    "micrometres": (pairs([0.4, 0.7], [0.1, 0.2]), WALL + "the spectrum, of 0.4 to 0.7 nm, has nothing .* visible"),
    "infrared": (regular(900, 1000, [0.1, 0.2]), WALL + "the spectrum, of 900 to 1000 nm, has nothing .* 360 to 830"),
    "backwards": (regular(700, 400, [0.1, 0.2]), WALL + "the wavelengths of a spectrum must increase"),
    "triples": ({"type": "spectrum", "value": [(400, 1, 3), (500, 2, 3)]}, WALL[:-2] + ".value: expected pairs"),
    "coefficients": ({"type": "sigmoid", "coefficients": [1, 2]}, WALL[:-2] + ".coefficients: expected three numbers"),
    "short table": (torch.full((470,), 0.5), WALL + r"expected a number or a colour .*\(470,\)"),
    "NaN in a table": (torch.full((471,), math.nan), WALL + "has values that are not finite"),
    "negative": (torch.full((471,), -1.0), WALL + r"-1 is outside the range \[0, 1\] of reflectance"),
    "above one": (torch.full((471,), 2.0), WALL + r"2 is outside the range \[0, 1\] of reflectance"),
}


@pytest.mark.parametrize("name", SPECTRA)
def test_spectra(name):
    given, message = SPECTRA[name]
    with pytest.raises(ValueError, match=message):
        scene(reflectance=given)


SKIES = {
    "cold": ({"type": "blackbody", "temperature": -3.0}, "blackbody: expected a positive temperature"),
    "invisible": (
        {"type": "blackbody", "temperature": 3000.0, "wavelength_min": 900, "wavelength_max": 1000},
        "blackbody: .* range of visible wavelengths",
    ),
    "infrared": (pairs([900, 1000], [1, 1]), ".*nothing that is visible"),
    "negative": (torch.full((471,), -1.0), r"-1 is outside the range \[0, inf\] of radiance"),
    "NaN": (torch.full((471,), math.nan), "has values that are not finite"),
}


@pytest.mark.parametrize("name", SKIES)
def test_light(name):
    given, message = SKIES[name]
    with pytest.raises(ValueError, match="sky.radiance.value: " + message):
        scene(sky=given)


@pytest.mark.parametrize("place", ["wall", "sky"])
def test_what_is_negative_in_part_is_clipped_with_a_warning(place):
    given = pairs([400, 500, 600], [-0.5, 0.5, 0.4])
    with pytest.warns(UserWarning, match=rf"{place}\..*: the spectrum .* is out of range and was clipped"):
        made = scene(**{"reflectance" if place == "wall" else "sky": given})
    name = "wall.bsdf.reflectance.value" if place == "wall" else "sky.radiance.value"
    assert float(made.get_parameter(name).min()) == 0 and float(made.get_parameter(name).max()) == 0.5


FILES = {
    "word.spd": (b"400 0.5\n500 x\n", "word.spd, line 2: expected a wavelength and a value, got '500 x'"),
    "empty.spd": (b"# nothing\n", "empty.spd: the file has no wavelengths"),
    "order.spd": (b"500 1\n400 1\n", "order.spd: the wavelengths of a spectrum must increase"),
    "three.spd": (b"400 0.5 3\n", "three.spd, line 1: expected a wavelength and a value"),
    "bytes.spd": (bytes(range(256)), "bytes.spd, line 1: expected a wavelength and a value"),
    "nan.spd": (b"400 nan\n500 1\n", "nan.spd: the spectrum has values that are not finite"),
    "metres.spd": (b"400e-9 1\n700e-9 1\n", "metres.spd: the spectrum, of 4e-07 to 7e-07 nm, has nothing"),
}


@pytest.mark.parametrize("name", FILES)
def test_files(name, tmp_path):
    content, message = FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(message)):
        scene(reflectance={"type": "spectrum", "filename": str(tmp_path / name)})
    with pytest.raises(FileNotFoundError, match=r"wall.bsdf.reflectance.value.filename: no such file: .*other.spd"):
        scene(reflectance={"type": "spectrum", "filename": str(tmp_path / "other.spd")})


INDICES = {
    "unknown": ({"type": "glass", "name": "BK77"}, r"int_ior: name: expected a material.*did you mean 'N-BK7'"),
    "negative": (pairs([400, 700], [-1, 1]), "int_ior: an index of refraction is positive, got -1"),
    "colour": ({"type": "rgb", "value": [1.5, 1.6, 1.7]}, "eta: expected a number or an index .* three numbers"),
    "NaN": (torch.full((471,), math.nan), "eta.value: has values that are not finite"),
    "half of Cauchy": ({"type": "cauchy", "A": 1.5}, "int_ior: cauchy: 'B' is missing"),
    "short": ({"type": "sellmeier", "B": [1, 2], "C": [1, 2, 3]}, "int_ior.B: expected 3 numbers"),
}


@pytest.mark.parametrize("variant", ["spectral", "rgb", "mono"])
@pytest.mark.parametrize("name", INDICES)
def test_indices_of_refraction(name, variant):
    given, message = INDICES[name]
    if (name, variant) == ("colour", "mono"):
        pytest.skip("there it is its luminance, a number")
    with pytest.raises(ValueError, match=r"wall\.bsdf\..*" + message):
        scene(variant, bsdf={"type": "dielectric", "int_ior": given})


def test_rough_glass_does_not_disperse():
    with pytest.raises(ValueError, match=r"wall.bsdf.int_ior: .*`dielectric` alone disperses"):
        scene(bsdf={"type": "roughdielectric", "int_ior": {"type": "glass", "name": "SF10"}})


def test_indices_go_on_beyond_what_was_measured():
    for variant, expected in (("spectral", None), ("rgb", 1.5 + 0.2 * 109.3 / 200), ("mono", 1.5 + 0.2 * 109.3 / 200)):
        measured = pairs([480, 680], [1.5, 1.7])
        made = scene(variant, bsdf={"type": "dielectric", "eta": measured}, dtype=DOUBLE)
        found = made.get_parameter("wall.bsdf.eta.value")
        if expected is not None:
            assert float(found.max()) == pytest.approx(expected, rel=1e-12)
        else:
            assert found[[0, 120, 320, 470]].tolist() == pytest.approx([1.5, 1.5, 1.7, 1.7], rel=1e-12)


BAND = pairs([400, 500], [1, 1])
BANDS = {
    "in rgb": (("rgb", {"type": "specfilm", "a": BAND}), "camera.film: specfilm: bands need wavelengths: .*'rgb'"),
    "none": (("spectral", {"type": "specfilm"}), "camera.film: specfilm: expected bands: spectra by name"),
    "nothing": (
        ("spectral", {"type": "specfilm", "a": BAND, "b": pairs([400, 500], [0, 0])}),
        "camera.film.b: .*positive",
    ),
    "NaN": (("spectral", {"type": "specfilm", "a": pairs([400, 500], [1, math.nan])}), "camera.film.a: .*not finite"),
    "infrared": (("spectral", {"type": "specfilm", "a": pairs([900, 1000], [1, 1])}), "camera.film.a: .*visible"),
}


@pytest.mark.parametrize("name", BANDS)
def test_bands(name):
    (variant, film), message = BANDS[name]
    with pytest.raises(ValueError, match=message):
        scene(variant, film=film)


def test_bands_of_film_objects():
    made = scene("rgb")
    made.sensors[0].film = tr.Film(4, 4, bands={"a": 1.0})
    with pytest.raises(ValueError, match=r"render: sensor: bands need wavelengths.*variant='spectral'"):
        tr.render(made, spp=1)
    for bands, message in (
        ({}, "bands: expected a dict of spectra by name"),
        ({"a": torch.ones(3)}, r"bands.a: expected a spectrum or a table of 471 numbers.*\(3,\)"),
        ({"a": torch.full((471,), -1.0)}, "bands.a: expected a response that is finite, not negative"),
    ):
        with pytest.raises(ValueError, match=message):
            tr.Film(4, 4, bands=bands)
        with pytest.raises(ValueError, match="film." + message):
            made = scene()
            made.sensors[0].film.bands = bands
            tr.render(made, spp=1)


def test_responses_of_sensors():
    with pytest.raises(ValueError, match=r"camera.srf: needs wavelengths: .*'spectral', not 'rgb'"):
        scene("rgb", srf=torch.ones(471))
    with pytest.raises(ValueError, match=r"camera.srf: expected a response that is finite, not negative"):
        scene(srf=torch.zeros(471))
    with pytest.raises(ValueError, match=r"camera.srf: .*\(470,\)"):
        scene(srf=torch.ones(470))


def test_settings():
    with pytest.raises(ValueError, match="unknown variant 'spectra'; did you mean 'spectral'"):
        scene("spectra")
    with pytest.raises(ValueError, match="wavelength: it is for variant='mono', not 'spectral'"):
        scene(wavelength=500.0)
    for wavelength in (300.0, 831.0, math.nan, "red", True):
        with pytest.raises(ValueError, match="wavelength: expected a number from 360 to 830 nm"):
            scene("mono", wavelength=wavelength)


def test_calls():
    made = scene()
    with pytest.raises(ValueError, match="integrator: WavefrontPathTracer has no wavelengths; PathTracer has them"):
        tr.render(made, integrator=tr.WavefrontPathTracer())
    for shape in ((470,), (2,), (471, 3)):
        with pytest.raises(ValueError, match=re.escape("params: wall.bsdf.reflectance.value: expected shape")):
            tr.render(made, params={"wall.bsdf.reflectance.value": torch.ones(shape)})
    # one colour in two places that make other spectra of it
    shared = {"type": "ref", "id": "paint"}
    objects = {
        "paint": {"type": "bitmap", "data": torch.rand(2, 2, 3)},
        "camera": camera(4),
        "wall": {
            "type": "rectangle",
            "bsdf": {"type": "diffuse", "reflectance": shared},
            "emitter": {"type": "area", "radiance": shared},
        },
    }
    with pytest.raises(ValueError, match=r"paint.data: .* light \(in wall.emitter.radiance\) .*one of its own"):
        tr.render(tr.load_dict({"type": "scene", **objects}, variant="spectral"), spp=1)
