"""Geometry files: single meshes for shapes of type ``ply`` and ``obj``, and whole scenes through trimesh."""

from __future__ import annotations

import io
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import describe
from ..io._files import existing_file, reading
from ..transform import Transform
from . import gltf
from .materials import Materials, identifier, two_sided
from .mtl import load_obj
from .neighbours import files_of
from .obj import read_obj
from .ply import PlyElement, read_ply
from .serialized import read_serialized

_POSTFIX = re.compile(r"(?:(.*)_)?(x|y|z|w|r|g|b|a|[0-4])\Z")
_COLOURS = {"red": "r", "green": "g", "blue": "b", "alpha": "a"}
_RESERVED = {"x", "y", "z", "nx", "ny", "nz"}


def load_mesh(
    path: str | os.PathLike[str],
    *,
    face_normals: bool = False,
    flip_tex_coords: bool | None = None,
    shape_index: int = 0,
) -> dict[str, Any]:
    """Read one mesh from a PLY, OBJ or serialized file, as it is there: nothing is welded, removed or reordered.

    Args:
        path: a ``.ply``, ``.obj`` or ``.serialized`` file. Polygons become fans of triangles. A vertex of an OBJ file
            is a distinct combination of position, texture coordinate and normal; its groups and materials are not
            told apart.
        face_normals: leave out the file's vertex normals.
        flip_tex_coords: replace v by 1 - v. By default this is done for OBJ, whose v runs upwards, and not for others.
        shape_index: which mesh of a ``.serialized`` file, from 0.

    Returns:
        dict with ``vertices`` (V, 3), ``vertex_normals`` (V, 3) of unit length or None, ``vertex_texcoords`` (V, 2) or
        None, in the precision of the file (OBJ: float64); ``faces`` (F, 3) int32; ``face_normals``, if the file asks
        for flat shading; and ``attributes``, the colours of a serialized file or the other properties of a PLY file:
        ``vertex_NAME`` (V, C) and ``face_NAME`` (F, C). Properties r, g, b or red, green, blue are ``color`` (integers
        are divided by their largest value), NAME_r, NAME_g, NAME_b are ``NAME_color``, other NAME_x, NAME_y ... or
        NAME_0, NAME_1 ... are ``NAME``.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is of another kind, truncated or damaged, or refers to vertices that it does not have.
    """
    path = existing_file(path)
    with reading(path):
        return _load_mesh(path, face_normals, flip_tex_coords, shape_index)


def _load_mesh(path: Path, face_normals: bool, flip_tex_coords: bool | None, shape_index: int) -> dict[str, Any]:
    ending = path.suffix.lower()
    if ending not in (".ply", ".obj", ".serialized"):
        raise ValueError(f"{path}: expected a .ply, .obj or .serialized file, got {ending!r}")
    if ending == ".serialized":
        mesh = read_serialized(path, shape_index)
        mesh["attributes"] = {name: torch.from_numpy(data) for name, data in mesh["attributes"].items()}
    else:
        mesh = _from_ply(path) if ending == ".ply" else _from_obj(path)
    flip = ending == ".obj" if flip_tex_coords is None else flip_tex_coords
    if flip and mesh["vertex_texcoords"] is not None:
        mesh["vertex_texcoords"] = mesh["vertex_texcoords"] * [1, -1] + [0, 1]
    if face_normals:
        mesh["vertex_normals"] = None
    elif mesh["vertex_normals"] is not None:
        mesh["vertex_normals"] = _normalized(mesh["vertex_normals"])
    _check(path, mesh)
    dtype = mesh["vertices"].dtype
    for name in ("vertices", "vertex_normals", "vertex_texcoords"):
        if mesh[name] is not None:
            mesh[name] = torch.from_numpy(np.ascontiguousarray(mesh[name], dtype))
    mesh["faces"] = torch.from_numpy(mesh["faces"].astype(np.int32))
    return mesh


