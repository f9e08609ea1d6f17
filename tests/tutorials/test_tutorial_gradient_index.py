"""The tutorials of rays through gradient-index media at a small size: what they find, and going on after an end."""

from __future__ import annotations

import math

import pytest
import torch
from killed_tutorials import checkpoint_in, goes_on_after_a_kill, without_diagrams
from tutorial_pictures import drawn

import torchrender as tr

LUNEBURG = {"levels": 2, "iterations": 32, "rays": 60}
CUBE = {"size": 32, "resolution": 24, "iterations": 32, "smoothness": 0.5, "verification_spp": 64}
SCHLIEREN = {"size": 20, "resolution": 20, "views": 12, "iterations": 4}


def test_luneburg(tutorial, tmp_path, capsys):
    luneburg = tutorial("luneburg")
    result = luneburg.run(tmp_path / "whole", **LUNEBURG, save_every=32)  # drawing takes as long as ten iterations
    # light that is not bent comes out 0.8 from the antipodes, in the square mean
    assert result["spot"] < 0.15 and result["spot from other sides"] < 0.15 and result["index"] < 0.05
    assert "spots: " in capsys.readouterr().out
    assert drawn(tmp_path / "whole", "loss", "progress", "result")
    assert tr.io.read_volume(tmp_path / "whole" / "index.vol").shape == (17, 17, 17, 1)
    parts = goes_on_after_a_kill(luneburg, tmp_path / "whole", result, LUNEBURG, capsys, save_every=16, total=64)
    with pytest.raises(ValueError, match=r"a run with rays 60 \(now 61\); --restart begins anew"):
        luneburg.run(parts, **{**LUNEBURG, "rays": 61})


def test_grin_cube(tutorial, tmp_path, capsys):
    cube = tutorial("grin_cube")
    result = cube.run(tmp_path / "whole", **CUBE)
    curves = checkpoint_in(tmp_path / "whole")["curves"]
    # about 2 of an even light
    assert min(c[0] for c in curves.values()) > 1.5 and max(result.values()) < 0.15
    assert "distance from the targets with 64 samples a pixel: sun" in capsys.readouterr().out
    assert drawn(tmp_path / "whole", "loss", "index")
    assert tr.io.read_volume(tmp_path / "whole" / "index.vol").shape == (32, 32, 32, 1)
    assert tr.io.read_image(tmp_path / "whole" / "result.exr").shape == (24, 48, 3)
    goes_on_after_a_kill(cube, tmp_path / "whole", result, CUBE, capsys, save_every=10, total=32)


