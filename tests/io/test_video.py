"""`write_video`: GIF files by Pillow, films by ffmpeg, which is optional."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
from PIL import Image

import torchrender as tr
from torchrender.io import write_video


def moving(count: int = 5, height: int = 12, width: int = 16) -> torch.Tensor:
    """A bright square that moves to the right over a coloured ground."""
    frames = torch.tensor([0.1, 0.3, 0.6]).expand(count, height, width, 3).clone()
    for i in range(count):
        frames[i, 2:8, i : i + 6] = torch.tensor([0.9, 0.2, 0.0])
    return frames


def read_gif(path) -> tuple[list[np.ndarray], list[int]]:
    frames, durations = [], []
    with Image.open(path) as file:
        assert file.info["loop"] == 0
        for i in range(file.n_frames):
            file.seek(i)
            frames.append(np.asarray(file.convert("RGB")))
            durations.append(file.info["duration"])
    return frames, durations


def read_film(path) -> tuple[dict, list[np.ndarray]]:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    reader = ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    return about, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


def difference(found, expected) -> float:
    return float(np.abs(np.asarray(found, float) - np.asarray(expected, float)).mean())


@pytest.mark.parametrize("tonemap", ["srgb", "filmic"])
def test_gif(tmp_path, tonemap):
    frames = moving()
    path = tmp_path / "a.gif"
    write_video(path, frames, fps=12, tonemap=tonemap)
    found, durations = read_gif(path)
    assert durations == [80, 90, 80, 80, 90]  # five twelfths of a second, in hundredths
    for picture, frame in zip(found, frames, strict=True):
        assert difference(picture, np.asarray(tr.show(frame, tonemap=tonemap))) < 1


def test_gif_is_written_without_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    write_video(tmp_path / "a.GIF", (frame[..., :1] for frame in moving(3, 7, 5)), fps=50)
    found, durations = read_gif(tmp_path / "a.GIF")
    assert found[0].shape == (7, 5, 3) and durations == [20, 20, 20]
    with pytest.raises(ImportError, match=r"a.mp4: .mp4 needs ffmpeg, which is not installed .*: pip install imageio"):
        write_video(tmp_path / "a.mp4", moving())
    assert not (tmp_path / "a.mp4").exists()


@pytest.mark.parametrize("ending", ["mp4", "mov", "mkv"])
def test_films(tmp_path, ending):
    pytest.importorskip("imageio_ffmpeg")
    frames = moving(6, 48, 64)
    path = tmp_path / f"a.{ending}"
    write_video(path, frames, fps=30, quality=100)
    about, found = read_film(path)
    assert about["fps"] == 30 and about["codec"] == "h264" and "yuv420p" in about["pix_fmt"]
    assert "tv" in about["pix_fmt"] and "bt709/bt709/iec61966-2-1" in about["pix_fmt"]
    for picture, frame in zip(found, frames, strict=True):
        assert difference(picture, np.asarray(tr.show(frame))) < 3
    small = tmp_path / f"b.{ending}"
    write_video(small, frames, quality=1)
    assert small.stat().st_size < path.stat().st_size


@pytest.mark.parametrize("size", [(13, 17), (12, 17), (13, 16), (1, 1)])
def test_odd_sizes_are_padded(tmp_path, size):
    pytest.importorskip("imageio_ffmpeg")
    frames = moving(2, 13, 17)[:, : size[0], : size[1]]
    write_video(tmp_path / "a.mp4", list(frames), fps=7.5, quality=100)
    about, (first, _) = read_film(tmp_path / "a.mp4")
    height, width = (n + n % 2 for n in size)
    assert first.shape == (height, width, 3) and about["fps"] == 7.5
    expected = np.pad(np.asarray(tr.show(frames[0])), ((0, height - size[0]), (0, width - size[1]), (0, 0)), "edge")
    assert difference(first, expected) < 12  # colours have half the resolution


def test_frames_are_taken_one_by_one(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    alive, most = set(), [0]

    def rendered():
        for i in range(20):
            frame = torch.full((32, 32, 3), i / 20)
            alive.add(i)
            most[0] = max(most[0], len(alive))
            yield frame
            alive.discard(i)

    write_video(tmp_path / "a.mp4", rendered())
    assert most[0] == 1 and len(read_film(tmp_path / "a.mp4")[1]) == 20


def test_raw_values_are_stored_as_they_are(tmp_path):
    write_video(tmp_path / "a.gif", torch.full((2, 4, 4, 1), 0.5), raw=True)
    assert int(read_gif(tmp_path / "a.gif")[0][0].max()) == 128
    broken = torch.tensor([float("nan"), float("inf"), -1.0]).expand(1, 2, 2, 3)
    write_video(tmp_path / "a.gif", broken)
    assert read_gif(tmp_path / "a.gif")[0][0][0, 0].tolist() == [0, 255, 0]


GOOD = torch.zeros(2, 4, 4, 3)
MISTAKES = {
    "ending": ("a.webm", GOOD, {}, ValueError, "unknown video format '.webm'; expected .mp4, .mov, .mkv or .gif"),
    "folder": ("no/a.gif", GOOD, {}, FileNotFoundError, "no such folder"),
    "one image": ("a.gif", GOOD[0], {}, ValueError, r"frames: expected shape \(N, H, W, C\), got \(4, 4, 3\)"),
    "number": ("a.gif", 3, {}, TypeError, "frames: expected a tensor .* or an iterable of images, got 3"),
    "nothing": ("a.gif", [], {}, ValueError, "frames: expected at least one, got none"),
    "sizes": ("a.gif", [GOOD[0], GOOD[0, :3]], {}, ValueError, r"frames\[1\]: expected the shape of the first"),
    "channels": ("a.gif", torch.zeros(1, 4, 4, 4), {}, ValueError, r"frames\[0\]: .* with 1 or 3 channels"),
    "first": ("a.gif", torch.zeros(1, 3, 8, 8), {}, ValueError, r"looks like \(C, H, W\)"),
    "integers": ("a.gif", GOOD.byte(), {}, TypeError, r"frames\[0\]: expected a floating-point tensor"),
    "fps": ("a.gif", GOOD, {"fps": 0}, ValueError, "fps: expected a number above 0, at most 50 for .gif, got 0"),
    "fast gif": ("a.gif", GOOD, {"fps": 60}, ValueError, "fps: .* at most 50"),
    "quality": ("a.gif", GOOD, {"quality": 0}, ValueError, "quality: expected 1 to 100, got 0"),
    "curve": ("a.gif", GOOD, {"tonemap": "aces"}, ValueError, "tonemap: expected 'srgb' or 'filmic'"),
    "raw": ("a.gif", GOOD, {"tonemap": "filmic", "raw": True}, ValueError, "frames without raw=True"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_leave_no_file(tmp_path, name):
    file, frames, options, kind, message = MISTAKES[name]
    with pytest.raises(kind, match=message):
        write_video(tmp_path / file, frames, **options)
    assert not list(tmp_path.iterdir())


def test_a_failure_leaves_no_film(tmp_path):
    pytest.importorskip("imageio_ffmpeg")

    def failing():
        yield from moving(3)
        raise RuntimeError("no light")

    with pytest.raises(RuntimeError, match="no light"):
        write_video(tmp_path / "a.mp4", failing())
    assert not list(tmp_path.iterdir())
