"""Shapes of type ``ply``, ``obj`` and ``serialized``: meshes that are read from files."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import depth_outside, nearest
from ..scene import values
from ..scene.context import Context, Reference
from ..scene.mesh import Mesh
from ..scene.plugin import Plugin
from ..scene.registry import accepted_names, builder, scene_types
from ..scene.shapes import SILHOUETTE

FILE_NAMES = ("filename", "face_normals", "flip_tex_coords", "flip_normals", "to_world", "bsdf", "emitter")
FILE_NAMES += ("interior", "exterior", *SILHOUETTE)


def _mesh_from_file(kind: str, properties: dict[str, Any], ctx: Context) -> Plugin:
    from . import geometry  # when the first file is read: that imports much

    for name, value in properties.items():
        nested = isinstance(value, Plugin) or (isinstance(value, Mapping) and "type" in value)
        if name not in accepted_names(kind) and not nested:
            ctx.error(f"{kind} has no parameter {name!r}; {nearest(name, accepted_names(kind))}")
    if "filename" not in properties:
        ctx.error(f"{kind}: 'filename' is missing")
    path = ctx.at("filename").file(properties.pop("filename"))
    face_normals = values.boolean(properties.get("face_normals", False), ctx.at("face_normals"))
    flip = properties.pop("flip_tex_coords", kind == "obj")
    flip = values.boolean(flip, ctx.at("flip_tex_coords"))
    index = values.integer(properties.pop("shape_index", 0), ctx.at("shape_index"), 0)
    with ctx.at("filename").located():
        if path.suffix.lower() != f".{kind}":
            raise ValueError(f"{path}: a shape of type {kind} is a file that ends in .{kind}")
        loaded = geometry.load_mesh(path, face_normals=face_normals, flip_tex_coords=flip, shape_index=index)
    has_bsdf = any(_category(value) in ("bsdf", None) for value in properties.values())
    if loaded.get("face_normals"):
        properties["face_normals"] = face_normals = True
    vertices = values.floating(loaded["vertices"], ctx.at("filename"))
    mesh = Mesh(
        vertices=vertices,
        faces=loaded["faces"],
        vertex_normals=None if face_normals else loaded.get("vertex_normals"),
        vertex_texcoords=loaded.get("vertex_texcoords"),
        attributes=loaded.get("attributes"),
        _context=ctx,
        **properties,
    )
    if loaded.get("vertex_normals") is None and not face_normals:
        # A file without normals is shaded smooth, with normals that follow the positions from now on.
        mesh.compute_normals()
    if kind == "obj" and not has_bsdf and _has_materials(path):
        warnings.warn(
            f"{ctx.where}: a shape of type obj has no materials but the bsdf that it is given, as in Mitsuba: those of "
            f"{path.name} are left out. load_file({path.name!r}) makes a scene with them",
            UserWarning,
            stacklevel=depth_outside(),
        )
    return mesh


def _category(value: Any) -> str | None:
    """Of a nested object; None of a reference, which is not looked up yet."""
    if isinstance(value, Mapping):
        kind = value.get("type")
        return None if kind == "ref" else scene_types().get(str(kind), "")
    return None if isinstance(value, Reference) else getattr(value, "category", "")


def _has_materials(path: Path) -> bool:
    """Whether an OBJ file uses materials of a library that is there."""
    content = path.read_bytes()
    libraries = re.findall(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t]*\r?$", content, re.MULTILINE)
    used = re.search(rb"^[ \t]*usemtl[ \t]", content, re.MULTILINE)
    return used is not None and any((path.parent / name.decode("utf-8", "replace")).is_file() for name in libraries)


@builder("ply", "shape", FILE_NAMES)
def _ply(properties: dict[str, Any], ctx: Context) -> Plugin:
    return _mesh_from_file("ply", properties, ctx)


@builder("obj", "shape", FILE_NAMES)
def _obj(properties: dict[str, Any], ctx: Context) -> Plugin:
    return _mesh_from_file("obj", properties, ctx)


@builder("serialized", "shape", (*(n for n in FILE_NAMES if n != "flip_tex_coords"), "shape_index"))
def _serialized(properties: dict[str, Any], ctx: Context) -> Plugin:
    return _mesh_from_file("serialized", properties, ctx)
