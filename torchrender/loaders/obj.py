"""The geometry of Wavefront OBJ files: positions, texture coordinates, normals and faces, as one mesh.

trimesh's reader makes a mesh of each material, gives corners without texture coordinates those of others, and does not
say where in a file a mistake is.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np

Table: TypeAlias = "list[list[float]]"
_TABLES = {b"v": 0, b"vt": 1, b"vn": 2}
_WIDTHS = (3, 2, 3)


def read_obj(path: Path) -> dict[str, np.ndarray | None]:
    """Read an OBJ file as one mesh; groups and materials are not told apart.

    A vertex of the result is a distinct combination of position, texture coordinate and normal, in the order in which
    the faces first use them. Polygons become fans of triangles.

    Returns:
        ``vertices`` (V, 3), ``texcoords`` (V, 2) or None, ``normals`` (V, 3) or None (also where only some corners have
        one), all float64, and ``faces`` (F, 3) int64.

    Raises:
        ValueError: with the line, for an index out of range or a value that is no number.
    """
    tables: tuple[Table, Table, Table] = ([], [], [])
    known: dict[tuple[int, int, int], int] = {}
    faces: list[tuple[int, int, int]] = []
    text = path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    if b"\0" in text:
        raise ValueError(f"{path}: not an OBJ file: it holds binary data")
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] in _TABLES:
                which = _TABLES[words[0]]
                values = [float(word) for word in words[1 : 1 + _WIDTHS[which]]]
                if which == 1 and len(values) == 1:
                    values.append(0.0)
                if len(values) != _WIDTHS[which]:
                    raise ValueError(f"expected {_WIDTHS[which]} numbers")
                tables[which].append(values)
            elif words[0] == b"f":
                corners = [_corner(word, tables) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face needs three corners or more")
                index = [known.setdefault(corner, len(known)) for corner in corners]
                faces += [(index[0], index[i], index[i + 1]) for i in range(1, len(index) - 1)]
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}: {line.strip().decode('latin-1')[:60]!r}") from None
    if not faces:
        raise ValueError(f"{path}: the OBJ file has no faces, or is truncated")
    keys = np.array(list(known), np.int64).reshape(-1, 3)
    gathered = [_gather(table, keys[:, i], _WIDTHS[i]) for i, table in enumerate(tables)]
    texcoords = gathered[1] if (keys[:, 1] >= 0).any() else None
    normals = gathered[2] if (keys[:, 2] >= 0).all() else None
    return {"vertices": gathered[0], "texcoords": texcoords, "normals": normals, "faces": np.array(faces, np.int64)}


def _corner(word: bytes, tables: tuple[Table, Table, Table]) -> tuple[int, int, int]:
    """``p``, ``p/t``, ``p//n`` or ``p/t/n`` as indices from 0, -1 where there is none."""
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0]:
        raise ValueError("a corner is p, p/t, p//n or p/t/n")
    result = [-1, -1, -1]
    for i, part in enumerate(parts):
        if not part:
            continue
        index = int(part)
        size = len(tables[i])
        resolved = index - 1 if index > 0 else size + index  # negative indices count backwards from the last
        if index == 0 or not 0 <= resolved < size:
            raise ValueError(f"index {index} is out of the {size} entries before it")
        result[i] = resolved
    return result[0], result[1], result[2]


def _gather(table: Table, index: np.ndarray, width: int) -> np.ndarray:
    """Rows of the table; zeros where the index is -1."""
    rows = np.array([*table, [0.0] * width], np.float64).reshape(-1, width)
    return rows[index]