def _normalized(vectors: np.ndarray) -> np.ndarray:
    """Rows scaled to unit length; rows of zeros stay, and so do, bit by bit, rows of that length up to rounding."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    done = np.abs(length - 1) <= 4 * np.finfo(length.dtype).eps
    return vectors / np.where((length > 0) & ~done, length, 1)


def _check(path: Path, mesh: dict[str, Any]) -> None:
    vertices, faces = mesh["vertices"], mesh["faces"]
    if len(vertices) == 0 or len(faces) == 0:
        raise ValueError(f"{path}: the mesh is empty: {len(vertices)} vertices, {len(faces)} faces")
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = faces.min() if faces.min() < 0 else faces.max()
        raise ValueError(f"{path}: a face refers to vertex {bad}, but there are {len(vertices)} vertices")
    for name in ("vertices", "vertex_normals", "vertex_texcoords"):
        if mesh[name] is not None and not np.isfinite(mesh[name]).all():
            raise ValueError(f"{path}: {name} has values that are not finite")


def _from_obj(path: Path) -> dict[str, Any]:
    read = read_obj(path)
    names = {"vertices": "vertices", "normals": "vertex_normals", "texcoords": "vertex_texcoords", "faces": "faces"}
    return {**{names[key]: value for key, value in read.items()}, "attributes": {}}


def _from_ply(path: Path) -> dict[str, Any]:
    elements = read_ply(path)
    vertex, face = elements.get("vertex"), elements.get("face")
    if vertex is None or face is None or not {"x", "y", "z"} <= set(vertex.scalars):
        raise ValueError(f"{path}: expected the elements 'vertex' with x, y, z, and 'face'; got {sorted(elements)}")
    if not vertex.count or not face.count:
        raise ValueError(f"{path}: the mesh is empty: {vertex.count} vertices, {face.count} faces")
    name = next((n for n in ("vertex_indices", "vertex_index") if n in face.lists), None)
    if name is None:
        raise ValueError(f"{path}: the element 'face' has no list 'vertex_indices'; it has {face.order}")
    faces, rows = _fans(path, face.data[name].astype(np.int64), face.count)

    def columns(*names: str) -> np.ndarray | None:
        if not set(names) <= set(vertex.scalars):
            return None
        wide = any(vertex.data[n].dtype.itemsize > 4 for n in names)
        return np.stack([vertex.data[n] for n in names], axis=1).astype(np.float64 if wide else np.float32)

    pair = next((pair for pair in (("u", "v"), ("s", "t")) if set(pair) <= set(vertex.scalars)), None)
    attributes = _attributes(path, vertex, "vertex_", _RESERVED | set(pair or ()))
    for key, values in _attributes(path, face, "face_", set()).items():
        attributes[key] = values[torch.from_numpy(rows)]
    return {
        "vertices": columns("x", "y", "z"),
        "faces": faces,
        "vertex_normals": columns("nx", "ny", "nz"),
        "vertex_texcoords": None if pair is None else columns(*pair),
        "attributes": attributes,
    }


def _fans(path: Path, entries: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (F, 3) of polygons given as (row, vertex) pairs, and the polygon that each comes from (F,)."""
    sizes = np.bincount(entries[:, 0], minlength=count)
    if sizes.min() < 3:
        raise ValueError(f"{path}: face {int(sizes.argmin())} has {int(sizes.min())} corners; expected 3 or more")
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    triangles = sizes - 2
    rows = np.repeat(np.arange(count), triangles)
    step = np.arange(rows.size) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    start = first[rows]
    corners = entries[:, 1]
    return np.stack([corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1), rows


def _attributes(path: Path, element: PlyElement, prefix: str, reserved: set[str]) -> dict[str, torch.Tensor]:
    """The properties besides `reserved` by attribute name, each (rows, C) in float32 or float64."""
    groups: dict[str, list[tuple[str, np.ndarray]]] = {}
    for name in element.scalars:
        if name in reserved:
            continue
        match = _POSTFIX.match(_COLOURS.get(name, name))
        base, post = (match[1] or "", match[2]) if match else (name, "")
        if post in ("r", "g", "b", "a") and post:
            base = f"{base}_color" if base else "color"
        groups.setdefault(base or name, []).append((post, element.data[name]))
    result = {}
    for base, columns in groups.items():
        data = [_unit(column) if base.endswith("color") else column for _, column in columns]
        alpha = [column for (post, _), column in zip(columns, data) if post == "a"]
        data = [column for (post, _), column in zip(columns, data) if post != "a"]
        for key, group in ((base, data), (f"{base}_alpha", alpha)):
            if len(group) not in (0, 1, 3):
                warnings.warn(f"{path}: {prefix}{key} has {len(group)} components, not 1 or 3: ignored", stacklevel=5)
            elif group:
                wide = any(column.dtype == np.float64 for column in group)
                stacked = np.stack(group, axis=1).astype(np.float64 if wide else np.float32)
                result[prefix + key.replace(".", "_")] = torch.from_numpy(stacked)
    return result


def _unit(column: np.ndarray) -> np.ndarray:
    """Integer colours as fractions of the largest value of their type."""
    return column / np.float32(np.iinfo(column.dtype).max) if column.dtype.kind in "iu" else column


def load_scene(path: str | os.PathLike[str], trusted: bool = False) -> dict[str, Any]:
    """Read a geometry file as a whole scene that shows it.

    Args:
        path: glTF or GLB, OBJ with MTL, PLY, STL, or whatever else trimesh reads.
        trusted: it may use files outside of its own folder.

    Returns:
        A dict as ``load_dict`` takes it: see :func:`from_trimesh`. A PLY file is read by :func:`load_mesh`. A glTF file
        has all its cameras (``sensor``, ``sensor_1`` ..., 512 pixels high) and the lights of
        KHR_lights_punctual, whose photometric numbers are taken as they are; of KHR_materials_ there are ior, specular,
        transmission, clearcoat, sheen, emissive_strength and unlit, of textures KHR_texture_transform. What else a
        material asks for is named in a `SubstitutionWarning`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is of an unknown kind, truncated or damaged, or holds no triangles.
    """
    path = existing_file(path)
    name = identifier(path.stem, set())
    if path.suffix.lower() == ".ply":
        mesh = load_mesh(path)
        low, high = mesh["vertices"].amin(0), mesh["vertices"].amax(0)
        colour = next((n for n in ("vertex_color", "face_color") if n in mesh["attributes"]), None)
        reflectance: Any = {"type": "rgb", "value": [0.5, 0.5, 0.5]}
        if colour is not None:
            reflectance = {"type": "mesh_attribute", "name": colour}
        shape = {"type": "mesh", **{key: value for key, value in mesh.items() if value is not None}}
        shape["bsdf"] = two_sided(reflectance)
        return {**_surroundings(path, low.double().numpy(), high.double().numpy()), name: shape}
    import trimesh

    if path.suffix.lower()[1:] not in trimesh.available_formats():
        raise ValueError(
            f"{path}: files that end in {path.suffix!r} are not supported; convert it to glTF (.glb), which most "
            "programs write"
        )
    with reading(path):  # trimesh's readers raise whatever they stumble over
        if path.suffix.lower() == ".obj":
            return from_trimesh(load_obj(path, trusted), name=str(path))
        if path.suffix.lower() not in (".gltf", ".glb"):
            loaded = trimesh.load_scene(path, resolver=files_of(path, trusted), process=False)
            return from_trimesh(loaded, name=str(path))
        files = files_of(path, trusted)
        header, content = gltf.read_file(path, files)
        kind = path.suffix.lower()[1:]
        loaded = trimesh.load_scene(io.BytesIO(content), file_type=kind, resolver=files, process=False)
        scene = _from_trimesh(loaded, str(path), header)
        _add_cameras_and_lights(scene, *gltf.cameras_and_lights(header, str(path)))
        return scene


def _add_cameras_and_lights(scene: dict[str, Any], cameras: list[Any], lights: list[Any]) -> None:
    """Put them in place of those that were added for want of any."""
    taken = set(scene)
    if cameras:
        del scene["sensor"]
        taken.remove("sensor")
    if lights:
        scene.pop("light", None)
        taken.discard("light")
    for base, objects in (("sensor", cameras), ("light", lights)):
        for made in objects:
            scene[identifier(base, taken)] = made


def from_trimesh(obj: Any, *, name: str = "trimesh object") -> dict[str, Any]:
    """Turn a ``trimesh.Trimesh`` or ``trimesh.Scene`` into a scene.

    Args:
        obj: the object. Vertex normals that it carries are used; without them it is shaded flat, as it is.
        name: for messages.

    Returns:
        A dict as ``load_dict`` takes it. Each mesh is a shape under its node's name. Materials are two-sided: those of
        glTF ``principled`` where this version has it, with normal maps and opacity where it has ``normalmap`` and
        ``mask``; else diffuse with the base colour or diffuse texture, or the vertex or face colours, else 0.5.
        Emission, with or without a texture, makes an area light. Without a camera in the scene one is added that sees
        everything, 512 x 512 pixels, 40 degrees; without a light, constant light of radiance 1.

    Raises:
        TypeError: if it is neither.
        ValueError: if it holds no triangles.
    """
    return _from_trimesh(obj, name, None)


def _from_trimesh(obj: Any, name: str, header: dict[str, Any] | None) -> dict[str, Any]:
    import trimesh

    if isinstance(obj, trimesh.Trimesh):
        obj = trimesh.Scene(obj)
    if not isinstance(obj, trimesh.Scene):
        hint = "; tr.load_file reads files" if isinstance(obj, (str, os.PathLike)) else ""
        raise TypeError(f"geometry: expected a trimesh.Trimesh or trimesh.Scene, got {describe(obj)}{hint}")
    materials = Materials(name, header)
    shapes: dict[str, Any] = {}
    corners, taken = [], {"type", "integrator", "sensor", "light"}
    for node in obj.graph.nodes_geometry:
        matrix, key = obj.graph[node]
        mesh = obj.geometry[key]
        if not isinstance(mesh, trimesh.Trimesh):
            warnings.warn(f"{name}: {key!r} is a {type(mesh).__name__}, not a mesh: left out", stacklevel=2)
            continue
        if len(mesh.faces) == 0:
            continue
        vertices = np.asarray(mesh.vertices, np.float64)
        if not np.isfinite(vertices).all():
            raise ValueError(f"{name}: {key!r} has vertices that are not finite")
        corners.append(trimesh.transform_points(vertices, matrix))
        shapes[identifier(str(node), taken)] = _shape(mesh, np.asarray(matrix), materials, taken)
    if not shapes:
        raise ValueError(f"{name}: there are no triangles in it")
    points = np.concatenate(corners)
    bright = any("emitter" in shape for shape in shapes.values())
    scene = _surroundings(name, points.min(0), points.max(0), light=not bright)
    if obj.has_camera:
        scene["sensor"] = _camera(obj)
    return {**scene, **materials.bsdfs, **shapes}


def _shape(mesh: Any, matrix: np.ndarray, materials: Any, taken: set[str]) -> dict[str, Any]:
    """One mesh as a dict."""
    shape: dict[str, Any] = {
        "type": "mesh",
        "vertices": torch.tensor(np.asarray(mesh.vertices)),
        "faces": torch.tensor(np.asarray(mesh.faces), dtype=torch.int32),
    }
    if not np.array_equal(matrix, np.eye(4)):
        shape["to_world"] = matrix.astype(np.float64)
    # trimesh computes normals on demand; those that came with the mesh are in its cache already.
    if "vertex_normals" in mesh._cache:
        shape["vertex_normals"] = torch.tensor(_normalized(np.asarray(mesh.vertex_normals, np.float64)))
    uv = getattr(mesh.visual, "uv", None)
    if uv is not None and len(uv) == len(mesh.vertices):
        # trimesh's v runs upwards, the rows of an image downwards.
        shape["vertex_texcoords"] = torch.tensor(np.asarray(uv, np.float64)[:, :2] * [1, -1] + [0, 1])
    return shape | materials.of(mesh, taken)


def _surroundings(where: Any, low: np.ndarray, high: np.ndarray, light: bool = True) -> dict[str, Any]:
    """The scene around a mesh with this bounding box: integrator, camera and light."""
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    if not radius > 0:
        raise ValueError(f"{where}: the geometry is a single point")
    fov = 40.0
    direction = np.array([0.5, 0.35, 1.0]) / np.linalg.norm([0.5, 0.35, 1.0])
    distance = 1.02 * radius / np.sin(np.radians(fov / 2))
    view = Transform.look_at((middle + distance * direction).tolist(), middle.tolist(), [0, 1, 0])
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "near_clip": (distance - radius) / 10,
            "far_clip": 10 * (distance + radius),
            "to_world": np.asarray(view),
            "film": {"type": "hdrfilm", "width": 512, "height": 512},
        },
    }
    if light:
        scene["light"] = {"type": "constant"}
    return scene


def _camera(scene: Any) -> dict[str, Any]:
    """The scene's own camera; trimesh's looks along -z with x to the right, ours along +z with x to the left."""
    width, height = (int(size) for size in scene.camera.resolution)
    return {
        "type": "perspective",
        "fov": float(scene.camera.fov[0]),
        "fov_axis": "x",
        "to_world": np.asarray(scene.camera_transform, np.float64) @ np.diag([-1.0, 1.0, -1.0, 1.0]),
        "film": {"type": "hdrfilm", "width": width, "height": height},
    }
