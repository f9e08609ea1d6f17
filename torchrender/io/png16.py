"""PNG with 16 bits per channel and several channels, which Pillow reduces to 8 bits.

Chunks, filters and colour types: W3C Portable Network Graphics specification, sections 5, 9 and 11.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ._files import truncated

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}


def bit_depth(head: bytes) -> int | None:
    """Bits per channel of the PNG file that begins with ``head`` (at least 26 bytes), None if it is no PNG."""
    if len(head) < 26 or not head.startswith(SIGNATURE) or head[12:16] != b"IHDR":
        return None
    return head[24]


def read_png16(path: Path) -> np.ndarray:
    """Read a non-interlaced 16-bit PNG file as uint16 of shape (H, W, C), C in 1 to 4."""
    content = path.read_bytes()
    if len(content) < 33:
        raise truncated(path, 33, len(content))
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", content[16:29])
    if depth != 16 or colour not in _CHANNELS or width == 0 or height == 0:
        raise ValueError(f"{path}: expected a 16-bit PNG image, got depth {depth}, colour type {colour}")
    if interlaced:
        raise ValueError(f"{path}: interlaced 16-bit PNG files are not supported; save it without interlacing")
    channels = _CHANNELS[colour]
    stride = 2 * channels * width
    data = _inflate(path, content, height * (stride + 1))
    rows = np.frombuffer(data, np.uint8).reshape(height, stride + 1)
    if rows[:, 0].max() > 4:
        raise ValueError(f"{path}: unknown PNG filter type {rows[:, 0].max()}")
    pixels = _unfilter(rows[:, 0], rows[:, 1:].reshape(height, width, 2 * channels))
    return pixels.reshape(height, width, channels, 2).view(">u2")[..., 0].astype(np.uint16)


def _inflate(path: Path, content: bytes, expected: int) -> bytes:
    """The concatenated, decompressed IDAT chunks."""
    position, parts = 8, []
    while position + 8 <= len(content):
        length, kind = struct.unpack(">I4s", content[position : position + 8])
        if kind == b"IDAT":
            parts.append(content[position + 8 : position + 8 + length])
        position += 12 + length
    try:
        data = zlib.decompressobj().decompress(b"".join(parts), expected)
    except zlib.error as error:
        raise ValueError(f"{path}: the PNG data cannot be decompressed: {error}") from None
    if len(data) < expected:
        raise truncated(path, expected, len(data))
    return data


def _unfilter(kinds: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Undo the row filters. ``kinds`` (H,), ``rows`` (H, W, B) with B bytes per pixel; returns uint8 (H, W, B).

    A pixel depends on those to the left, above and above-left, so all pixels of an anti-diagonal are done at once:
    diagonal d holds (y, d - y), its neighbours lie on diagonals d - 1 and d - 2.
    """
    height, width, size = rows.shape
    steps = height + width - 1
    # One diagonal of zeros before the first two, and one row of zeros above row 0.
    out = np.zeros((steps + 2, height + 1, size), np.int16)
    y = np.arange(height)
    sub, up, average, paeth = ((kinds == kind)[:, None] for kind in (1, 2, 3, 4))
    for d in range(steps):
        first, last = max(0, d - width + 1), min(height, d + 1)
        here = slice(first, last)
        left, above = out[d + 1, first + 1 : last + 1], out[d + 1, first:last]
        corner = out[d, first:last]
        x = d - y[here]
        left = np.where((x > 0)[:, None], left, 0)
        corner = np.where((x > 0)[:, None], corner, 0)
        p, q, r = np.abs(above - corner), np.abs(left - corner), np.abs(left + above - 2 * corner)
        predicted = np.where((p <= q) & (p <= r), left, np.where(q <= r, above, corner))
        predicted = np.where(paeth[here], predicted, 0)
        predicted = np.where(average[here], (left + above) >> 1, predicted)
        predicted = np.where(up[here], above, np.where(sub[here], left, predicted))
        out[d + 2, first + 1 : last + 1] = (rows[y[here], x] + predicted) & 255
    result = np.empty((height, width, size), np.uint8)
    for row in range(height):
        result[row] = out[row + 2 : row + 2 + width, row + 1]
    return result


def write_png16(path: Path, pixels: np.ndarray) -> None:
    """Write uint16 pixels of shape (H, W, C), C in 1 to 4."""
    height, width, channels = pixels.shape
    colour = {count: kind for kind, count in _CHANNELS.items()}[channels]
    encoded = np.ascontiguousarray(pixels.astype(">u2")).view(np.uint8).reshape(height, -1)
    rows = np.empty((height, 1 + encoded.shape[1]), np.uint8)
    rows[:, 0] = 2  # each byte minus the one above it, which compresses smooth pictures well
    rows[:, 1:] = encoded
    rows[1:, 1:] -= encoded[:-1]
    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b"")]
    path.write_bytes(SIGNATURE + b"".join(_chunk(kind, data) for kind, data in chunks))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
