"""``read_volume`` and ``write_volume``: grids of values from and to files.

``.npy`` files are read by NumPy, which does not know Mitsuba's ``.vol`` files: a header of 48 bytes, then numbers.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import torch

from ._files import existing_file, reading, truncated, writable_file

# "VOL", version, encoding, x, y and z resolution, channels, bounding box (minimum, maximum); little endian.
_HEADER = struct.Struct("<3sBiiiii6f")
_FLOAT32 = 1


def read_volume(path: str | os.PathLike[str]) -> torch.Tensor:
    """Read a grid.

    Args:
        path: a ``.vol`` file (Mitsuba's format, version 3, 32-bit floats) or a NumPy ``.npy`` file of shape (Z, Y, X)
            or (Z, Y, X, C).

    Returns:
        float32 tensor (Z, Y, X, C). `read_volume_bounds` reads the bounding box that a ``.vol`` file stores.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is of another kind, truncated or damaged.
    """
    path = existing_file(path)
    with path.open("rb") as file:
        head = file.read(6)
    with reading(path):
        if head.startswith(b"VOL"):
            return _read_vol(path)
        if head == b"\x93NUMPY":
            return _read_npy(path)
    raise ValueError(f"{path}: expected a volume: a .vol file (beginning with 'VOL') or a .npy file")


def read_volume_bounds(path: str | os.PathLike[str]) -> torch.Tensor:
    """Read the bounding box that a ``.vol`` file states for its grid.

    Returns:
        float32 tensor (2, 3): lower and upper corner, (x, y, z).

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is no ``.vol`` file, or its header is truncated.
    """
    path = existing_file(path)
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    if not head.startswith(b"VOL"):
        raise ValueError(f"{path}: expected a .vol file (beginning with 'VOL'), which others have no bounding box")
    if len(head) < _HEADER.size:
        raise truncated(path, _HEADER.size, len(head))
    return torch.tensor(_HEADER.unpack(head)[-6:], dtype=torch.float32).reshape(2, 3)


def write_volume(
    path: str | os.PathLike[str],
    volume: torch.Tensor | np.ndarray,
    *,
    bounding_box: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0, 0, 0), (1, 1, 1)),
) -> None:
    """Write a grid as 32-bit floats.

    Args:
        path: ends in ``.vol`` (Mitsuba's format, version 3) or ``.npy``; its folder exists.
        volume: (Z, Y, X, C) or (Z, Y, X), floating point.
        bounding_box: of a ``.vol`` file: its minimum and maximum corner.

    Raises:
        FileNotFoundError: if there is no such folder.
        TypeError, ValueError: if the volume or the format is not one of those above.
    """
    path = writable_file(path)
    tensor = torch.as_tensor(volume) if isinstance(volume, (torch.Tensor, np.ndarray)) else None
    if tensor is None or not tensor.is_floating_point():
        got = f"dtype {tensor.dtype}" if tensor is not None else type(volume).__name__
        raise TypeError(f"volume: expected a floating-point tensor (Z, Y, X, C), got {got}")
    if tensor.dim() not in (3, 4) or 0 in tensor.shape:
        raise ValueError(f"volume: expected shape (Z, Y, X, C) or (Z, Y, X) without zeros, got {tuple(tensor.shape)}")
    tensor = tensor.unsqueeze(-1) if tensor.dim() == 3 else tensor
    values = np.ascontiguousarray(tensor.detach().cpu().float().numpy(), "<f4")
    if path.suffix.lower() == ".npy":
        np.save(path, values)
    elif path.suffix.lower() == ".vol":
        depth, height, width, channels = values.shape
        corners = [float(value) for corner in bounding_box for value in corner]
        if len(corners) != 6:
            raise ValueError(f"bounding_box: expected two corners of three numbers, got {bounding_box!r}")
        header = _HEADER.pack(b"VOL", 3, _FLOAT32, width, height, depth, channels, *corners)
        path.write_bytes(header + values.tobytes())
    else:
        raise ValueError(f"{path}: unknown volume format {path.suffix!r}; expected .vol or .npy")


def _read_vol(path: Path) -> torch.Tensor:
    content = path.read_bytes()
    if len(content) < _HEADER.size:
        raise truncated(path, _HEADER.size, len(content))
    _, version, encoding, width, height, depth, channels, *_ = _HEADER.unpack_from(content)
    if version != 3:
        raise ValueError(f"{path}: expected version 3 of the volume format, got {version}")
    if encoding != _FLOAT32:
        raise ValueError(f"{path}: expected 32-bit floats (encoding 1), got encoding {encoding}")
    if min(width, height, depth, channels) < 1:
        raise ValueError(f"{path}: expected a positive size, got {width} x {height} x {depth}, {channels} channels")
    count = width * height * depth * channels
    if len(content) - _HEADER.size < 4 * count:
        raise truncated(path, 4 * count, len(content) - _HEADER.size)
    values = np.frombuffer(content, "<f4", count, _HEADER.size).reshape(depth, height, width, channels)
    return torch.from_numpy(values.astype(np.float32))


def _read_npy(path: Path) -> torch.Tensor:
    try:
        values = np.load(path, allow_pickle=False)
    except Exception as error:  # NumPy's parser of the header raises whatever its text makes it stumble over
        raise ValueError(f"{path}: the .npy file is truncated or damaged ({error})") from None
    if values.ndim not in (3, 4) or values.size == 0 or values.dtype.kind not in "fiu":
        got = f"{values.dtype} of shape {values.shape}"
        raise ValueError(f"{path}: expected numbers of shape (Z, Y, X) or (Z, Y, X, C), got {got}")
    values = values[..., None] if values.ndim == 3 else values
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
