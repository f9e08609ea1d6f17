"""Cameras of a COLMAP reconstruction, from its text files.

The format is that of COLMAP's documentation ("Output Format", ``cameras.txt`` and ``images.txt``), its camera models
those of "Camera Models". COLMAP looks along +z with +y down, like OpenCV; pixel centres lie at +0.5, as here.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import torch

from ..errors import nearest
from ..scene.camera import PerspectiveCamera
from ..scene.cameras import FisheyeCamera
from ..transform import on_cpu

# Parameters by model, in the order of the file. "f" is fx and fy, "k" is k1.
MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")
_MAX_SIZE = 1 << 16  # pixels along a side


@dataclass
class _Intrinsics:
    model: str
    width: int
    height: int
    values: dict[str, float]


@on_cpu
def load_colmap(folder: str | os.PathLike[str], **properties: Any) -> dict[str, PerspectiveCamera | FisheyeCamera]:
    """The cameras of a COLMAP reconstruction by the names of their images, in the order of the file.

    ``tr.render(scene, sensor=list(load_colmap("sparse/0").values()))`` renders the views, if they are of one size.

    Args:
        folder: with ``cameras.txt`` and ``images.txt`` (COLMAP's ``model_converter --output_type TXT`` makes them).
            The camera models are SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, which become a
            `PerspectiveCamera`, and OPENCV_FISHEYE, which becomes a `FisheyeCamera`.
        properties: others that the cameras take, such as ``filter="box"`` or ``near_clip``.

    Raises:
        FileNotFoundError: if a file is not there.
        ValueError: naming file and line, for anything that the format does not know.
    """
    folder = Path(folder)
    intrinsics = _read_cameras(folder / "cameras.txt")
    found: dict[str, PerspectiveCamera | FisheyeCamera] = {}
    path = folder / "images.txt"
    for number, text in _images(path):
        at = _Line(path, number)
        words = text.split(None, 9)
        if len(words) != 10:
            at.error(f"expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {_short(text)}")
        at.integer(words[0], "IMAGE_ID")
        w, x, y, z = (at.number(v, n) for v, n in zip(words[1:5], ("QW", "QX", "QY", "QZ"), strict=True))
        t = [at.number(v, n) for v, n in zip(words[5:8], ("TX", "TY", "TZ"), strict=True)]
        camera = intrinsics.get(at.integer(words[8], "CAMERA_ID"))
        if camera is None:
            at.error(f"there is no camera {words[8]} in {folder / 'cameras.txt'}")
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if not abs(length - 1) < 1e-2:
            at.error(f"expected a quaternion of length 1, got one of length {length:.6g}")
        name = words[9].rstrip()
        if name in found:
            at.error(f"a second image {name!r}")
        try:
            found[name] = _camera(camera, _rotation(w / length, x / length, y / length, z / length), t, properties)
        except ValueError as error:
            at.error(f"image {name!r}: {error}")
    return found


def _camera(
    intrinsics: _Intrinsics, R: torch.Tensor, t: list[float], properties: dict[str, Any]
) -> PerspectiveCamera | FisheyeCamera:
    v = intrinsics.values
    fx, fy = (v["f"], v["f"]) if "f" in v else (v["fx"], v["fy"])
    K = [[fx, 0.0, v["cx"]], [0.0, fy, v["cy"]], [0.0, 0.0, 1.0]]
    size = (intrinsics.height, intrinsics.width)
    if intrinsics.model == "OPENCV_FISHEYE":
        return FisheyeCamera.from_opencv(K, R, t, size, [v[n] for n in _FISHEYE], **properties)
    distorted = any(n in v for n in _BROWN)
    distortion = [v.get(n, 0.0) for n in _BROWN] if distorted else None
    return PerspectiveCamera.from_opencv(K, R, t, size, distortion, **properties)


def _rotation(w: float, x: float, y: float, z: float) -> torch.Tensor:
    """World to camera, of a unit quaternion."""
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64).to(torch.get_default_dtype())


def _read_cameras(path: Path) -> dict[int, _Intrinsics]:
    found: dict[int, _Intrinsics] = {}
    for number, text in _lines(path):
        if not text or text.startswith("#"):
            continue
        at, words = _Line(path, number), text.split()
        if len(words) < 4:
            at.error(f"expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got {_short(text)}")
        camera, model = at.integer(words[0], "CAMERA_ID"), words[1]
        if model not in MODELS:
            at.error(f"the camera model {_short(model)} is not supported; {nearest(model, MODELS)}")
        names = MODELS[model]
        if len(words) - 4 != len(names):
            at.error(f"{model} has {len(names)} parameters ({' '.join(names)}), got {len(words) - 4}")
        width, height = at.integer(words[2], "WIDTH"), at.integer(words[3], "HEIGHT")
        if not (0 < width <= _MAX_SIZE and 0 < height <= _MAX_SIZE):
            at.error(f"expected a size from 1 to {_MAX_SIZE} pixels, got {width} x {height}")
        values = {n: at.number(v, n) for n, v in zip(names, words[4:], strict=True)}
        for n in ("f", "fx", "fy"):
            if n in values and not values[n] > 0:
                at.error(f"{n}: expected a positive focal length, got {values[n]:g}")
        if camera in found:
            at.error(f"a second camera {camera}")
        found[camera] = _Intrinsics(model, width, height, values)
    return found


def _images(path: Path) -> Iterator[tuple[int, str]]:
    """The first line of each image; the second, which may be empty, lists points that nothing here asks for."""
    lines = _lines(path)
    for number, text in lines:
        if text and not text.startswith("#"):
            yield number, text
            next(lines, None)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    if not path.is_file():
        raise FileNotFoundError(f"load_colmap: no such file: {path}")
    try:
        with open(path, encoding="utf-8") as file:
            for number, text in enumerate(file, 1):
                yield number, text.strip()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not text; COLMAP's binary files have to be converted") from None


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


@dataclass
class _Line:
    """A place in a file, for messages."""

    path: Path
    number_of_line: int

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{self.path}:{self.number_of_line}: {message}")

    def integer(self, word: str, name: str) -> int:
        if not (word.isascii() and word.isdigit() and len(word) < 19):
            self.error(f"{name}: expected a whole number, got {_short(word)}")
        return int(word)

    def number(self, word: str, name: str) -> float:
        try:
            value = float(word)
        except ValueError:
            self.error(f"{name}: expected a number, got {_short(word)}")
        if not math.isfinite(value):
            self.error(f"{name}: expected a finite number, got {_short(word)}")
        return value
