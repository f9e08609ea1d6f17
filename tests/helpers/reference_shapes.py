"""Reference scenes of shapes and textures, see `reference_scenes.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from reference_parts import (
    DATA,
    PATH5,
    TO_UV,
    ReferenceScene,
    _bitmap,
    _camera,
    _diffuse,
    _floor,
    _lamp,
    _rgb,
    _scene,
    rotate,
    scale,
    translate,
)


def _shapes() -> ReferenceScene:
    """Every analytic shape, with textures on their own coordinates, lit by a point and a constant light."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={
                "type": "sphere",
                "center": [-1.1, -0.2, 0.3],
                "radius": 0.7,
                "bsdf": _diffuse(_bitmap(1, 8, 16)),
            },
            box={
                "type": "cube",
                "to_world": translate(1.0, -0.4, -0.2) @ rotate("y", 30) @ scale(0.5, 0.6, 0.5),
                "bsdf": _diffuse(_bitmap(2, 4, 4)),
            },
            plate={
                "type": "disk",
                "to_world": translate(0.1, 0.5, -1.0) @ scale(0.9, 0.6, 1.0),
                "bsdf": _diffuse(_bitmap(3, 6, 6)),
            },
            floor=_floor({"type": "checkerboard", "color0": 0.7, "color1": _rgb(0.2, 0.1, 0.3), "to_uv": TO_UV}),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
        (
            "ball.bsdf.reflectance.data",
            "box.bsdf.reflectance.data",
            "plate.bsdf.reflectance.data",
            "floor.bsdf.reflectance.color1.value",
            "bulb.intensity.value",
            "sky.radiance.value",
        ),
    )


def _bitmaps() -> ReferenceScene:
    """Bitmap filters and wrap modes with a texture transformation, on five squares facing the camera."""
    modes = [("bilinear", "repeat"), ("bilinear", "mirror"), ("bilinear", "clamp"), ("nearest", "mirror")]
    objects = {}
    for i, (filter_type, wrap_mode) in enumerate(modes):
        objects[f"square{i}"] = {
            "type": "rectangle",
            "to_world": translate(-0.9 + 1.8 * (i % 2), -0.9 + 1.8 * (i // 2), 0.0) @ scale(0.85),
            "bsdf": _diffuse(_bitmap(10 + i, 4, 5, filter_type=filter_type, wrap_mode=wrap_mode, to_uv=TO_UV)),
        }
    sky = {"type": "constant", "radiance": _rgb(1.0, 1.0, 1.0)}
    names = tuple(f"square{i}.bsdf.reflectance.data" for i in range(4))
    return ReferenceScene(
        _scene({"type": "path", "max_depth": 2}, _camera((0, 0, 5)), **objects, sky=sky), (*names, "sky.radiance.value")
    )


def _mesh() -> ReferenceScene:
    """A PLY mesh with smooth normals, vertex and face colours, and one without normals; a tent filter of radius 1.5."""
    twisted = str(DATA / "twisted.ply")
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(film={"rfilter": {"type": "tent", "radius": 1.5}}),
            left={
                "type": "ply",
                "filename": twisted,
                "to_world": translate(-1.0, -0.1, 0.0) @ rotate("y", 20),
                "bsdf": _diffuse({"type": "mesh_attribute", "name": "vertex_color"}),
            },
            right={
                "type": "ply",
                "filename": twisted,
                "face_normals": True,
                "to_world": translate(1.0, -0.1, 0.0) @ rotate("y", -40),
                "bsdf": {
                    "type": "twosided",
                    "bsdf": _diffuse({"type": "mesh_attribute", "name": "face_color", "scale": 0.8}),
                },
            },
            floor=_floor(0.5),
            lamp=_lamp(_rgb(8.0, 8.0, 8.0)),
            sky={"type": "constant", "radiance": 0.2},
        ),
        ("left.vertex_color", "right.face_color"),
    )


