"""Spectra in the rgb and mono variants: the colours that the standard observer sees."""

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.spectrum import cie

pytestmark = pytest.mark.once  # what scenes are made of

RAMP = [(400, 0.1), (700, 0.9)]


def reflectance(spectrum, **settings):
    return tr.load_dict({"type": "diffuse", "reflectance": spectrum}, **settings).reflectance.value


def intensity(spectrum, **settings):
    return tr.load_dict({"type": "point", "intensity": spectrum}, **settings).intensity.value


def close(value, expected, tolerance=2e-3):
    return value.shape == (len(expected),) and np.allclose(value.tolist(), expected, rtol=tolerance, atol=tolerance)


def test_matching_functions_against_their_analytic_fit():
    """Wyman, Sloan and Shirley, "Simple Analytic Approximations to the CIE XYZ Color Matching Functions" (2013).

    Their multi-lobe fit, equation 4 and table 1, is everywhere within 0.06 of the tables.
    """

    def lobe(w, center, below, above):
        return np.exp(-0.5 * ((w - center) * np.where(w < center, below, above)) ** 2)

    w = np.arange(360.0, 831.0, 5.0)
    x = 0.362 * lobe(w, 442.0, 0.0624, 0.0374) + 1.056 * lobe(w, 599.8, 0.0264, 0.0323)
    x -= 0.065 * lobe(w, 501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(w, 568.8, 0.0213, 0.0247) + 0.286 * lobe(w, 530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(w, 437.0, 0.0845, 0.0278) + 0.681 * lobe(w, 459.0, 0.0385, 0.0725)
    for fit, table in ((x, cie.X), (y, cie.Y), (z, cie.Z)):
        assert np.abs(fit - cie.numbers(table)).max() < 0.06
    assert len(cie.numbers(cie.D65)) == 95 and cie.numbers(cie.D65)[40] == 100  # its definition: 100 at 560 nm


@pytest.mark.parametrize("value", [0.5, [(360, 0.5), (830, 0.5)], [(300, 0.5), (500, 0.5), (900, 0.5)]])
def test_constant_spectra_are_exact(value):
    spectrum = {"type": "spectrum", "value": value}
    assert torch.allclose(reflectance(spectrum), torch.tensor(0.5), rtol=0, atol=1e-7)
    assert torch.allclose(reflectance(spectrum, variant="mono"), torch.tensor(0.5), rtol=0, atol=1e-7)
    # The colour of X = Y = Z = 0.5: rows of the matrix summed.
    assert close(intensity(spectrum), [0.6023970, 0.4741455, 0.4544580], 1e-6)
    assert torch.allclose(intensity(spectrum, variant="mono"), torch.tensor(0.5), rtol=0, atol=1e-5)


def test_tables_are_those_of_mitsuba():
    """Numbers of Mitsuba 3.9.1, whose sum over wavelengths is 0.1 % short."""
    spectrum = {"type": "spectrum", "value": RAMP}
    assert close(reflectance(spectrum), [0.7428528, 0.4811401, 0.2083246])
    assert close(intensity(spectrum), [0.8722148, 0.4587285, 0.1813014])
    assert close(reflectance(spectrum, variant="mono"), [0.5171099])
    assert close(intensity(spectrum, variant="mono"), [0.5266434])
    conductor = tr.load_dict({"type": "conductor", "eta": {"type": "spectrum", "value": [(400, 1.1), (700, 1.9)]}})
    assert close(conductor.eta.value, [1.7381948, 1.4808965, 1.2032337])


def test_colours_out_of_range_are_clipped_with_a_warning():
    green = {"type": "spectrum", "value": [(500, 1), (550, 1)]}
    with pytest.warns(UserWarning, match=r"reflectance.*out of range"):
        assert close(reflectance(green), [0, 0.6228326, 0], 1e-2)
    with pytest.warns(UserWarning, match="intensity.*out of range"):
        assert close(intensity({"type": "spectrum", "value": [(500, 3), (600, 2)]}), [0.38495, 2.5241568, 0], 2e-2)
    with pytest.warns(UserWarning, match=r"\(0.2\d+, 2.6"):
        assert close(reflectance({"type": "spectrum", "value": [(500, 3), (600, 2)]}), [0.2347264, 1, 0], 2e-2)


def test_other_spectra():
    regular = {"type": "regular", "wavelength_min": 400, "wavelength_max": 700, "values": "0.1, 0.9"}
    irregular = {"type": "irregular", "wavelengths": "400 700", "values": [0.1, 0.9]}
    ramp = reflectance({"type": "spectrum", "value": RAMP})
    assert torch.equal(reflectance(regular), ramp) and torch.equal(reflectance(irregular), ramp)
    assert intensity({"type": "d65", "scale": 2}).item() == 2
    assert close(intensity({"type": "d65", "color": [0.1, 0.2, 0.3], "scale": 2}), [0.2, 0.4, 0.6], 1e-6)
    # Planck at 5000 K and 560 nm is 1.277e4 W / (m^2 sr nm): about the Y of this light, to which green is near.
    warm = intensity({"type": "blackbody", "temperature": 5000})
    assert warm[0] > warm[1] > warm[2] and 1.15e4 < float(warm[1]) < 1.3e4
    wavelengths, radiance = cie.blackbody(5000.0)
    assert np.isclose(np.interp(560, wavelengths, radiance), 1.277e4, rtol=1e-3)


def test_spectra_of_nested_textures_and_media():
    """Under a texture a spectrum is a factor again, as in Mitsuba; a medium's emission is light."""
    half = {"type": "spectrum", "value": 0.5}
    light = tr.load_dict({"type": "area", "radiance": {"type": "checkerboard", "color0": half}})
    assert light.radiance.color0.value.item() == 0.5
    fog = tr.load_dict({"type": "homogeneous", "sigma_t": {"type": "spectrum", "value": [(360, 2), (830, 2)]},
                        "emission": half})  # fmt: skip
    assert close(fog.sigma_t.value.value, [2, 2, 2], 1e-6)
    assert close(fog.emission.value.value, [0.6023970, 0.4741455, 0.4544580], 1e-6)


def test_spectra_from_files(tmp_path):
    (tmp_path / "ramp.spd").write_text("# nm, value\n400 0.1\n700, 0.9  # the end\n\n")
    spectrum = {"type": "spectrum", "filename": str(tmp_path / "ramp.spd")}
    assert torch.equal(reflectance(spectrum), reflectance({"type": "spectrum", "value": RAMP}))
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><bsdf type="diffuse" id="b"><spectrum name="reflectance" filename="ramp.spd"/></bsdf>'
        '<emitter type="point" id="p"><spectrum name="intensity" value="400:0.1 700:0.9"/></emitter></scene>'
    )
    scene = tr.load_file(tmp_path / "scene.xml")
    assert close(scene.b.reflectance.value, [0.7428528, 0.4811401, 0.2083246])
    assert close(scene.p.intensity.value, [0.8722148, 0.4587285, 0.1813014])


@pytest.mark.parametrize(
    ("spectrum", "message"),
    [
        ({"type": "spectrum", "value": [(400, 1)]}, "two wavelengths or more"),
        ({"type": "spectrum", "value": [(400, 1), (400, 2)]}, "must increase"),
        ({"type": "spectrum", "value": [(400, 1), (500, float("nan"))]}, "not finite"),
        ({"type": "spectrum", "value": [(400, 1, 2), (500, 1, 2)]}, "expected pairs"),
        ({"type": "spectrum"}, "value and filename"),
        ({"type": "irregular", "wavelengths": "400 500", "values": "1 2 3"}, "each with its value"),
        ({"type": "regular", "values": "1 2 3"}, "'wavelength_min' is missing"),
        ({"type": "blackbody", "temperature": -1}, "positive temperature"),
        ({"type": "blackbody", "temprature": 1}, "'temperature'"),
    ],
)
def test_mistakes_are_named(spectrum, message):
    with pytest.raises(ValueError, match=message) as caught:
        reflectance(spectrum)
    assert "reflectance" in str(caught.value)


def test_bad_spectrum_files(tmp_path):
    for text, message in (("400 a", "line 1"), ("400\n", "line 1"), ("# only\n", "no wavelengths")):
        (tmp_path / "a.spd").write_text(text)
        with pytest.raises(ValueError, match=rf"a\.spd.*{message}"):
            reflectance({"type": "spectrum", "filename": str(tmp_path / "a.spd")})
