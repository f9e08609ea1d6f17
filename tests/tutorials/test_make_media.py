"""The volumes of the scenes with media: their ranges, and that the committed files are what the script writes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import torchrender as tr

SCENES = Path(__file__).resolve().parents[2] / "scenes"


@pytest.fixture
def make_media(monkeypatch):
    monkeypatch.syspath_prepend(str(SCENES))
    import make_media

    yield make_media
    sys.modules.pop("make_media")


def test_committed_files_are_what_the_script_writes(make_media, tmp_path, monkeypatch):
    monkeypatch.setattr(make_media, "HERE", tmp_path)
    make_media.main()
    files = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    assert files == {Path("smoke.xml"), *(path.relative_to(SCENES) for path in (SCENES / "volumes").iterdir())}
    assert (tmp_path / "smoke.xml").read_text() == (SCENES / "smoke.xml").read_text()
    for path in (SCENES / "volumes").iterdir():
        stored, written = (
            tr.io.read_volume(folder / path.name) for folder in (SCENES / "volumes", tmp_path / "volumes")
        )
        # sines differ in the last digit between machines
        np.testing.assert_allclose(written.numpy(), stored.numpy(), rtol=0, atol=1e-4)
        assert path.stat().st_size < 400_000


@pytest.mark.parametrize("size", [16, 40])
def test_densities_are_empty_at_the_border_and_thin_and_dense_within(make_media, size):
    for density in (make_media.smoke(size), make_media.cloud(size)):
        assert density.shape == (size, size, size, 1) and density.dtype == np.float32
        assert density.min() == 0 and 0.9 < density.max() <= 1
        border = np.ones(density.shape, bool)
        border[1:-1, 1:-1, 1:-1] = False
        assert density[border].max() < 0.05
        assert 0.5 < (density == 0).mean() < 0.95
        assert ((density > 0) & (density < 0.5)).mean() > 0.02 and (density >= 0.5).mean() > 0.02


def test_sizes_are_samples_of_one_function(make_media):
    """Halving 80 voxels a side gives what 40 give, but for what is finer."""
    for make in (make_media.smoke, make_media.cloud):
        fine, coarse = make(80), make(40)
        halved = fine.reshape(40, 2, 40, 2, 40, 2).mean((1, 3, 5))[..., None]
        assert np.sqrt(np.square(halved - coarse).mean()) < 0.25 * coarse.std()


def test_the_picture_is_in_the_front_of_the_slab(make_media):
    albedo = make_media.slab_albedo(3, 20, 30)
    assert albedo.shape == (3, 20, 30, 3) and albedo.dtype == np.float32
    assert albedo.min() >= np.float32(0.7) and albedo.max() <= np.float32(0.99)
    picture = make_media.picture(20, 30)
    np.testing.assert_allclose((albedo[2, ::-1] - 0.7) / 0.29, picture, atol=1e-5)
    assert picture[:6, :, 2].mean() > 0.5  # sky above
    assert picture[5:8, 16:20, 0].mean() > 0.9  # the sun, on the right


def test_cameras_of_the_smoke(make_media):
    assert make_media.camera_position(0, 0, 2) == pytest.approx((0, 0, 2))
    assert make_media.camera_position(90, 0, 2) == pytest.approx((2, 0, 0))
    assert make_media.camera_position(180, 30, 2) == pytest.approx((0, 1, -(3**0.5)))
