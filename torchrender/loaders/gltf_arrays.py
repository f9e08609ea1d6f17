"""Arrays of glTF files that trimesh misreads: integers that stand for fractions, and sparse ones, as plain floats.

Conventions: Khronos Group, "glTF 2.0 Specification" (2021), section 3.6.2 (accessors), and KHR_mesh_quantization.
"""

from __future__ import annotations

import base64
import functools
from collections.abc import Callable
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_FLOAT = 5126


def with_floats(
    header: dict[str, Any], binary: bytes | None, names: tuple[str, ...], load: Callable[[str], bytes]
) -> dict[str, Any]:
    """The header with those attributes of its meshes decoded, in a buffer that is added.

    Args:
        header: the file's JSON.
        binary: the second part of a .glb file.
        names: of attributes whose integers are not left to trimesh.
        load: gives the content of a file that the header names.
    """
    accessors = list(header.get("accessors", []))
    attributes = [p.get("attributes", {}) for m in header.get("meshes", []) for p in m.get("primitives", [])]
    wanted = {a[name] for a in attributes for name in a if _is_odd(accessors[a[name]], name in names)}
    if not wanted:
        return header

    @functools.cache
    def buffer(index: int) -> bytes:
        uri = header["buffers"][index].get("uri")
        if uri is None:
            if index != 0 or binary is None:
                raise ValueError(f"buffer {index} is nowhere")
            return binary
        if uri.startswith("data:"):
            start, _, data = uri.partition(",")
            return base64.b64decode(data) if start.endswith(";base64") else unquote_to_bytes(data)
        return load(uri)

    def rows(place: dict[str, Any], kind: int, count: int, columns: int) -> np.ndarray:
        view = header["bufferViews"][place["bufferView"]]
        dtype = np.dtype(_DTYPES[kind])
        start, offset = view.get("byteOffset", 0), place.get("byteOffset", 0)
        stride = view.get("byteStride", columns * dtype.itemsize)
        if min(start, offset, count, stride - columns * dtype.itemsize) < 0:
            raise ValueError("an accessor begins before its buffer, or its rows overlap")
        data = buffer(view["buffer"])[start : start + view["byteLength"]]
        return np.ndarray((count, columns), dtype, data, offset, (stride, dtype.itemsize))  # checks the data's length

    added, views = [], []
    start = 0
    for index in sorted(wanted):
        accessor = accessors[index]
        kind, count, columns = accessor["componentType"], int(accessor["count"]), _COLUMNS[accessor["type"]]
        values = np.zeros((count, columns), np.dtype(_DTYPES[kind]))
        if "bufferView" in accessor:
            values = rows(accessor, kind, count, columns).copy()
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            places = rows(sparse["indices"], sparse["indices"]["componentType"], sparse["count"], 1)[:, 0]
            values[places] = rows(sparse["values"], kind, sparse["count"], columns)
        if accessor.get("normalized") and kind != _FLOAT:
            values = np.maximum(values / np.iinfo(values.dtype).max, -1)
        data = values.astype("<f4").tobytes()
        views.append({"buffer": len(header["buffers"]), "byteOffset": start, "byteLength": len(data)})
        accessors[index] = {
            "bufferView": len(header.get("bufferViews", [])) + len(views) - 1,
            "componentType": _FLOAT,
            "count": count,
            "type": accessor["type"],
        }
        added.append(data)
        start += len(data)
    uri = "data:application/octet-stream;base64," + base64.b64encode(b"".join(added)).decode()
    return {
        **header,
        "accessors": accessors,
        "bufferViews": [*header.get("bufferViews", []), *views],
        "buffers": [*header["buffers"], {"uri": uri, "byteLength": start}],
    }


def _is_odd(accessor: dict[str, Any], to_floats: bool) -> bool:
    return "sparse" in accessor or (to_floats and accessor["componentType"] != _FLOAT)
