"""The scene of the caustics: its plate is closed, its light and camera face each other, its pictures are drawn."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

SCENES = Path(__file__).resolve().parents[2] / "scenes"


@pytest.fixture
def make_caustics(monkeypatch):
    monkeypatch.syspath_prepend(str(SCENES))
    import make_caustics

    yield make_caustics
    sys.modules.pop("make_caustics")


def corners(matrix) -> np.ndarray:
    """The four corners of a rectangle, counterclockwise around its normal."""
    square = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]], float)
    return (square @ np.asarray(matrix, float).T)[:, :3]


def test_the_plate_is_closed_and_faces_outwards(make_caustics):
    """By the divergence theorem: the flux of the position through a closed surface is three times its volume."""
    scene = make_caustics.caustics(np.zeros((4, 4)))
    faces = [scene[name]["to_world"] for name in ("lens", "back", "right", "left", "near", "far")]
    directed: dict = {}
    volume = 0.0
    for matrix in faces:
        points = corners(matrix)
        volume += sum(np.linalg.det([points[0], points[i], points[i + 1]]) / 6 for i in (1, 2))
        for i in range(4):
            edge = tuple(map(tuple, np.round(points[[i - 1, i]], 9).tolist()))
            directed[edge] = directed.get(edge, 0) + 1
    assert volume == pytest.approx(4 * make_caustics.THICKNESS)
    assert len(directed) == 24 and all(directed.get((b, a)) == 1 for a, b in directed)
    assert np.allclose(corners(faces[0])[:, 1], 0)  # heights are measured from y = 0, towards the screen


def test_lamp_lens_screen_and_camera_are_one_above_the_other(make_caustics):
    scene = make_caustics.caustics(np.zeros((4, 4)), colour=False, resolution=32, spp=8)
    normal = {name: np.asarray(scene[name]["to_world"])[:3, 2] for name in ("lamp", "lens", "screen")}
    assert [normal[name][1] for name in ("lamp", "lens", "screen")] == [-1, -1, 5]
    height = {name: scene[name]["to_world"][1][3] for name in ("lamp", "lens", "screen")}
    assert height == {"lamp": 5, "lens": 0, "screen": -7}
    camera = np.asarray(scene["sensor"]["to_world"])
    assert camera[:3, 3].tolist() == [0, -4.65, 0] and camera[:3, 2].tolist() == [0, -1, 0]
    assert camera[:3, 1].tolist() == [0, 0, 1] and np.linalg.det(camera) == pytest.approx(1)
    assert scene["sensor"]["film"]["width"] == 32 and scene["sensor"]["sampler"]["sample_count"] == 8
    assert scene["lamp"]["emitter"]["radiance"] == {"type": "rgb", "value": [0.8, 0.8, 0.8]}
    other = {"type": "sphere"}
    assert make_caustics.caustics(other)["lens"] is other


def test_the_light_has_three_colours_side_by_side(make_caustics):
    texels = make_caustics.bayer()
    assert texels.shape == (32, 32, 3) and texels.dtype == np.float32
    assert (texels.max(-1) > 0).mean() == 0.75 and ((texels > 0).sum(-1) <= 1).all()
    assert texels[0, 0].tolist() == pytest.approx([0, 0, 2.2]) and texels[0, 1].tolist() == pytest.approx([0, 2.2, 0])
    assert texels[1, 1].tolist() == pytest.approx([2.2, 0, 0]) and texels[1, 0].tolist() == [0, 0, 0]
    assert texels.mean((0, 1)) == pytest.approx([0.55] * 3, rel=1e-5)


@pytest.mark.parametrize("colour", [True, False])
def test_pictures(make_caustics, colour):
    picture = make_caustics.target(64, colour=colour)
    assert picture.shape == (64, 64, 3) and picture.dtype == np.float32
    assert picture.min() >= 0 and 0.8 < picture.max() <= 1
    assert (np.ptp(picture, axis=-1).max() > 0.3) is np.bool_(colour)
    # both dark and bright, with edges: neighbours that differ by a third of the whole range
    assert picture.min() < 0.15 and np.abs(np.diff(picture.mean(-1))).max() > 0.33
    # sizes are samples of one picture: halving 64 pixels a side gives what 32 give
    halved = picture.reshape(32, 2, 32, 2, 3).mean((1, 3))
    assert np.abs(halved - make_caustics.target(32, colour=colour)).mean() < 0.01


def test_the_script_draws_them(make_caustics, tmp_path):
    import torchrender as tr

    make_caustics.main(tmp_path / "pictures", 64)
    for name, colour in (("balloon", True), ("nautilus", False)):
        read = tr.io.read_image(tmp_path / "pictures" / f"{name}.png").numpy()
        assert np.abs(read - make_caustics.target(64, colour=colour)).max() < 0.006
