"""OpenEXR files with named channels, in half or single precision, of one or several parts.

The header is looked at here before the library reads any pixels: "OpenEXR file layout", openexr.com.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import nearest
from ._files import check_size

MAGIC = b"\x76\x2f\x31\x01"
_MULTIPART = 0x1000
# Bytes of pixels for a byte of the file. Wavelet and DCT codecs have no bound on constant pictures, hence the floor.
_LARGEST_RATIO = 4096
_ALWAYS_READ = 1 << 24
_MAX_HEADER = 1 << 24


@dataclass
class _Part:
    """What the header of one part says."""

    name: str = ""
    channels: list[str] = field(default_factory=list)
    size: tuple[int, int] = (0, 0)  # rows, columns


def read_exr(path: Path, part: str | None = None) -> dict[str, np.ndarray]:
    """All channels of a part, the first if none is named, each as float32 (H, W), by name.

    Raises:
        ValueError: if the file is damaged or truncated, has no such part, or the part's channels have different
            resolutions.
    """
    parts = read_parts(path)
    if part is not None and part not in parts:
        raise ValueError(f"{path}: part: {nearest(part, parts)}; got {part!r}")
    return next(iter(parts.values())) if part is None else parts[part]


def read_parts(path: Path) -> dict[str, dict[str, np.ndarray]]:
    """The channels of every part, by its name; the first part, if it has none, is ``""``.

    Raises:
        ValueError: if the file is damaged or truncated, or a part's channels have different resolutions.
    """
    import OpenEXR

    expected = _check_header(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = {}
            for number, part in enumerate(file.parts):
                name = part.header.get("name") or (f"part{number}" if number else "")
                parts[str(name)] = {key: np.asarray(channel.pixels) for key, channel in part.channels.items()}
    except (RuntimeError, ValueError, TypeError, IndexError) as error:
        raise ValueError(f"{path}: the OpenEXR file is truncated or damaged ({error})") from None
    # Where the library cannot read a part it leaves out this and all that follow.
    if [len(channels) for channels in parts.values()] != [len(part.channels) for part in expected]:
        raise ValueError(f"{path}: the OpenEXR file is truncated or damaged: parts or channels of it cannot be read")
    return {name: _checked(path, channels) for name, channels in parts.items()}


def _checked(path: Path, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    shapes = {name: pixels.shape for name, pixels in channels.items()}
    if not channels or any(len(shape) != 2 or 0 in shape for shape in shapes.values()):
        raise ValueError(f"{path}: expected an OpenEXR file with at least one flat channel, got {shapes}")
    if len(set(shapes.values())) > 1:
        raise ValueError(f"{path}: expected channels of one resolution, got {shapes}")
    return {name: np.ascontiguousarray(pixels, np.float32) for name, pixels in channels.items()}


def write_exr(path: Path, parts: Mapping[str, Mapping[str, np.ndarray]], half: bool) -> None:
    """Write parts by name, each of channels of shape (H, W) by name, ZIP compressed.

    ``half`` stores 16-bit floats, else 32-bit ones. One part with the name ``""`` makes an ordinary file.
    """
    import OpenEXR

    dtype = np.float16 if half else np.float32
    made = []
    sizes = [next(iter(channels.values())).shape for channels in parts.values()]
    # All parts of a file share one display window: what the largest of them covers.
    corner = np.array([max(width for _, width in sizes) - 1, max(height for height, _ in sizes) - 1], np.int32)
    for name, channels in parts.items():
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with np.errstate(over="ignore"):  # values above 65504 become infinite in half precision, as documented
            pixels = {key: np.ascontiguousarray(values.astype(dtype)) for key, values in channels.items()}
        if name or len(parts) > 1:
            window = (np.zeros(2, np.int32), corner)
            made.append(OpenEXR.Part({**header, "displayWindow": window}, pixels, name))
        else:
            with OpenEXR.File(header, pixels) as file:
                file.write(str(path))
            return
    with OpenEXR.File(made) as file:
        file.write(str(path))


def _check_header(path: Path) -> list[_Part]:
    """What the header says; ValueError if the file claims to hold more pixels than it can."""
    with path.open("rb") as file:
        content = file.read(_MAX_HEADER)
    try:
        parts = _header(content)
    except (struct.error, IndexError, ValueError):
        raise ValueError(f"{path}: the header of the OpenEXR file is truncated or damaged") from None
    claimed = sum(part.size[0] * part.size[1] * 4 * max(1, len(part.channels)) for part in parts)
    if claimed > _ALWAYS_READ:
        check_size(path, claimed, _LARGEST_RATIO)
    return parts


def _header(content: bytes) -> list[_Part]:
    """The headers of all parts."""
    (version,) = struct.unpack_from("<I", content, 4)
    position, parts = 8, []
    while True:
        part = _Part()
        while content[position] != 0:
            name, position = _text(content, position)
            _, position = _text(content, position)
            (size,) = struct.unpack_from("<i", content, position)
            data = content[position + 4 : position + 4 + size]
            if size < 0 or len(data) < size:
                raise ValueError("an attribute ends beyond the header")
            position += 4 + size
            if name == b"dataWindow":
                x0, y0, x1, y1 = struct.unpack("<4i", data)
                part.size = (max(0, y1 - y0 + 1), max(0, x1 - x0 + 1))
            elif name == b"channels":
                part.channels = _channel_names(data)
            elif name == b"name":
                part.name = data.decode("latin-1")
        position += 1
        parts.append(part)
        if not version & _MULTIPART or content[position] == 0:
            return parts


def _channel_names(data: bytes) -> list[str]:
    position, names = 0, []
    while data[position] != 0:
        name, position = _text(data, position)
        names.append(name.decode("latin-1"))
        position += 16
    return names


def _text(content: bytes, position: int) -> tuple[bytes, int]:
    """A text that a zero byte ends, and where the next thing begins."""
    end = content.index(b"\0", position)
    return content[position:end], end + 1


def colour_channels(path: Path, names: list[str]) -> list[str]:
    """The channels that make up the picture: R, G, B and A where there are some; else Y; else a single channel."""
    if {"R", "G", "B"} <= set(names):
        return ["R", "G", "B"] + (["A"] if "A" in names else [])
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ["Y"]
    if len(names) == 1:
        return names
    raise ValueError(f"{path}: no channels R, G, B or Y; choose with channels=(...) from {sorted(names)}")
