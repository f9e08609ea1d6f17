"""The tutorial on caustics at a small size: what it finds, the plate it writes, and going on after it was ended."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import torch
from killed_tutorials import checkpoint_in, goes_on_after_a_kill

SMALL = {
    "size": 64,
    "resolution": 32,
    "colour": False,
    "spp": 16,
    "spp_grad": 16,
    "passes": 1,
    "iterations": 40,
    "rate": 1e-3,
    "width_mm": 50.0,
    "verification_spp": 64,
}


def test_caustics(tutorial, tmp_path, capsys):
    import trimesh

    import torchrender as tr

    caustics = tutorial("caustics")
    whole = tmp_path / "whole"
    result = caustics.run(whole, **SMALL)
    losses = checkpoint_in(whole)["curves"]["loss"]
    assert len(losses) == 40 and result["loss"] == losses[-1] < 0.15 * losses[0]
    # the mesh throws the picture, too; the last iteration's own noise is in the other number
    assert result["verification"] < result["loss"] + 0.02
    printed = capsys.readouterr().out
    assert "plate.stl: 50 x 50 x " in printed and "on a screen at 175 mm" in printed and "mesh" in printed
    for name in ("target.png", "progress.exr", "result.png", "heights_0040.png", "loss.png", "lens.exr"):
        assert (whole / name).stat().st_size > 100, name

    # The plate: closed, of its width, of the volume under its front, which is what the pictures of it say.
    heights = tr.io.read_image(whole / "heights.exr")[..., 0]
    assert heights.shape == (64, 64) and 0 < heights.abs().max() <= 0.01001 * 25
    assert heights.max() == pytest.approx(-heights.min().item(), rel=0.1)
    shown = tr.io.read_image(whole / "heights.png", raw=True)[..., 0]
    span = heights.max() - heights.min()
    torch.testing.assert_close(shown * span + heights.min(), heights, rtol=0, atol=span.item() / 60000)
    thickness = 0.087 * 25
    for name in ("plate.stl", "plate.ply"):
        plate = trimesh.load(whole / name)
        assert plate.is_watertight and plate.is_winding_consistent
        np.testing.assert_allclose(plate.bounds[:, :2], [[-25, -25], [25, 25]], atol=1e-4)
        assert plate.bounds[0, 2] == 0 and plate.bounds[1, 2] == pytest.approx(
            thickness + heights.max().item(), abs=1e-2
        )
        assert plate.volume == pytest.approx(2500 * (thickness + heights.mean().item()), rel=1e-4)

    parts = goes_on_after_a_kill(caustics, whole, result, SMALL, capsys, save_every=10, total=40)
    # A checkpoint of other settings is not taken for one of these.
    with pytest.raises(ValueError, match=r"a run with limit 0\.01 \(now 0\.02\); --restart begins anew"):
        caustics.run(parts, **{**SMALL, "limit": 0.02})


def test_schedule(tutorial):
    """That of the tutorial this one follows: 512 heights are 32, 64, 128 and 256 before, from 40, 160, 360 and 640."""
    caustics = tutorial("caustics")
    assert caustics.sizes_of(2048) == [32, 64, 128, 256, 512, 1024, 2048]
    assert caustics.sizes_of(24) == [24] and caustics.sizes_of(72) == [36, 72]
    sizes = caustics.sizes_of(512)
    changes = {n: min(i for i in range(1000) if caustics.size_at(i, 1000, sizes) == n) for n in sizes}
    assert changes == {32: 0, 64: 40, 128: 160, 256: 360, 512: 640}


def test_distance_does_not_know_brightness(tutorial):
    caustics = tutorial("caustics")
    a, b = torch.rand(2, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    assert caustics.distance(3 * a, 0.2 * b).item() == pytest.approx(caustics.distance(a, b).item(), rel=1e-5)
    assert caustics.distance(3 * a, a).item() == pytest.approx(0, abs=1e-10)


def test_sizes(tutorial, settings_of):
    module = tutorial("caustics")
    defaults = {key: value.default for key, value in inspect.signature(module.run).parameters.items()}
    seed = {"size": 2048, "resolution": 128, "colour": True, "spp": 256, "spp_grad": 64, "passes": 10}
    assert defaults | seed | {"iterations": 1500} == defaults
    assert settings_of("caustics", "--full") == {"restart": False, "colour": True, "width_mm": 100.0}
    found = settings_of("caustics", "--size", "512", "--grey", "--width-mm", "60")
    peers = {"size": 512, "spp": 64, "spp_grad": 32, "passes": 1, "iterations": 1000, "colour": False}
    assert found | peers | {"width_mm": 60.0} == found
    found = settings_of("caustics", "--iterations", "3", "--restart")
    assert found["iterations"] == 3 and found["restart"] is True and found["size"] == 128


def test_a_front_that_goes_through_the_back_is_refused(tutorial):
    plates = tutorial("plates")
    front = np.array([[-1, -1, 0], [1, -1, -0.2], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    assert plates.closed(front, faces, 0.3).is_watertight
    with pytest.raises(ValueError, match=r"goes through the back, at -0\.1"):
        plates.closed(front, faces, 0.1)
