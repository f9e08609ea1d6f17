"""The tutorials at a small size: the parameters come back, and every announced file is written."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
import torch

TUTORIALS = Path(__file__).resolve().parent.parent / "tutorials"


@pytest.fixture
def tutorial(monkeypatch):
    """Imports a tutorial as it is when it is run: with its own folder first on the path."""
    monkeypatch.syspath_prepend(str(TUTORIALS))
    return importlib.import_module


def check_pictures(folder: Path, names: list[str]) -> None:
    for name in names:
        for suffix in ("png", "exr"):
            file = folder / f"{name}.{suffix}"
            assert file.stat().st_size > 100, file
    assert (folder / "loss.png").stat().st_size > 1000


def test_cornell_box(tutorial, tmp_path, capsys):
    errors = tutorial("cornell_box").run(tmp_path, resolution=64, spp=16, iterations=50, target_spp=1024)
    assert set(errors) == {"floor", "ceil", "red", "green", "box"}
    # 64 x 64 pixels hold a sixteenth of the light of the full run, so its noise is four times as large.
    assert max(errors.values()) < 0.03
    assert "largest error of all" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "start", "result", "derivative_red_wall"])


def test_textured_monkey(tutorial, tmp_path, capsys):
    result = tutorial("textured_monkey").run(
        tmp_path,
        texture_size=128,
        resolution=112,
        view_count=8,
        spp=16,
        iterations=80,
        target_spp=128,
    )
    assert 0.3 < result["seen"] < 0.95
    assert result["start"] < 18
    assert result["end"] > 25
    assert "PSNR of the texture where it is seen" in capsys.readouterr().out
    names = ["target", "start", "result", "texture_target", "texture_result", "derivative_red"]
    check_pictures(tmp_path, names)


def test_neural_texture(tutorial, tmp_path, capsys):
    result = tutorial("neural_texture").run(tmp_path, resolution=48, height=32, iterations=80, target_spp=64)
    assert result["start"] < 12
    assert result["end"] > 18
    assert result["new view"] > 25
    assert "PSNR of a picture from a new side" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "result", "texture_target", "texture_result"])


def test_bad_option_ends_before_any_work(tutorial, tmp_path):
    with pytest.raises(SystemExit) as ended:
        tutorial("cornell_box").main(["--iterations", "many", "--output", str(tmp_path / "none")])
    assert ended.value.code == 2
    assert not (tmp_path / "none").exists()


def test_painted_texture_repeats_and_is_a_reflectance(tutorial):
    texture = tutorial("textured_monkey").painted_texture(64)
    assert texture.shape == (64, 64, 3)
    assert float(texture.min()) >= 0.1 and float(texture.max()) <= 0.9
    # Periodic: the step across the border is no larger than the steps within.
    inner = (texture[1:] - texture[:-1]).abs().max()
    assert (texture[0] - texture[-1]).abs().max() <= inner + 1e-6
    assert torch.equal(texture, tutorial("textured_monkey").painted_texture(64))
