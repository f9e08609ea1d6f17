"""Radiance pictures (.hdr, .pic): RGBE pixels with a shared exponent, run-length encoded by scanline.

Pillow does not read them, imageio by way of further packages alone. The format is that of G. Ward, "Real Pixels",
Graphics Gems II (1991), and of the Radiance documentation.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ._files import check_size

_ALWAYS_READ = 1 << 24  # bytes of pixels that any file may claim to hold


def read_hdr(path: Path) -> np.ndarray:
    """Read a Radiance picture as linear float32 RGB of shape (H, W, 3), top row first.

    Raises:
        ValueError: if it is not such a file, is stored in XYZ or with rotated axes, or ends too early.
    """
    content = path.read_bytes()
    if not content.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise ValueError(f"{path}: not a Radiance HDR file: expected it to begin with '#?RADIANCE'")
    match = re.search(rb"\r?\n\r?\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\r?\n", content)
    if match is None:
        raise ValueError(f"{path}: the Radiance HDR header has no resolution line such as '-Y 512 +X 1024'")
    header = content[: match.start()]
    if b"FORMAT=32-bit_rle_xyze" in header:
        raise ValueError(f"{path}: expected RGB pixels (FORMAT=32-bit_rle_rgbe), got XYZ pixels (32-bit_rle_xyze)")
    if match[1] not in (b"-Y", b"+Y") or match[3] not in (b"-X", b"+X"):
        raise ValueError(f"{path}: expected scanlines along X, got {match[0].strip().decode()!r}")
    height, width = int(match[2]), int(match[4])
    if not 0 < width * height <= 1 << 30:
        raise ValueError(f"{path}: expected a size of 1 to 2^30 pixels, got {width} x {height}")
    if 4 * width * height > _ALWAYS_READ:
        check_size(path, 4 * width * height, 64)  # a run of two bytes gives at most 127
    rgbe = _decode(path, content, match.end(), height, width)
    rgbe = rgbe[::-1] if match[1] == b"+Y" else rgbe
    rgbe = rgbe[:, ::-1] if match[3] == b"-X" else rgbe
    # A mantissa m with exponent e stands for (m + 0.5) / 256 * 2^(e - 128); as nearly all readers do, the half is
    # left out, so that what is written comes back. An exponent of 0 is black.
    scale = np.where(rgbe[..., 3:] > 0, np.ldexp(np.float32(1), rgbe[..., 3:].astype(np.int32) - 136), np.float32(0))
    pixels = rgbe[..., :3].astype(np.float32) * scale.astype(np.float32)
    for exposure in re.findall(rb"(?m)^EXPOSURE=\s*([-+0-9.eE]+)", header):
        pixels /= np.float32(float(exposure))
    return pixels


def _decode(path: Path, content: bytes, start: int, height: int, width: int) -> np.ndarray:
    """All scanlines as uint8 (H, W, 4)."""
    data = np.frombuffer(content, np.uint8)
    out = np.empty((height, width, 4), np.uint8)
    position = start
    for y in range(height):
        head = content[position : position + 4]
        if len(head) < 4:
            raise _short(path, y, height)
        if 8 <= width < 32768 and head[0] == 2 and head[1] == 2 and head[2] * 256 + head[3] == width:
            position = _decode_runs(path, content, data, position + 4, out[y], y, height)
        else:
            flat = (
                data[position : position + 4 * width].reshape(-1, 4) if len(content) - position >= 4 * width else None
            )
            if flat is not None and not (flat[:, :3] == 1).all(axis=1).any():
                out[y] = flat
                position += 4 * width
            else:
                position = _decode_old_runs(path, data, position, out[y], y, height)
    return out


def _decode_old_runs(path: Path, data: np.ndarray, position: int, row: np.ndarray, y: int, height: int) -> int:
    """One scanline of the first encoding.

    The pixel (1, 1, 1, n) repeats the one before n times, and where several follow each other, each counts 256 times as
    much as the last.
    """
    width, x, shift = row.shape[0], 0, 0
    while x < width:
        pixel = data[position : position + 4]
        if pixel.size < 4:
            raise _short(path, y, height)
        position += 4
        if (pixel[:3] != 1).any():
            row[x], shift = pixel, 0
            x += 1
            continue
        count = int(pixel[3]) << shift
        if x == 0 or shift > 24 or x + count > width:
            raise ValueError(f"{path}: a run of scanline {y} does not fit into the {width} pixels of its row")
        row[x : x + count] = row[x - 1]
        x, shift = x + count, shift + 8
    return position


def _decode_runs(
    path: Path, content: bytes, data: np.ndarray, position: int, row: np.ndarray, y: int, height: int
) -> int:
    """Decode one scanline, component by component, into ``row`` (W, 4); returns the position behind it."""
    width, size = row.shape[0], len(content)
    for component in range(4):
        x = 0
        while x < width:
            if position + 1 >= size:
                raise _short(path, y, height)
            count = content[position]
            run = count > 128
            count = count - 128 if run else count
            if count == 0 or x + count > width:
                raise ValueError(f"{path}: a run of scanline {y} does not fit into the {width} pixels of its row")
            if run:
                row[x : x + count, component] = content[position + 1]
                position += 2
            else:
                if position + 1 + count > size:
                    raise _short(path, y, height)
                row[x : x + count, component] = data[position + 1 : position + 1 + count]
                position += 1 + count
            x += count
    return position


def _short(path: Path, y: int, height: int) -> ValueError:
    return ValueError(f"{path}: the file is truncated: it ends in scanline {y} of {height}")


def write_hdr(path: Path, pixels: np.ndarray) -> None:
    """Write linear RGB float32 (H, W, 3), uncompressed. Negative values cannot be stored and become 0."""
    height, width, channels = pixels.shape
    if channels != 3:
        raise ValueError(f"{path}: a Radiance HDR file holds 3 channels, got {channels}")
    pixels = np.maximum(pixels.astype(np.float64), 0)
    largest = pixels.max(axis=-1)
    _, exponent = np.frexp(largest)
    mantissa = np.floor(np.ldexp(pixels, 8 - exponent[..., None]))
    rgbe = np.empty((height, width, 4), np.uint8)
    rgbe[..., :3] = np.clip(mantissa, 0, 255)
    rgbe[..., 3] = np.clip(exponent + 128, 0, 255)
    rgbe[largest < 1e-38] = 0
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    # A flat pixel that looks like the mark of an encoded scanline would be misread: widths that allow the mark get it.
    marked = 8 <= width < 32768
    body = b"".join(_encode_row(row) for row in rgbe) if marked else rgbe.tobytes()
    path.write_bytes(header + body)


def _encode_row(row: np.ndarray) -> bytes:
    """One scanline in the new encoding, with literal packets only."""
    width = row.shape[0]
    parts = [bytes([2, 2, width >> 8, width & 255])]
    for component in range(4):
        values = row[:, component].tobytes()
        for x in range(0, width, 128):
            packet = values[x : x + 128]
            parts.append(bytes([len(packet)]) + packet)
    return b"".join(parts)
