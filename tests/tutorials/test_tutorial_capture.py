"""The tutorials that measure light and materials in photographs, and the gallery, at a small size."""

from __future__ import annotations

import sys

import pytest
import torch
from tutorial_pictures import check_pictures


def test_environment_map(tutorial, tmp_path, capsys):
    result = tutorial("environment_map").run(
        tmp_path, size=32, width=48, spp=16, iterations=60, target_spp=512, rate=0.15
    )
    assert result["map, start"] > 0.7 and result["relit, start"] > 0.25
    assert result["map, end"] < 0.42  # most of that is the sun, which the metal blurs
    assert result["relit, end"] < 0.07
    assert "error of a picture of another object in its light" in capsys.readouterr().out
    check_pictures(
        tmp_path, ["target_front", "result_front", "map_target", "map_result", "relit_target", "relit_result"]
    )


def test_roughness_of_a_map(tutorial):
    """Of exp(2 a) with a linear in an angle it is the mean of |grad e^a|^2, which has closed forms."""
    roughness = tutorial("environment_map").roughness_of
    assert roughness(torch.full((16, 32, 3), 2.0)) == 0
    rows, columns = 128, 256
    down = torch.linspace(0, torch.pi, rows)[:, None, None]
    # the root is 2 + cos(theta): the mean of sin(theta)^2 over the sphere is 2 / 3
    sky = (2 + torch.cos(down)).square().expand(rows, columns, 3)
    assert float(roughness(sky)) == pytest.approx(2 / 3, rel=1e-3)
    # The root is 2 + sin(theta) cos(phi), the x of a direction: of its gradient on the sphere the mean square is 2 / 3.
    around = ((torch.arange(columns) + 0.5) / columns * 2 * torch.pi)[None, :, None]
    sky = (2 + torch.sin(down) * torch.cos(around)).square().expand(rows, columns, 3)
    assert float(roughness(sky)) == pytest.approx(2 / 3, rel=1e-2)


def test_room(tutorial, tmp_path, capsys):
    result = tutorial("room").run(tmp_path, resolution=32, spp=16, iterations=100, target_spp=512)
    assert result["albedo, start"] > 0.35 and result["radiance, start"] > 0.9
    assert result["albedo, end"] < 0.03
    assert result["radiance, end"] < 0.015
    assert "largest error of an albedo" in capsys.readouterr().out
    check_pictures(tmp_path, ["target0", "target3", "start", "result"])


def test_svbrdf(tutorial, tmp_path, capsys):
    result = tutorial("svbrdf").run(tmp_path, size=32, resolution=32, lamp_count=16, iterations=120, target_spp=16)
    assert result["diffuse, start"] < 17 and result["specular, start"] < 15
    assert result["diffuse, end"] > 27
    assert result["specular, end"] > 19
    assert result["roughness, end"] > 29
    assert result["normals, start"] < 27 and result["normals, end"] > 31
    assert result["new picture, start"] < 19 and result["new picture, end"] > 24
    assert "PSNR,  new picture" in capsys.readouterr().out
    names = [
        "target_first",
        "target_new",
        "result_new",
        "diffuse_target",
        "roughness_result",
        "specular_result",
        "normals_result",
    ]
    check_pictures(tmp_path, names)


@pytest.fixture
def gallery(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    from scenes import gallery

    return gallery


def test_gallery(gallery, tmp_path, capsys):
    gallery.main(["--size", "16", "--spp", "2", "--columns", "5", "--output", str(tmp_path)])
    assert f"{len(gallery.GALLERY)} pictures and the sheet" in capsys.readouterr().out
    written = {path.name for path in tmp_path.iterdir()}
    names = [picture.name for picture in gallery.GALLERY]
    assert len(set(names)) == len(names) > 12  # no two of one name
    assert written == {f"{name}.png" for name in names} | {"gallery.png"}
    from PIL import Image

    pictures = {
        name: torch.tensor(list(Image.open(tmp_path / f"{name}.png").convert("RGB").tobytes())) for name in names
    }
    for name, pixels in pictures.items():
        assert len(pixels) == 16 * 16 * 3
        assert 10 < pixels.double().mean() < 250 and pixels.double().std() > 8, name
    assert len({tuple(pixels.tolist()) for pixels in pictures.values()}) == len(names)
    width, height = Image.open(tmp_path / "gallery.png").size
    assert width == 5 * (16 + 2) + 2 and height == -(-len(names) // 5) * (16 + 12 + 2) + 2


def test_gallery_of_a_part(gallery, tmp_path, capsys):
    assert gallery.run(tmp_path, size=8, spp=1, only="PLASTIC") == ["plastic", "roughplastic"]
    with pytest.raises(SystemExit):
        gallery.main(["--only", "velvet", "--output", str(tmp_path)])
    assert "no caption contains 'velvet'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        gallery.main(["--spp", "0", "--output", str(tmp_path)])
