"""What trimesh leaves out of glTF files: every camera, and the lights of KHR_lights_punctual.

Conventions: Khronos Group, "glTF 2.0 Specification" (2021), sections 3.5 (nodes) and 3.10 (cameras), and the extension
KHR_lights_punctual.
"""

from __future__ import annotations

import json
import math
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SubstitutionWarning
from ..io._files import check_size
from .gltf_arrays import with_floats

HEIGHT = 512  # rows of pixels of a camera: glTF states their proportions only
_MAX_NODES = 1 << 20
_MAX_WIDTH = 1 << 16
# Beginnings of names of extensions without which a file looks different, but not wrong, or which are read.
_SUPPORTED = ("KHR_materials_", "KHR_lights_", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_node_", "KHR_xmp")
# What cameras and lights of glTF look along -z with x to the right is +z with x to the left here.
_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])


def read_file(path: Path, files: Any) -> tuple[dict[str, Any], bytes]:
    """The JSON part of a .gltf or .glb file, and the file as trimesh understands it.

    A material's name is "NUMBER:NAME" there, by which what trimesh makes of it is found in the JSON again.

    Args:
        path: the file.
        files: a resolver, which gives the files that it names.

    Raises:
        ValueError: if it has no JSON, describes arrays that cannot be in the file, or needs what is not supported.
    """
    content = path.read_bytes()
    rest = None
    if content[:4] == b"glTF":
        length, kind = struct.unpack_from("<I4s", content, 12)
        if kind != b"JSON" or length > len(content) - 20:
            raise ValueError(f"{path}: the file is truncated or damaged: its first part is no JSON of {length} bytes")
        content, rest = content[20 : 20 + length], content[20 + length :]
    header = json.loads(content)
    if not isinstance(header, dict):
        raise ValueError(f"{path}: expected a JSON object, got {type(header).__name__}")
    _check(path, header)
    binary = None
    if rest:
        length, kind = struct.unpack_from("<I4s", rest)
        binary = rest[8 : 8 + length] if kind == b"BIN\0" else None
    decoded = with_floats(header, binary, ("POSITION", "NORMAL", "TEXCOORD_0"), files.get)
    materials = [{**m, "name": f"{i}:{m.get('name', '')}"} for i, m in enumerate(header.get("materials", []))]
    numbered = json.dumps({**decoded, "materials": materials} if materials else decoded).encode()
    if rest is not None:
        numbered += b" " * (-len(numbered) % 4)
        start = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(numbered) + len(rest), len(numbered), b"JSON")
        numbered = start + numbered + rest
    return header, numbered


def _check(path: Path, header: dict[str, Any]) -> None:
    """ValueError for what trimesh would misread."""
    missing = [name for name in header.get("extensionsRequired", []) if not name.startswith(_SUPPORTED)]
    if missing:
        raise ValueError(f"{path}: the file needs the extensions {', '.join(missing)}, which are not supported")
    for accessor in header.get("accessors", []):
        if "bufferView" not in accessor:  # zeros, made from nothing
            check_size(path, 16 * int(accessor["count"]), 4096)
            if "sparse" in accessor:
                check_size(path, 16 * int(accessor["sparse"]["count"]), 4096)


def cameras_and_lights(header: dict[str, Any], name: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The cameras and lights of the file's scene as dicts for ``load_dict``, in the order of its nodes.

    Photometric numbers are taken as they are: candela as radiant intensity, lux as irradiance. What is not supported is
    replaced or left out with a `SubstitutionWarning`.
    """
    lights = header.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    found: tuple[list[dict[str, Any]], list[dict[str, Any]]] = ([], [])
    for node, matrix in _placed(header):
        if "camera" in node:
            made = _camera(header["cameras"][node["camera"]], matrix, name)
            found[0].extend([made] if made else [])
        extension = node.get("extensions", {}).get("KHR_lights_punctual")
        if extension is not None:
            made = _light(lights[extension["light"]], matrix, name)
            found[1].extend([made] if made else [])
    return found


def _placed(header: dict[str, Any]) -> list[tuple[dict[str, Any], np.ndarray]]:
    """All nodes of the scene with their matrices to the world."""
    nodes = header.get("nodes", [])
    scenes = header.get("scenes", [])
    roots = scenes[header.get("scene", 0)].get("nodes", []) if scenes else []
    result, waiting = [], [(index, np.eye(4)) for index in reversed(roots)]
    while waiting:
        index, parent = waiting.pop()
        if len(result) > min(_MAX_NODES, len(nodes)):
            raise ValueError("the nodes of the scene are no tree")
        node = nodes[index]
        matrix = parent @ _matrix(node)
        result.append((node, matrix))
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
    return result


def _matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _turned(matrix: np.ndarray) -> np.ndarray:
    """The place and directions of a camera or spot, which scaling of its node does not change."""
    rigid = matrix.copy()
    rigid[:3, :3] /= np.linalg.norm(rigid[:3, :3], axis=0)
    return rigid @ _TURN


def _camera(camera: dict[str, Any], matrix: np.ndarray, name: str) -> dict[str, Any] | None:
    kind = camera.get("type")
    if kind not in ("perspective", "orthographic"):
        _say(f"{name}: the camera {camera.get('name', kind)!r} is {kind} and was left out")
        return None
    lens = camera[kind]
    sensor: dict[str, Any] = {"type": kind, "to_world": _turned(matrix)}
    if kind == "perspective":
        aspect = lens.get("aspectRatio", 1.0)
        sensor |= {"fov": math.degrees(lens["yfov"]), "fov_axis": "y"}
    else:
        across, up = abs(float(lens["xmag"])), abs(float(lens["ymag"]))  # half of what is seen
        aspect = across / up
        sensor["to_world"] = sensor["to_world"] @ np.diag([across, across, 1.0, 1.0])
    width = max(1, round(HEIGHT * aspect))
    if width > _MAX_WIDTH:
        raise ValueError(f"a camera {aspect:g} times as wide as high")
    sensor["film"] = {"type": "hdrfilm", "width": width, "height": HEIGHT}
    for theirs, ours in (("znear", "near_clip"), ("zfar", "far_clip")):
        if theirs in lens:
            sensor[ours] = float(lens[theirs])
    return sensor


def _light(light: dict[str, Any], matrix: np.ndarray, name: str) -> dict[str, Any] | None:
    kind = light["type"]
    power = [float(c) * float(light.get("intensity", 1.0)) for c in light.get("color", (1.0, 1.0, 1.0))]
    colour = {"type": "rgb", "value": power}
    if kind == "directional":
        return {"type": kind, "irradiance": colour, "direction": (-matrix[:3, 2]).tolist()}
    if kind == "spot":
        cone = light.get("spot", {})
        outer, inner = cone.get("outerConeAngle", math.pi / 4), cone.get("innerConeAngle", 0.0)
        angles = {"cutoff_angle": math.degrees(outer), "beam_width": math.degrees(inner)}
        return {"type": kind, "intensity": colour, "to_world": _turned(matrix), **angles}
    if kind == "point":
        return {"type": "point", "intensity": colour, "position": matrix[:3, 3].tolist()}
    _say(f"{name}: the light {light.get('name', kind)!r}: {kind!r} is not supported and was left out")
    return None


def _say(text: str) -> None:
    warnings.warn(text, SubstitutionWarning, stacklevel=2)