def test_pictures_of_a_cube_have_equal_light_and_no_rim(tutorial):
    cube = tutorial("grin_cube")
    for inside in (cube.sun, cube.moon):
        picture = cube.draw(inside, 48)
        assert picture.shape == (48, 48, 1) and float(picture.mean()) == pytest.approx(1, abs=1e-5)
        edge = torch.cat([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
        assert torch.allclose(edge, torch.tensor(cube.FLOOR)) and float(picture.max()) > 3
    assert cube.sizes_of(160, cube.COARSEST) == [20, 40, 80, 160] and cube.sizes_of(33, cube.COARSEST) == [33]


def test_the_true_lens_has_sharp_spots(tutorial):
    """What `luneburg.errors` measures is 0 for n^2 = 2 - r^2, but for the voxels beyond the ball, where it ends."""
    luneburg, shared = tutorial("luneburg"), tutorial("bent_rays")
    x, y, z = shared.coordinates(48, luneburg.HALF)
    index = tr.gradientindex.fit(torch.sqrt((2 - x * x - y * y - z * z).clamp(min=0.3)))
    scene = {"type": "gradientindex", "index": index, "to_world": shared.cube(luneburg.HALF), "step": 0.5}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": scene}
    found = luneburg.errors(tr.load_dict({"type": "scene", "ball": ball}), index, 100)
    assert found["spot"] < 2e-3 and found["spot from other sides"] < 2e-3 and found["largest of index"] < 2e-4


def test_drawn_ways_end_where_traced_rays_do(tutorial):
    shared = tutorial("bent_rays")
    index = 1.3 + 0.1 * torch.randn(8, 8, 8, generator=torch.Generator().manual_seed(0)).clamp(-2, 2)
    medium = {"type": "gradientindex", "index": index, "to_world": shared.cube(), "step": 0.1}
    scene = tr.load_dict({"type": "scene", "cube": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}})
    start = torch.tensor([[0.1, 0.2, -1.0], [-0.3, 0.4, -1.0]])
    ahead = torch.tensor([[0.0, 0.0, 1.0]]).expand(2, 3)
    end = tr.gradientindex.trace(scene, "cube", start - ahead, ahead)
    lines = shared.paths(index, 1.0, start, ahead, lambda p: p.abs().amax(1) <= 1, 0.002)
    last = [next(p for p in (line[i] for line in lines) if p[2] > 1) for i in range(2)]
    assert (torch.stack(last) - end.position).norm(dim=1).max() < 0.01
    assert (end.position[:, :2] - start[:, :2]).norm(dim=1).min() > 0.03  # they are bent


def test_grin_lens(tutorial, tmp_path, capsys):
    settings = {"voxels": 17, "rings": 24, "sectors": 96, "rays": 100}
    result = tutorial("grin_lens").run(tmp_path, **settings)
    assert result["start"] > 2 * result["plain glass"] > 10 * result["varying index"] > 0
    assert "times sharper than plain glass" in capsys.readouterr().out
    assert drawn(tmp_path, "loss", "spots", "lens")
    assert tr.io.read_volume(tmp_path / "index.vol").shape == (17, 17, 17, 1)


def test_the_mesh_of_a_lens_is_closed_and_its_normals_are_those_of_spheres(tutorial):
    mesh = tutorial("grin_lens").Mesh(8, 24)
    vertices, normals = mesh(torch.tensor(0.4), torch.tensor(-0.3))
    corner = vertices[mesh.faces].double()
    area = torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = float((area * corner[:, 0]).sum()) / 6
    # of the cylinder between the middles of the faces, less about half of what lies before their rims
    assert volume == pytest.approx(math.pi * (0.6 - 0.4 / 4 - 0.3 / 4), rel=0.03)
    mean = normals[mesh.faces].double().mean(1)
    assert bool(((area * mean).sum(1) > 0).all())  # outwards, all of them
    count = len(mesh.turn) * 8 + 1
    middle = torch.tensor([0, 0, -0.3 + 1 / 0.4])
    assert torch.allclose(vertices[:count] + normals[:count] * -(1 / 0.4), middle.expand(count, 3), atol=1e-5)


def test_schlieren(tutorial, tmp_path, capsys, monkeypatch):
    schlieren = tutorial("schlieren")
    result = schlieren.run(tmp_path / "whole", **SCHLIEREN)
    assert result["error"] < 0.15 and 0.7 < result["residual"] < 3
    assert "relative error of the index" in capsys.readouterr().out
    assert drawn(tmp_path / "whole", "loss", "result")
    index = tr.io.read_volume(tmp_path / "whole" / "index.vol")[..., 0]
    assert index.shape == (20, 20, 20) and bool((index[:2] == index[0, 0, 0]).all())
    assert float(index[0, 0, 0]) == pytest.approx(1.00027) and float(index.min()) < 1.0002

    # Ended, here by an error while a picture is drawn, it goes on from the checkpoint before.
    save_curves, calls = schlieren.save_curves, []

    def ends(*arguments) -> None:
        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        save_curves(*arguments)

    monkeypatch.setattr(schlieren, "save_curves", ends)
    with without_diagrams():
        with pytest.raises(KeyboardInterrupt):
            schlieren.run(tmp_path / "parts", **SCHLIEREN)
        assert schlieren.run(tmp_path / "parts", **SCHLIEREN) == result
    assert "going on from iteration 2 of 4" in capsys.readouterr().out
    one, two = (checkpoint_in(tmp_path / name) for name in ("whole", "parts"))
    assert torch.equal(one["unknown"], two["unknown"]) and one["curves"] == two["curves"]


def test_a_plume_is_cold_at_its_border(tutorial):
    plume = tutorial("schlieren").plume(40)
    assert float(plume[2:-2, 2:-2, 2:-2].min()) < -0.5 and float(plume.max()) <= 0
    outer = plume.clone()
    outer[2:-2, 2:-2, 2:-2] = 0
    assert float(outer.abs().max()) < 0.01 and math.isfinite(float(plume.sum()))


def test_mirage(tutorial, tmp_path, capsys):
    result = tutorial("mirage").run(tmp_path, resolution=48, spp=2, iterations=16)
    assert result["end"] < 0.6 * result["start"] < 3
    assert "temperature between 0 and 0.5 m" in capsys.readouterr().out
    assert drawn(tmp_path, "loss", "temperature")
    photograph, counted = (tr.io.read_image(tmp_path / f"{name}.exr") for name in ("photograph", "what counts"))
    part = float((counted == photograph).all(-1).float().mean())
    assert 0.6 < part < 0.95 and counted.shape == (48, 72, 3)


def test_sizes(settings_of):
    three = ("--iterations", "3")
    assert settings_of("luneburg", *three) == {"restart": False, "iterations": 3}
    assert settings_of("grin_lens", *three) == {"iterations": 3}
    small = {"restart": False, "iterations": 3}
    assert settings_of("schlieren", *three) == {**small, "size": 32, "resolution": 48}
    assert settings_of("grin_cube", *three) == {**small, "size": 40, "resolution": 64, "cubic": False}
    assert settings_of("mirage", *three) == {"iterations": 3, "large": False}
    assert settings_of("schlieren", "--full") == {"restart": False}
    assert settings_of("grin_cube", "--full", "--cubic") == {"restart": False, "cubic": True}
