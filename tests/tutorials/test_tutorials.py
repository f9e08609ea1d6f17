"""The tutorials at a small size: the parameters come back, and every announced file is written."""

from __future__ import annotations

import csv
import json
import re
import runpy
import sys
from pathlib import Path

import pytest
import torch
from tutorial_pictures import check_pictures

import torchrender as tr

TUTORIALS = Path(__file__).resolve().parents[2] / "tutorials"


COUNTED = sorted(p.stem for p in TUTORIALS.glob("*.py") if '"--iterations"' in p.read_text())


@pytest.mark.parametrize("name", COUNTED)
def test_no_iterations_are_refused_before_any_work(tutorial, name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        tutorial(name).main(["--iterations", "0"])
    assert ended.value.code == 2 and not list(tmp_path.iterdir())
    assert "--iterations: expected a whole number of at least 1, got '0'" in capsys.readouterr().err


def test_cornell_box(tutorial, tmp_path, capsys):
    errors = tutorial("cornell_box").run(tmp_path, resolution=48, spp=16, iterations=50, target_spp=1024)
    assert set(errors) == {"floor", "ceil", "red", "green", "box"}
    # 48 x 48 pixels hold a 28th of the light of the full run, so its noise is five times as large.
    assert max(errors.values()) < 0.03
    assert "largest error of all" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "start", "result", "derivative_red_wall"])


def test_textured_monkey(tutorial, tmp_path, capsys):
    result = tutorial("textured_monkey").run(
        tmp_path,
        texture_size=128,
        resolution=112,
        view_count=8,
        spp=8,
        iterations=40,
        target_spp=64,
    )
    assert 0.3 < result["seen"] < 0.95
    assert result["start"] < 18
    assert result["end"] > 25
    assert "PSNR of the texture where it is seen" in capsys.readouterr().out
    names = ["target", "start", "result", "texture_target", "texture_result", "derivative_red"]
    check_pictures(tmp_path, names)


WATCHED = {"resolution": 48, "spp": 8, "iterations": 200, "target_spp": 512, "picture_every": 100}
SCALARS = {"loss", "learning rate", "ball.bsdf.alpha/value", "lamp.intensity.value/g", "gradient/ball.bsdf.alpha"}


def test_watch_training_without_tensorboard(tutorial, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    errors = tutorial("watch_training").run(tmp_path / "logs", **WATCHED)
    assert set(errors) == set(tutorial("watch_training").UNKNOWN) and max(errors.values()) < 0.1
    assert "TensorBoard is not installed (pip install tensorboard): pictures and" in capsys.readouterr().out
    with (tmp_path / "logs" / "scalars.csv").open() as file:
        rows = list(csv.DictReader(file))
    losses = [float(row["value"]) for row in rows if row["tag"] == "loss"]
    assert len(losses) == 200 and losses[-1] < 0.5 * losses[0] and {row["tag"] for row in rows} >= SCALARS
    pictures = {f"pictures_{name}_{i:04d}.png" for name in ("error", "result_target") for i in (0, 100, 199)}
    assert {path.name for path in (tmp_path / "logs").iterdir()} == {"scalars.csv", *pictures}
    assert tr.io.read_image(tmp_path / "logs" / "pictures_result_target_0199.png").shape == (48, 96, 3)


def test_watch_training_with_tensorboard(tutorial, tmp_path, capsys):
    pytest.importorskip("tensorboard")
    tutorial("watch_training").run(tmp_path, **{**WATCHED, "iterations": 3, "picture_every": 2})
    assert "not installed" not in capsys.readouterr().out
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(tmp_path)).Reload()
    assert set(found.Tags()["scalars"]) >= SCALARS
    assert [event.step for event in found.Scalars("loss")] == [0, 1, 2]
    pictures = found.Images("pictures/result_target")
    assert [p.step for p in pictures] == [0, 2] and (pictures[0].height, pictures[0].width) == (48, 96)


def test_quick_start(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["quick_start.py", "--small"])
    names = runpy.run_path(str(TUTORIALS / "quick_start.py"), run_name="__main__")
    assert names["colour_error"] < 0.03
    # From 0.177; a quarter of the floor hides behind the balls or is smaller than a pixel.
    assert names["texture_error"] < 0.11
    assert names["batch"].shape == (2, 3, 48, 64)
    assert "colour of the ball" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "output" / "quick_start").iterdir()}
    assert written == {"result.exr", "result.png", "target.png", "scene.pt"}


def test_colab(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(TUTORIALS / "colab.py"))
    for name, found in names["found"].items():
        assert found == pytest.approx(names["truth"][name], abs=0.03), name
    assert not list(tmp_path.iterdir()) and "ball.bsdf.reflectance.value" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["quick_start", "colab"])
