"""The tutorials of spectra at a small size: what they find, and every announced file."""

from __future__ import annotations

import pytest
import torch
from tutorial_pictures import drawn

import torchrender as tr


def test_which_glass(tutorial, tmp_path, capsys):
    result = tutorial("which_glass").run(tmp_path, glass="N-SF5", height=4, spp=64, iterations=9)
    assert result["glass"] == "N-SF5" and result["error"] < 0.01
    assert result["index"] == pytest.approx(1.67271, abs=3e-4)
    assert "N-SF5: 1.6727, 32.25" in capsys.readouterr().out
    assert drawn(tmp_path, "rainbows", "loss")
    assert tr.io.read_image(tmp_path / "photograph.exr").shape == (4, 512, 3)


def test_the_bend_leaves_what_the_numbers_mean(tutorial):
    which_glass = tutorial("which_glass")
    straight, bent = (
        which_glass.index_of(torch.tensor([1.6, 1 / 40, bend], dtype=torch.float64)) for bend in (0.0, 1e-3)
    )
    assert float((straight - bent).abs().max()) > 1e-3
    for table in (straight, bent):
        assert float(tr.spectrum.abbe_number(table)) == pytest.approx(40, rel=1e-3)
        assert float(torch.lerp(table[227], table[228], 0.56)) == pytest.approx(1.6, abs=1e-5)


def test_glass_that_reflects_all_light_is_refused(tutorial, tmp_path):
    with pytest.raises(ValueError, match="reflected inside of diamond"):
        tutorial("which_glass").run(tmp_path, glass="diamond")


def test_paint_spectra(tutorial, tmp_path, capsys):
    result = tutorial("paint_spectra").run(tmp_path, spp=32, spp_photograph=1024, iterations=18, smoothness=2e-3)
    assert result["mean"] < 0.8 * result["mean (daylight alone)"] and result["largest"] < 13
    assert result["rms"] < 0.8 * result["rms (daylight alone)"]
    assert (result["pairs found"], result["pairs missed"], result["pairs wrong"]) == (3, 0, 0)
    assert "paints 3 and 21: " in capsys.readouterr().out
    assert drawn(tmp_path, "charts", "reflectances", "loss")
    assert len((tmp_path / "reflectances.csv").read_text().splitlines()) == 352


def test_made_up_paints_are_possible_and_some_look_alike(tutorial):
    paint_spectra = tutorial("paint_spectra")
    truth, light = paint_spectra.paints(), paint_spectra.lamps()
    assert truth.shape == (24, 471) and float(truth.min()) > 0 and float(truth.max()) < 1
    alike, apart = (tr.spectrum.to_rgb(truth, light[name]) for name in ("daylight", "lines"))
    for one, other in ((3, 21), (14, 22), (15, 23)):
        torch.testing.assert_close(alike[one], alike[other], rtol=1e-4, atol=1e-4)
        assert float((apart[one] / apart[other] - 1).abs().max()) > 0.05


def test_sizes(settings_of):
    for name in ("which_glass", "paint_spectra"):
        assert settings_of(name, "--iterations", "3") == {"iterations": 3}
    assert settings_of("which_glass", "--glass", "F2") == {"glass": "F2"}
