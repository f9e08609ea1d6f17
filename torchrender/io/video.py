"""``write_video``: sequences of linear images as films, by ffmpeg, or as animated GIF files, by Pillow."""

from __future__ import annotations

import importlib
import itertools
import os
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch

from ..errors import describe
from ..image import TonemapName, check_tonemap
from ..transform import single
from ._files import writable_file
from .image import advice, as_pixels, display_values

FILMS = (".mp4", ".mov", ".mkv")
# H.264 with colours at half the resolution, which all players have. Without tags they would guess how colours were
# encoded: by BT.709, and the curve is that of sRGB.
_FILTER = (
    "scale=out_color_matrix=bt709:out_range=tv,"
    "setparams=colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1:range=tv"
)


def library(path: Path) -> ModuleType:
    """The module that brings ffmpeg; ImportError says how it is installed."""
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ImportError(
            f"write_video: {path.name}: {path.suffix} needs ffmpeg, which is not installed ({error}): pip install "
            "imageio-ffmpeg; .gif needs nothing"
        ) from error


def writable_video(path: str | os.PathLike[str]) -> Path:
    """The path, if a video can be written there: its ending is known, and so is what writes it."""
    path = writable_file(path)
    ending = path.suffix.lower()
    if ending not in (*FILMS, ".gif"):
        raise ValueError(f"{path}: unknown video format {ending!r}; expected {', '.join(FILMS)} or .gif")
    if ending != ".gif":
        library(path)
    return path


def write_video(
    path: str | os.PathLike[str],
    frames: torch.Tensor | np.ndarray | Iterable[torch.Tensor | np.ndarray],
    *,
    fps: float = 24.0,
    raw: bool = False,
    quality: int = 70,
    tonemap: TonemapName = "srgb",
) -> None:
    """Write linear images of one size, one after the other, as a video; the ending of the name says in which format.

    Args:
        path: ``.mp4``, ``.mov`` or ``.mkv`` (H.264, by ``pip install imageio-ffmpeg``) or ``.gif`` (256 colours a
            frame, repeated for ever), in an existing folder.
        frames: (N, H, W, C), or an iterable of images (H, W, C) or (H, W), floating point, top row first; C is 1 or 3.
            Of an iterable, such as a generator that renders, films need one frame at a time. Where H or W is odd, the
            last row or column is repeated in films, whose sizes have to be even.
        fps: frames a second; up to 50 in a GIF file, which counts hundredths of seconds.
        raw: take the values as they are, without a curve. They are clipped to [0, 1] in any case.
        quality: of films, 1 to 100: libx264's ``crf`` is ``51 (1 - quality / 100)``.
        tonemap: ``"srgb"`` or ``"filmic"``, as of `write_image`. Not with `raw`.

    Raises:
        FileNotFoundError: if there is no such folder.
        ImportError: if ffmpeg is needed and not installed.
        TypeError, ValueError: if the frames or the format are not as above. What was written until then is removed.
    """
    path = writable_video(path)
    check_tonemap("tonemap", tonemap)
    if raw and tonemap != "srgb":
        raise ValueError(f"tonemap: {tonemap!r} is for frames without raw=True")
    gif = path.suffix.lower() == ".gif"
    fps, quality = single(fps), single(quality)
    if isinstance(fps, bool) or not isinstance(fps, (int, float)) or not 0 < fps <= (50 if gif else 1000):
        raise ValueError(
            f"fps: expected a number above 0, at most {50 if gif else 1000} for {path.suffix}, got {fps!r}"
        )
    if isinstance(quality, bool) or not isinstance(quality, int) or not 1 <= quality <= 100:
        raise ValueError(f"quality: expected 1 to 100, got {quality!r}")
    pictures = _pictures(frames, None if raw else tonemap)
    first = next(pictures, None)
    if first is None:
        raise ValueError("frames: expected at least one, got none")
    pictures = itertools.chain([first], pictures)
    try:
        if gif:
            _write_gif(path, pictures, float(fps))
        else:
            _write_film(path, pictures, first.shape, float(fps), quality)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _pictures(frames: Any, curve: TonemapName | None) -> Iterator[np.ndarray]:
    """Frames as uint8 (H, W, 3), checked one by one."""
    if isinstance(frames, (torch.Tensor, np.ndarray)) and frames.ndim != 4:
        raise ValueError(f"frames: expected shape (N, H, W, C), got {tuple(frames.shape)}")
    if not isinstance(frames, Iterable):
        raise TypeError(f"frames: expected a tensor (N, H, W, C) or an iterable of images, got {describe(frames)}")
    size: tuple[int, ...] | None = None
    for number, frame in enumerate(frames):
        pixels = as_pixels(f"frames[{number}]", frame)
        if pixels.shape[-1] not in (1, 3):
            raise ValueError(
                f"frames[{number}]: expected shape (H, W, C) with 1 or 3 channels, got {pixels.shape}{advice(pixels)}"
            )
        size = size or pixels.shape
        if pixels.shape != size:
            raise ValueError(f"frames[{number}]: expected the shape of the first, {size}, got {pixels.shape}")
        stored = (display_values(pixels, curve) * 255 + 0.5).floor().numpy().astype(np.uint8)
        yield np.ascontiguousarray(np.broadcast_to(stored, (*stored.shape[:2], 3)))


def _write_film(path: Path, pictures: Iterable[np.ndarray], shape: tuple[int, ...], fps: float, quality: int) -> None:
    height, width = shape[:2]
    even = ((0, height % 2), (0, width % 2), (0, 0))
    writer: Any = library(path).write_frames(
        os.fspath(path),
        (width + width % 2, height + height % 2),
        fps=fps,
        codec="libx264",
        quality=None,
        macro_block_size=1,
        output_params=["-crf", str(round(51 * (1 - quality / 100))), "-vf", _FILTER],
    )
    with closing(writer):
        writer.send(None)
        for picture in pictures:
            writer.send(np.pad(picture, even, mode="edge"))


def _write_gif(path: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    from PIL import Image

    images = [Image.fromarray(picture).quantize(256) for picture in pictures]  # each with a palette of its own
    ends = [round(100 * i / fps) for i in range(len(images) + 1)]  # hundredths of seconds
    durations = [10 * (b - a) for a, b in itertools.pairwise(ends)]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0)