def test_notebook_is_the_script_and_has_its_pictures(tutorial, name):
    file = TUTORIALS / f"{name}.ipynb"
    assert file.stat().st_size < 500_000
    notebook = json.loads(file.read_text())
    found = [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]
    script = (TUTORIALS / f"{name}.py").read_text()
    assert found == tutorial("make_notebook").cells(script), "make notebook brings the notebook up to date"
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    installs = [cell for cell in code if "".join(cell["source"]).startswith("%pip ")]
    assert len(installs) == (name == "colab") and not any(cell["outputs"] for cell in installs)
    assert all(cell["execution_count"] for cell in code if cell not in installs)
    outputs = [output for cell in code for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert sum("image/jpeg" in output.get("data", {}) for output in outputs) == script.count("\ntr.show(")


def test_script_is_split_at_its_marks(tutorial):
    cells = tutorial("make_notebook").cells
    source = "# %% [markdown]\n# # Title\n#\n# Text\n\n# %%\nx = 1\n# a comment\n\n\n# %%\ny = x\n"
    assert cells(source) == [("markdown", "# Title\n\nText"), ("code", "x = 1\n# a comment"), ("code", "y = x")]
    assert cells("# %%\n# %pip install -q x\n") == [("code", "%pip install -q x")]
    with pytest.raises(ValueError, match="begins with a cell"):
        cells("import torch\n# %%\n")


def test_neural_texture(tutorial, tmp_path, capsys):
    result = tutorial("neural_texture").run(tmp_path, resolution=40, height=24, iterations=40, target_spp=64)
    assert result["start"] < 12
    assert result["end"] > 17
    assert result["new view"] > 25
    assert "PSNR of a picture from a new side" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "result", "texture_target", "texture_result"])


def test_neural_bsdf(tutorial, tmp_path, capsys):
    result = tutorial("neural_bsdf").run(tmp_path, resolution=32, lamps=8, iterations=80, room_spp=32)
    assert result["start"] > 0.8
    assert result["end"] < 0.45
    assert result["room"] < 0.12
    assert result["reciprocity"] < 1e-4
    assert "weights are the material" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "start", "result", "room_target", "room_result"])


def test_camera_calibration(tutorial, tmp_path, capsys):
    errors = tutorial("camera_calibration").run(tmp_path, height=48, steps=(5, 5))
    # From 3.2 degrees, 0.52 units, 4 degrees and 2.1 pixels. The photograph allows 0.05 degrees, 0.005 units, 0.06
    # degrees (standard deviations); the noise of the few samples here is larger.
    assert errors["rotation (deg)"] < 0.5
    assert errors["position"] < 0.05
    assert errors["field of view (deg)"] < 0.5
    assert errors["principal point (px)"] < 0.5
    assert "standard deviations that the photograph allows" in capsys.readouterr().out
    names = ["target", "start", "result", "derivative_turn", "derivative_field_of_view"]
    check_pictures(tmp_path, names)


def test_glass_ball(tutorial, tmp_path, capsys):
    result = tutorial("glass_ball").run(tmp_path, resolution=48, spp=8, iterations=60, target_spp=128)
    assert abs(result["found"] - result["true"]) < 0.01  # from 0.32 away, across the local minima of a sharp picture
    assert "index of refraction: 1.2000 at the start" in capsys.readouterr().out
    check_pictures(tmp_path, ["target", "start", "result", "derivative_eta"])


def test_bad_option_ends_before_any_work(tutorial, tmp_path):
    with pytest.raises(SystemExit) as ended:
        tutorial("cornell_box").main(["--iterations", "many", "--output", str(tmp_path / "none")])
    assert ended.value.code == 2
    assert not (tmp_path / "none").exists()


def test_a_long_run_ends_with_its_folder_or_as_a_wrong_option(tutorial, tmp_path, monkeypatch, capsys):
    module = tutorial("smoke")
    monkeypatch.setattr(module, "run", lambda folder, **settings: None)
    module.main(["--output", str(tmp_path)])
    assert re.fullmatch(rf"pictures are in {re.escape(str(tmp_path))}; \d+\.\d s\n", capsys.readouterr().out)
    told = "is a checkpoint of a run with size 16 (now 64); --restart begins anew"

    def refuse(folder, **settings):
        raise ValueError(told)

    monkeypatch.setattr(module, "run", refuse)
    with pytest.raises(SystemExit) as ended:
        module.main(["--output", str(tmp_path)])
    out, error = capsys.readouterr()
    assert ended.value.code == 2 and out == "" and error.endswith(f"error: {told}\n")


def test_painted_texture_repeats_and_is_a_reflectance(tutorial):
    texture = tutorial("textured_monkey").painted_texture(64)
    assert texture.shape == (64, 64, 3)
    assert float(texture.min()) >= 0.1 and float(texture.max()) <= 0.9
    # Periodic: the step across the border is no larger than the steps within.
    inner = (texture[1:] - texture[:-1]).abs().max()
    assert (texture[0] - texture[-1]).abs().max() <= inner + 1e-6
    assert torch.equal(texture, tutorial("textured_monkey").painted_texture(64))
