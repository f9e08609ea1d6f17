"""Cameras of a COLMAP reconstruction, from its text or binary files.

The format is that of COLMAP's documentation ("Output Format", ``cameras`` and ``images``), its camera models those of
"Camera Models". COLMAP looks along +z with +y down, like OpenCV; pixel centres lie at +0.5, as here. Its own library
pycolmap brings the whole of COLMAP, a native program, for two tables of numbers; trimesh reads none of them.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import torch

from ..errors import nearest
from ..scene.camera import PerspectiveCamera
from ..scene.cameras import FisheyeCamera
from ..transform import on_cpu

# Parameters by model, in the order of the file; "f" is fx and fy. In binary files a model is its number in this order.
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
_OTHERS = ("FOV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE")  # the numbers after those
_MAX_SIZE = 1 << 16  # pixels along a side
_MAX_NAME = 1 << 12  # bytes of an image's name


@dataclass
class _Place:
    """A place in a file, for messages."""

    where: str

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{self.where}: {message}")

    def integer(self, word: str, name: str) -> int:
        if not (word.isascii() and word.isdigit() and len(word) < 19):
            self.error(f"{name}: expected a whole number, got {_short(word)}")
        return int(word)

    def number(self, word: str | float, name: str) -> float:
        try:
            value = float(word)
        except ValueError:
            self.error(f"{name}: expected a number, got {_short(str(word))}")
        if not math.isfinite(value):
            self.error(f"{name}: expected a finite number, got {_short(str(word))}")
        return value


@dataclass
class _Intrinsics:
    at: _Place
    id: int
    model: str
    width: int
    height: int
    values: dict[str, float]


@dataclass
class _Image:
    at: _Place
    pose: Sequence[str | float]  # quaternion w x y z, world to camera, and translation
    camera: int
    name: str


@on_cpu
def load_colmap(folder: str | os.PathLike[str], **properties: Any) -> dict[str, PerspectiveCamera | FisheyeCamera]:
    """The cameras of a COLMAP reconstruction by the names of their images, in the order of the file.

    ``tr.render(scene, sensor=list(load_colmap("sparse/0").values()))`` renders the views, if they are of one size.

    Args:
        folder: with ``cameras.bin`` and ``images.bin``, or else ``cameras.txt`` and ``images.txt``. The camera models
            are SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, which become a `PerspectiveCamera`,
            and OPENCV_FISHEYE, which becomes a `FisheyeCamera`.
        properties: others that the cameras take, such as ``filter="box"`` or ``near_clip``.

    Raises:
        FileNotFoundError: if a file is not there.
        ValueError: naming the file and the place in it, for anything that the format does not know.
    """
    folder = Path(folder)
    binary = all((folder / name).is_file() for name in ("cameras.bin", "images.bin"))
    suffix, read_cameras, read_images = (
        ("bin", _binary_cameras, _binary_images) if binary else ("txt", _text_cameras, _text_images)
    )
    intrinsics: dict[int, _Intrinsics] = {}
    path = folder / f"cameras.{suffix}"
    for camera in read_cameras(path):
        _check(camera)
        if camera.id in intrinsics:
            camera.at.error(f"a second camera {camera.id}")
        intrinsics[camera.id] = camera
    found: dict[str, PerspectiveCamera | FisheyeCamera] = {}
    for image in read_images(folder / f"images.{suffix}"):
        at = image.at
        if image.camera not in intrinsics:
            at.error(f"there is no camera {image.camera} in {path}")
        *quaternion, x, y, z = (
            at.number(v, n) for v, n in zip(image.pose, ("QW", "QX", "QY", "QZ", "TX", "TY", "TZ"), strict=True)
        )
        length = math.hypot(*quaternion)
        if not abs(length - 1) < 1e-2:
            at.error(f"expected a quaternion of length 1, got one of length {length:.6g}")
        if image.name in found:
            at.error(f"a second image {image.name!r}")
        rotation = _rotation(*(q / length for q in quaternion))
        try:
            found[image.name] = _camera(intrinsics[image.camera], rotation, [x, y, z], properties)
        except ValueError as error:
            at.error(f"image {image.name!r}, camera {image.camera} of {path}: {error}")
    return found


def _check(camera: _Intrinsics) -> None:
    at = camera.at
    if not (0 < camera.width <= _MAX_SIZE and 0 < camera.height <= _MAX_SIZE):
        at.error(f"expected a size from 1 to {_MAX_SIZE} pixels, got {camera.width} x {camera.height}")
    for name, value in camera.values.items():
        at.number(value, name)
        if name in ("f", "fx", "fy") and not value > 0:
            at.error(f"{name}: expected a positive focal length, got {value:g}")


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


# ------------------------------------------------------------------------------------------------------- text files
def _text_cameras(path: Path) -> Iterator[_Intrinsics]:
    for number, text in _lines(path):
        if not text or text.startswith("#"):
            continue
        at, words = _Place(f"{path}:{number}"), text.split()
        if len(words) < 4:
            at.error(f"expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got {_short(text)}")
        camera, model = at.integer(words[0], "CAMERA_ID"), words[1]
        if model not in MODELS:
            at.error(f"the camera model {_short(model)} is not supported; {nearest(model, MODELS)}")
        names = MODELS[model]
        if len(words) - 4 != len(names):
            at.error(f"{model} has {len(names)} parameters ({' '.join(names)}), got {len(words) - 4}")
        width, height = at.integer(words[2], "WIDTH"), at.integer(words[3], "HEIGHT")
        values = {n: at.number(v, n) for n, v in zip(names, words[4:], strict=True)}
        yield _Intrinsics(at, camera, model, width, height, values)


def _text_images(path: Path) -> Iterator[_Image]:
    """The first line of each image; the second, which may be empty, lists points that nothing here asks for."""
    lines = _lines(path)
    for number, text in lines:
        if not text or text.startswith("#"):
            continue
        at, words = _Place(f"{path}:{number}"), text.split(None, 9)
        if len(words) != 10:
            at.error(f"expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {_short(text)}")
        at.integer(words[0], "IMAGE_ID")
        yield _Image(at, words[1:8], at.integer(words[8], "CAMERA_ID"), words[9].rstrip())
        next(lines, None)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    if not path.is_file():
        raise FileNotFoundError(f"load_colmap: no such file: {path} (nor binary files)")
    try:
        with open(path, encoding="utf-8") as file:
            for number, text in enumerate(file, 1):
                yield number, text.strip()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not text") from None


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


# ----------------------------------------------------------------------------------------------------- binary files
def _binary_cameras(path: Path) -> Iterator[_Intrinsics]:
    with _Binary(path) as file:
        for _ in range(file.count("cameras", smallest=24 + 3 * 8)):
            camera, number, width, height = file.take("IiQQ")
            at = _Place(f"{path}: camera {camera}")
            if not 0 <= number < len(MODELS):
                name = (*MODELS, *_OTHERS)[number] if 0 <= number < len(MODELS) + len(_OTHERS) else f"number {number}"
                at.error(f"the camera model {name} is not supported; known here: {', '.join(MODELS)}")
            model = list(MODELS)[number]
            values = file.take(f"{len(MODELS[model])}d")
            yield _Intrinsics(at, camera, model, width, height, dict(zip(MODELS[model], values, strict=True)))
        file.end()


def _binary_images(path: Path) -> Iterator[_Image]:
    with _Binary(path) as file:
        for _ in range(file.count("images", smallest=4 + 7 * 8 + 4 + 1 + 8)):
            image, *pose, camera = file.take("I7dI")
            at = _Place(f"{path}: image {image}")
            name = file.name(at)
            (points,) = file.take("Q")
            file.skip(24 * points)  # their place and number
            yield _Image(at, pose, camera, name)
        file.end()


class _Binary:
    """A file of little-endian numbers that claims nothing beyond its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = open(path, "rb")
        self.left = os.fstat(self.file.fileno()).st_size

    def __enter__(self) -> _Binary:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def claim(self, size: int) -> None:
        if size > self.left:
            raise ValueError(f"{self.path}: the file is truncated or damaged: {size} bytes expected, {self.left} left")
        self.left -= size

    def take(self, form: str) -> tuple[Any, ...]:
        size = struct.calcsize("<" + form)
        self.claim(size)
        return struct.unpack("<" + form, self.file.read(size))

    def skip(self, size: int) -> None:
        self.claim(size)
        self.file.seek(size, os.SEEK_CUR)

    def count(self, what: str, smallest: int) -> int:
        """A number of records, each at least of that size."""
        (number,) = self.take("Q")
        if number * smallest > self.left:
            raise ValueError(
                f"{self.path}: the file is truncated or damaged: it claims to hold {number} {what} in {self.left} bytes"
            )
        return number

    def name(self, at: _Place) -> str:
        """A text that a zero byte ends."""
        content = self.file.read(min(_MAX_NAME, self.left))
        end = content.find(b"\0")
        if end < 0:
            at.error("the file is truncated or damaged: its name does not end")
        self.file.seek(end + 1 - len(content), os.SEEK_CUR)
        self.left -= end + 1
        try:
            return content[:end].decode()
        except UnicodeDecodeError:
            at.error(f"its name is not text: {content[:end][:60]!r}")

    def end(self) -> None:
        if self.left:
            raise ValueError(f"{self.path}: the file is damaged: {self.left} bytes after its end")