def _cylinders() -> ReferenceScene:
    """Open tubes: one textured, one turned and stretched by its matrix and mirrored, one that emits inwards."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera((0.5, 1.5, 5.0)),
            pipe={
                "type": "cylinder",
                "p0": [-1.3, -0.9, 0.4],
                "p1": [-0.5, 0.6, -0.2],
                "radius": 0.4,
                "bsdf": {"type": "twosided", "bsdf": _diffuse(_bitmap(81, 6, 12))},
            },
            tube={
                "type": "cylinder",
                "radius": 0.5,
                "to_world": translate(0.9, -0.5, 0.2) @ rotate("y", 25) @ rotate("x", -70) @ scale(-0.8, 0.8, 1.4),
                "bsdf": {"type": "twosided", "bsdf": _diffuse(_bitmap(82, 4, 6))},
            },
            lamp={
                "type": "cylinder",
                "p0": [0.1, 1.0, 0.0],
                "p1": [0.4, 1.3, 0.6],
                "radius": 0.2,
                "flip_normals": True,
                "emitter": {"type": "area", "radiance": _rgb(9.0, 6.0, 4.0)},
            },
            bar={
                "type": "cylinder",
                "p0": [-0.9, 1.1, 0.0],
                "p1": [-0.2, 1.3, 0.0],
                "radius": 0.05,
                "emitter": {"type": "area", "radiance": _rgb(6.0, 5.0, 7.0)},
            },
            floor=_floor(0.6),
            sky={"type": "constant", "radiance": _rgb(0.1, 0.12, 0.15)},
        ),
        (
            "pipe.bsdf.brdf_0.reflectance.data",
            "tube.bsdf.brdf_0.reflectance.data",
            "lamp.emitter.radiance.value",
            "bar.emitter.radiance.value",
        ),
    )


def _volume_texture() -> ReferenceScene:
    """A grid of colours carved by a ball and a floor, voxels of another under a plate, and a volume without a grid."""

    def grid(seed: int, *matrices: np.ndarray, **more) -> dict:
        data = np.random.default_rng(seed).uniform(0.1, 0.9, (4, 5, 6, 3)).astype(np.float32)
        to_world = np.linalg.multi_dot([np.eye(4), *matrices])
        return {"type": "gridvolume", "data": data, "raw": True, "to_world": to_world, **more}

    turned = translate(-1.6, -1.1, -1.2) @ rotate("y", 20)
    carved = {"type": "volume", "volume": grid(84, turned, scale(2.8, 2.2, 2.6))}
    voxels = {"type": "volume", "volume": grid(85, translate(0.2, -0.5, -1.0), scale(0.9), filter_type="nearest")}
    wrapped = {"type": "volume", "volume": grid(86, scale(0.7), wrap_mode="mirror")}
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={"type": "sphere", "center": [-0.6, -0.1, 0.2], "radius": 0.8, "bsdf": _diffuse(carved)},
            plate={
                "type": "disk",
                "to_world": translate(0.9, 0.1, -0.3) @ scale(0.7, 0.5, 1.0),
                "bsdf": _diffuse(voxels),
            },
            box={
                "type": "cube",
                "to_world": translate(1.0, -0.7, 0.6) @ rotate("y", 30) @ scale(0.3),
                "bsdf": _diffuse(wrapped),
            },
            floor=_floor({"type": "volume", "volume": {"type": "constvolume", "value": 0.4}}),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
        (
            "ball.bsdf.reflectance.volume.data",
            "plate.bsdf.reflectance.volume.data",
            "box.bsdf.reflectance.volume.data",
        ),
    )


def _instances() -> ReferenceScene:
    """A group of a cube and a ball, three times: turned, mirrored, stretched; and one of a single mesh."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            pair={
                "type": "shapegroup",
                "box": {"type": "cube", "to_world": scale(0.3), "bsdf": _diffuse(_bitmap(87, 4, 4))},
                "ball": {
                    "type": "sphere",
                    "center": [0.0, 0.55, 0.0],
                    "radius": 0.25,
                    "bsdf": _diffuse(_bitmap(88, 4, 8)),
                },
            },
            block={
                "type": "shapegroup",
                "cube": {"type": "cube", "to_world": scale(0.25), "bsdf": _diffuse(_rgb(0.7, 0.3, 0.2))},
            },
            left={
                "type": "instance",
                "to_world": translate(-1.1, -0.6, 0.2) @ rotate("y", 30),
                "group": {"type": "ref", "id": "pair"},
            },
            right={
                "type": "instance",
                "to_world": translate(1.0, -0.5, 0.0) @ scale(-1.3, 1.3, 1.3) @ rotate("y", -20),
                "group": {"type": "ref", "id": "pair"},
            },
            slab={
                "type": "instance",
                "to_world": translate(0.0, 0.4, -0.6) @ rotate("z", 30) @ scale(2.0, 0.5, -1.0),
                "group": {"type": "ref", "id": "block"},
            },
            floor=_floor(0.5),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
    )


def twisted_mesh(rows: int = 8, columns: int = 12):
    """A twisted, bulging tube: vertices, normals, vertex colours (V, 3), faces (F, 3), face colours (F, 3)."""
    vertices, faces = [], []
    for j in range(rows + 1):
        for i in range(columns):
            height = 2 * j / rows - 1
            angle = 2 * np.pi * i / columns + 0.8 * height
            radius = 0.6 + 0.15 * np.cos(3 * height) + 0.1 * np.cos(2 * angle)
            vertices.append((radius * np.cos(angle), 0.8 * height, radius * np.sin(angle)))
    for j in range(rows):
        for i in range(columns):
            a, b = j * columns + i, j * columns + (i + 1) % columns
            c, d = a + columns, b + columns
            faces += [(a, c, b), (b, c, d)]
    vertices, faces = np.array(vertices), np.array(faces)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], cross)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rng = np.random.default_rng(20)
    return vertices, normals, rng.uniform(0.1, 0.9, vertices.shape), faces, rng.uniform(0.1, 0.9, faces.shape)


def write_twisted_mesh(path: Path) -> None:
    """Write `twisted_mesh()` as a binary PLY whose colours Mitsuba and torchrender read as mesh attributes."""
    vertices, normals, colours, faces, face_colours = twisted_mesh()
    rows = np.concatenate([vertices, normals, colours], axis=1).astype("<f4")
    corners = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", 3), ("c", "<f4", 3)])
    corners["n"], corners["i"], corners["c"] = 3, faces, face_colours
    vertex_names = ["x", "y", "z", "nx", "ny", "nz", "color_0", "color_1", "color_2"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in vertex_names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += [f"property float color_{i}" for i in range(3)] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes() + corners.tobytes())
