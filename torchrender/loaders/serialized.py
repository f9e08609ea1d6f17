"""Mitsuba's compressed mesh files (``.serialized``), versions 3 and 4.

Format: the manual of Mitsuba 0.6, "Serialized mesh loader". Several meshes, each a header of 4 bytes and a zlib stream,
then a table of their offsets and their number. All little endian. trimesh does not read them.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

MAGIC = 0x041C
NORMALS, TEXCOORDS, COLOURS, FACE_NORMALS, SINGLE, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x1000, 0x2000
# zlib cannot compress better than about 1032 to 1.
_LARGEST_RATIO = 1100


def read_serialized(path: Path, index: int = 0) -> dict[str, Any]:
    """One mesh of the file.

    Args:
        path: the file.
        index: which of its meshes, from 0.

    Returns:
        ``vertices`` (V, 3), ``vertex_normals`` (V, 3) or None, ``vertex_texcoords`` (V, 2) or None in the file's
        precision, ``faces`` (F, 3) int64, ``attributes`` (``vertex_color`` or nothing), and ``face_normals``: whether
        the file asks for flat shading.

    Raises:
        ValueError: if it is no such file, truncated or damaged, or has fewer meshes.
    """
    content = path.read_bytes()
    start, end, version = _place(path, content, index)
    stream = _Stream(path, content[start + 4 : end])
    (flags,) = struct.unpack("<I", stream.take(4))
    if version == 4:
        while stream.take(1) != b"\0":  # the mesh's name
            pass
    vertices, triangles = struct.unpack("<QQ", stream.take(16))
    if bool(flags & SINGLE) == bool(flags & DOUBLE):
        raise ValueError(f"{path}: mesh {index} says neither or both of single and double precision: flags {flags:#x}")
    real = np.dtype("<f8" if flags & DOUBLE else "<f4")
    if vertices > 0xFFFFFFFF:
        raise ValueError(f"{path}: mesh {index} claims to have {vertices} vertices")

    def rows(columns: int, dtype: np.dtype, count: int) -> np.ndarray:
        data = stream.take(count * columns * dtype.itemsize)
        return np.frombuffer(data, dtype).reshape(count, columns).astype(dtype.newbyteorder("="))

    positions = rows(3, real, vertices)
    normals = rows(3, real, vertices) if flags & NORMALS else None
    texcoords = rows(2, real, vertices) if flags & TEXCOORDS else None
    colours = rows(3, real, vertices) if flags & COLOURS else None
    faces = rows(3, np.dtype("<u4"), triangles)
    return {
        "vertices": positions,
        "faces": faces.astype(np.int64),
        "vertex_normals": None if flags & FACE_NORMALS else normals,
        "vertex_texcoords": texcoords,
        "attributes": {} if colours is None else {"vertex_color": colours},
        "face_normals": bool(flags & FACE_NORMALS),
    }


def _place(path: Path, content: bytes, index: int) -> tuple[int, int, int]:
    """Where mesh `index` begins and ends, and the format's version."""
    if len(content) < 8:
        raise ValueError(f"{path}: the file is truncated: it has {len(content)} bytes")
    magic, version = struct.unpack_from("<HH", content)
    if magic != MAGIC or version not in (3, 4):
        raise ValueError(f"{path}: expected a serialized mesh of version 3 or 4, got {content[:4].hex()} at its begin")
    (count,) = struct.unpack_from("<I", content, len(content) - 4)
    code, size = ("<Q", 8) if version == 4 else ("<I", 4)
    table = len(content) - 4 - count * size
    if count == 0 or table < 4:
        raise ValueError(f"{path}: the file is truncated or damaged: it claims to hold {count} meshes")
    if not 0 <= index < count:
        raise ValueError(f"{path}: shape_index: the file has {count} meshes, numbered from 0; got {index}")
    (start,) = struct.unpack_from(code, content, table + index * size)
    end = struct.unpack_from(code, content, table + (index + 1) * size)[0] if index + 1 < count else table
    if not start + 4 <= end <= table:
        raise ValueError(f"{path}: the file is truncated or damaged: mesh {index} lies at bytes {start} to {end}")
    if struct.unpack_from("<H", content, start)[0] != MAGIC:
        raise ValueError(f"{path}: the file is damaged: no mesh begins at byte {start}")
    return start, end, version


class _Stream:
    """Decompresses as much as is asked for, and no more."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self.left = len(data) * _LARGEST_RATIO
        self.inflate = zlib.decompressobj()
        self.data = data

    def take(self, size: int) -> bytes:
        if size > self.left:
            raise ValueError(f"{self.path}: the file is truncated or damaged: {size} bytes cannot be in it")
        self.left -= size
        if size == 0:
            return b""
        parts, missing = [], size
        while missing:
            try:
                part = self.inflate.decompress(self.data, missing)
            except zlib.error as error:
                raise ValueError(f"{self.path}: the mesh cannot be decompressed: {error}") from None
            self.data = self.inflate.unconsumed_tail
            if not part and (self.inflate.eof or not self.data):
                raise ValueError(f"{self.path}: the file is truncated: {missing} bytes are missing")
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)
