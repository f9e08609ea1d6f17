"""The tutorials with participating media at a small size: what they find, and going on after they were ended."""

from __future__ import annotations

import inspect

import pytest
import torch
from killed_tutorials import goes_on_after_a_kill, same_checkpoints
from tutorial_pictures import check_pictures

SMOKE = {
    "size": 16,
    "resolution": 24,
    "views_per_step": 4,
    "spp": 8,
    "spp_grad": 4,
    "passes": 1,
    "iterations": 24,
    "target_spp": 64,
    "max_depth": 32,
    "rate": 0.6,
}
SLAB = {
    "size": [4, 16, 16],
    "resolution": 24,
    "spp": 8,
    "spp_grad": 8,
    "passes": 1,
    "iterations": 24,
    "target_spp": 128,
    "max_depth": 128,
}


def test_smoke(tutorial, tmp_path, capsys):
    smoke = tutorial("smoke")
    result = smoke.run(tmp_path / "whole", **SMOKE)
    assert result["end"] > result["start"] + 3
    assert "PSNR of a picture that was not given" in capsys.readouterr().out
    names = ["target", "result", "held_back_target", "held_back_result", "density_target", "density_0010"]
    check_pictures(tmp_path / "whole", [*names, "density_result", "progress", "turntable"])

    import torchrender as tr

    assert tr.io.read_volume(tmp_path / "whole" / "density.vol").shape == (16, 16, 16, 1)
    assert tr.io.read_image(tmp_path / "whole" / "turntable.exr").shape == (48, 8 * 24, 3)

    # It is killed on the way from one grid to the next.
    parts = goes_on_after_a_kill(smoke, tmp_path / "whole", result, SMOKE, capsys, save_every=3, total=24)
    # A checkpoint of other settings is not taken for one of these.
    with pytest.raises(ValueError, match=r"a run with rate 0\.6 \(now 0\.2\); --restart begins anew"):
        smoke.run(parts, **{**SMOKE, "rate": 0.2})


def test_slab(tutorial, tmp_path, capsys, monkeypatch):
    slab = tutorial("slab")
    result = slab.run(tmp_path / "whole", **SLAB)
    assert result["end"] > result["start"] + 1
    assert "PSNR of the picture" in capsys.readouterr().out
    names = ["target", "start", "result", "albedo_target", "albedo_0010", "albedo_result", "progress"]
    check_pictures(tmp_path / "whole", names)

    # Ended, here by an error while a picture is written, it goes on from the checkpoint before.
    save_curves, calls = slab.save_curves, []

    def ends(*arguments) -> None:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        save_curves(*arguments)

    monkeypatch.setattr(slab, "save_curves", ends)
    with pytest.raises(KeyboardInterrupt):
        slab.run(tmp_path / "parts", **SLAB, save_every=8)
    assert slab.run(tmp_path / "parts", **SLAB, save_every=8) == result
    assert "going on from iteration 8 of 24" in capsys.readouterr().out
    last = same_checkpoints(tmp_path / "whole", tmp_path / "parts")
    assert last["iteration"] == 24 and last["raw"].shape == (4, 16, 16, 3)


@pytest.mark.parametrize("name", ["smoke", "slab"])
def test_full_size(tutorial, name, settings_of):
    module = tutorial(name)
    defaults = {key: value.default for key, value in inspect.signature(module.run).parameters.items()}
    seed = {
        "smoke": {"size": 128, "views_per_step": 9, "spp": 64, "spp_grad": 16, "passes": 8, "iterations": 250},
        "slab": {"size": (64, 256, 256), "spp": 16, "spp_grad": 4, "passes": 6, "iterations": 170},
    }[name]
    assert defaults | seed | {"resolution": 128} == defaults
    assert settings_of(name, "--full") == {"restart": False, "iterations": seed["iterations"]}
    found = settings_of(name, "--iterations", "3", "--restart")
    assert found["iterations"] == 3 and found["restart"] is True and found["resolution"] == 64


def test_projections_and_volumes(tutorial):
    volumes = tutorial("volumes")
    density = torch.zeros(4, 4, 4, 1)
    density[3, 0, 1] = 1.0  # in front, below, left of the middle
    picture = volumes.projections(density, 8.0)
    assert picture.shape == (4, 12, 3)
    dark = torch.nonzero(picture[..., 0] < 1)
    # from the front: lowest row, column 1; from the right: what is in front lies left; from above: lowest row, column 1
    assert dark.tolist() == [[3, 1], [3, 4], [3, 9]]
    assert float(picture[3, 1, 0]) == pytest.approx(torch.exp(torch.tensor(-2.0)).item())
