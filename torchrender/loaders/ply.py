"""PLY files (ascii, binary little and big endian) as arrays by element and property.

Format: G. Turk, "The PLY Polygon File Format" (1994). trimesh's reader leaves out normals and the values that vertices
carry, and takes an index out of range, or a file that ends too early, for a mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}


@dataclass
class PlyElement:
    """One element of the header, and its rows once read.

    Attributes:
        name, count: such as ``vertex`` and the number of rows.
        scalars: property name -> dtype code, in the file's order among all properties.
        lists: property name -> (dtype code of the length, of the entries).
        order: property names in the file's order.
        data: property name -> array (count,); for lists an array (total, 2) of (row, value) pairs, rows ascending.
    """

    name: str
    count: int
    scalars: dict[str, str] = field(default_factory=dict)
    lists: dict[str, tuple[str, str]] = field(default_factory=dict)
    order: list[str] = field(default_factory=list)
    data: dict[str, np.ndarray] = field(default_factory=dict)


def read_ply(path: Path) -> dict[str, PlyElement]:
    """All elements of a PLY file by name.

    Raises:
        ValueError: if the header is not that of a PLY file, or the data end too early.
    """
    content = path.read_bytes()
    encoding, elements, position = _header(path, content)
    if encoding == "ascii":
        _read_ascii(path, content[position:], elements)
    else:
        _read_binary(path, content, position, elements, "<" if encoding == "binary_little_endian" else ">")
    return {element.name: element for element in elements}


def _header(path: Path, content: bytes) -> tuple[str, list[PlyElement], int]:
    if not content.startswith((b"ply\n", b"ply\r")):
        raise ValueError(f"{path}: not a PLY file: expected it to begin with 'ply'")
    end = content.find(b"end_header")
    stop = content.find(b"\n", end)
    if end < 0 or stop < 0:
        raise ValueError(f"{path}: the file is truncated: its header has no 'end_header'")
    encoding, elements = "", []
    for line in content[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        try:
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format" and words[1] in ("ascii", "binary_little_endian", "binary_big_endian"):
                encoding = words[1]
            elif words[0] == "element" and int(words[2]) >= 0:
                elements.append(PlyElement(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].lists[words[4]] = (_TYPES[words[2]], _TYPES[words[3]])
                elements[-1].order.append(words[4])
            elif words[0] == "property":
                elements[-1].scalars[words[2]] = _TYPES[words[1]]
                elements[-1].order.append(words[2])
            else:
                raise ValueError
        except (IndexError, KeyError, ValueError):
            raise ValueError(f"{path}: the PLY header has a line that means nothing: {line!r}") from None
    if not encoding:
        raise ValueError(f"{path}: the PLY header has no known format")
    for element in elements:
        if len(set(element.order)) != len(element.order):
            raise ValueError(f"{path}: the element {element.name!r} has a property twice")
    return encoding, elements, stop + 1


def _short(path: Path, element: PlyElement) -> ValueError:
    return ValueError(f"{path}: the file is truncated: it ends within the {element.count} rows of {element.name!r}")


def _read_binary(path: Path, content: bytes, position: int, elements: list[PlyElement], endian: str) -> None:
    for element in elements:
        if not element.count:
            continue
        lengths = _guess_lengths(path, content, position, element, endian)
        row = np.dtype(_row_fields(element, lengths, endian))
        if len(content) - position >= row.itemsize * element.count:
            table = np.frombuffer(content, row, element.count, position)
            if all((table["n " + name] == length).all() for name, length in lengths.items()):
                _take_table(element, table, lengths)
                position += row.itemsize * element.count
                continue
        if not element.lists:
            raise _short(path, element)
        position = _read_ragged(path, content, position, element, endian)


def _guess_lengths(path: Path, content: bytes, position: int, element: PlyElement, endian: str) -> dict[str, int]:
    """The lengths of the lists in the first row: mostly those of all rows."""
    lengths: dict[str, int] = {}
    for name in element.order:
        if name in element.scalars:
            position += np.dtype(element.scalars[name]).itemsize
            continue
        length = _scalar(path, content, position, element.lists[name][0], element, endian)
        lengths[name] = length
        count, entry = (np.dtype(code).itemsize for code in element.lists[name])
        position += count + length * entry
    return lengths


def _scalar(path: Path, content: bytes, position: int, code: str, element: PlyElement, endian: str) -> int:
    size = np.dtype(code).itemsize
    if position + size > len(content):
        raise _short(path, element)
    value = int(np.frombuffer(content, endian + code, 1, position)[0])
    if value < 0 or value > len(content):
        raise ValueError(f"{path}: a list in {element.name!r} claims to have {value} entries")
    return value


def _row_fields(element: PlyElement, lengths: dict[str, int], endian: str) -> list[tuple[Any, ...]]:
    fields: list[tuple[Any, ...]] = []
    for name in element.order:
        if name in element.scalars:
            fields.append((name, endian + element.scalars[name]))
        else:
            count, entry = element.lists[name]
            fields += [("n " + name, endian + count), (name, endian + entry, (lengths[name],))]
    return fields


def _take_table(element: PlyElement, table: np.ndarray, lengths: dict[str, int]) -> None:
    for name in element.order:
        column = table[name]
        if name in element.scalars:
            element.data[name] = column.astype(element.scalars[name])
        else:
            rows = np.repeat(np.arange(element.count), lengths[name])
            element.data[name] = np.stack([rows, column.reshape(-1).astype(np.float64)], axis=1)


def _read_ragged(path: Path, content: bytes, position: int, element: PlyElement, endian: str) -> int:
    """Row by row, for lists of differing lengths; returns the position behind the element."""
    columns: dict[str, list[Any]] = {name: [] for name in element.order}
    for row in range(element.count):
        for name in element.order:
            length, code = 1, element.scalars.get(name)
            if code is None:
                count, code = element.lists[name]
                length = _scalar(path, content, position, count, element, endian)
                position += np.dtype(count).itemsize
            size = np.dtype(code).itemsize * length
            if position + size > len(content):
                raise _short(path, element)
            entries = np.frombuffer(content, endian + code, length, position)
            position += size
            columns[name] += entries.tolist() if name in element.scalars else [(row, float(v)) for v in entries]
    _take_columns(element, columns)
    return position


def _take_columns(element: PlyElement, columns: dict[str, list[Any]]) -> None:
    for name, values in columns.items():
        if name in element.scalars:
            element.data[name] = np.array(values, element.scalars[name])
        else:
            element.data[name] = np.array(values, np.float64).reshape(-1, 2)


def _read_ascii(path: Path, body: bytes, elements: list[PlyElement]) -> None:
    try:
        words = np.array(body.split(), np.float64)
    except ValueError as error:
        raise ValueError(f"{path}: the PLY data hold something that is no number ({error})") from None
    position = 0
    for element in elements:
        if not element.lists:
            size = element.count * len(element.order)
            if position + size > words.size:
                raise _short(path, element)
            table = words[position : position + size].reshape(element.count, len(element.order))
            element.data = {name: table[:, i].astype(element.scalars[name]) for i, name in enumerate(element.order)}
            position += size
            continue
        columns: dict[str, list[Any]] = {name: [] for name in element.order}
        for row in range(element.count):
            for name in element.order:
                length = 1
                if name in element.lists:
                    if position >= words.size or words[position] < 0:
                        raise _short(path, element)
                    length = int(words[position])
                    position += 1
                if position + length > words.size:
                    raise _short(path, element)
                entries = words[position : position + length].tolist()
                position += length
                columns[name] += entries if name in element.scalars else [(row, v) for v in entries]
        _take_columns(element, columns)


def write_ply(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray | None = None,
    texcoords: np.ndarray | None = None,
    attributes: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a triangle mesh, binary and little endian, in the precision of its arrays.

    Args:
        path: where to.
        vertices, normals: (V, 3). texcoords: (V, 2), the properties u and v.
        faces: (F, 3) integers.
        attributes: ``vertex_NAME`` (V, C) and ``face_NAME`` (F, C): the properties r, g, b for the name ``color``,
            ``NAME_r`` and so on for ``NAME_color``, else ``NAME_0`` and so on.
    """
    groups = [(("x", "y", "z"), vertices), (("nx", "ny", "nz"), normals), (("u", "v"), texcoords)]
    rows = {"vertex": [(names, array) for names, array in groups if array is not None], "face": []}
    for key, array in (attributes or {}).items():
        element, base = key.split("_", 1)
        rows[element].append((_property_names(base, array.shape[1]), array))
    tables = {
        "vertex": np.zeros(len(vertices), _table(rows["vertex"], [])),
        "face": np.zeros(len(faces), _table(rows["face"], [("n", "u1"), ("corners", "<i4", (3,))])),
    }
    tables["face"]["n"], tables["face"]["corners"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0"]
    for element, table in tables.items():
        header.append(f"element {element} {len(table)}")
        header += ["property list uchar int vertex_indices"] * (element == "face")
        for names, array in rows[element]:
            header += [f"property {'double' if array.dtype == np.float64 else 'float'} {name}" for name in names]
            for i, name in enumerate(names):
                table[name] = array[:, i]
    content = "\n".join([*header, "end_header", ""]).encode()
    path.write_bytes(content + tables["vertex"].tobytes() + tables["face"].tobytes())


def _property_names(base: str, channels: int) -> tuple[str, ...]:
    if base == "color" or base.endswith("_color"):
        return tuple(base.removesuffix("color") + letter for letter in "rgba"[:channels])
    return tuple(f"{base}_{i}" for i in range(channels))


def _table(columns: list[tuple[tuple[str, ...], np.ndarray]], first: list[tuple[Any, ...]]) -> np.dtype:
    return np.dtype([*first, *((name, f"<{array.dtype.str[1:]}") for names, array in columns for name in names)])
