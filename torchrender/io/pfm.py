"""Portable float maps (PFM): a three-line text header, then rows of 32-bit floats from bottom to top.

Pillow reads those of one channel alone, from version 10.3 on.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ._files import truncated

# "PF" or "Pf", width, height, scale (negative: little endian), one white-space character, data.
_HEADER = re.compile(rb"\A(PF|Pf)\s+(\d+)\s+(\d+)\s+([-+0-9.eE]+)\s")


def read_pfm(path: Path) -> np.ndarray:
    """Read a PFM file as float32 of shape (H, W, C), C = 1 or 3, top row first.

    The header's scale is the byte order only; its magnitude is not applied, as other readers do not either.
    """
    content = path.read_bytes()
    match = _HEADER.match(content)
    if match is None:
        raise ValueError(f"{path}: not a PFM file: expected a header 'PF' or 'Pf', width, height, scale")
    channels = 3 if match[1] == b"PF" else 1
    width, height = int(match[2]), int(match[3])
    try:
        scale = float(match[4])
    except ValueError:
        raise ValueError(f"{path}: the PFM scale is not a number: {match[4].decode(errors='replace')!r}") from None
    data, expected = content[match.end() :], 4 * width * height * channels
    if len(data) < expected or expected == 0:
        raise truncated(path, expected, len(data))
    pixels = np.frombuffer(data, "<f4" if scale < 0 else ">f4", width * height * channels)
    return pixels.reshape(height, width, channels)[::-1].astype(np.float32)


def write_pfm(path: Path, pixels: np.ndarray) -> None:
    """Write float32 pixels of shape (H, W, C), C = 1 or 3, top row first."""
    height, width, channels = pixels.shape
    if channels not in (1, 3):
        raise ValueError(f"{path}: a PFM file holds 1 or 3 channels, got {channels}")
    header = f"{'PF' if channels == 3 else 'Pf'}\n{width} {height}\n-1.0\n"
    path.write_bytes(header.encode() + np.ascontiguousarray(pixels[::-1], "<f4").tobytes())
