"""A scene as plain arrays, for renderers that cannot read its file: what `redner_server.py` takes.

Only what the five scenes consist of: meshes and rectangles, diffuse, one-sided or two-sided, with constant or bitmap
colours, area lights, a constant sky, one perspective camera without a principal point.

The .npz file holds ``to_world`` (4, 4) of the camera, ``fov`` (degrees, along x), and for shape i ``i.vertices``
(V, 3), ``i.faces`` (F, 3), ``i.normals`` (V, 3) and ``i.uv`` (V, 2) where there are any, ``i.colour`` (3,) or
(H, W, 3), ``i.parameter`` (that colour's name), ``i.two_sided``, ``i.name``, and ``i.radiance`` (3,) of lights; ``sky``
(3,) is the radiance of a sky.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import torchrender as tr

from .peers import KNOWN, Peer
from .rows import Row


def rectangle(to_world: np.ndarray) -> dict[str, np.ndarray]:
    """The square [-1, 1]^2 in z = 0, facing +z, moved by a matrix (4, 4)."""
    corners = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return {"vertices": (corners @ to_world.T)[:, :3], "faces": faces, "uv": (corners[:, :2] + 1) / 2}


def _shape_arrays(name: str, shape: Any, names: dict[int, str]) -> dict[str, Any]:
    """The arrays of one shape; `names` are those of parameters by identity."""
    if shape.type == "mesh":
        found = {"vertices": shape.vertex_positions, "faces": shape.faces}
        if shape.vertex_normals is not None and not shape.face_normals:
            found["normals"] = shape.vertex_normals
        if shape.vertex_texcoords is not None:
            found["uv"] = shape.vertex_texcoords
        found = {key: value.detach().numpy() for key, value in found.items()}
    elif shape.type == "rectangle":
        found = rectangle(shape.to_world.detach().numpy())
    else:
        raise ValueError(f"{name}: expected a mesh or a rectangle, got {shape.type!r}")
    two_sided = shape.bsdf.type == "twosided"
    leaf = shape.bsdf.brdf_0 if two_sided else shape.bsdf
    if leaf.type != "diffuse":
        raise ValueError(f"{name}.bsdf: expected diffuse or twosided diffuse, got {leaf.type!r}")
    texture = leaf.reflectance
    colour = texture.data if texture.type == "bitmap" else texture.value
    found["colour"] = colour.detach().numpy()
    found["parameter"] = np.array(names[id(colour)])
    found["two_sided"] = np.array(two_sided)
    if shape.emitter is not None:
        found["radiance"] = shape.emitter.radiance.value.detach().numpy()
    return found


def arrays_of(scene: tr.Scene) -> dict[str, np.ndarray]:
    """The arrays of a scene, by the names above. ValueError names a shape that this format has no place for."""
    names = {id(value): name for name, value in scene.named_parameters()}
    (camera,) = scene.sensors
    found: dict[str, Any] = {"to_world": camera.to_world.detach().numpy(), "fov": camera.x_fov.detach().numpy()}
    shapes = [(name, child) for name, child in scene.named_children() if getattr(child, "category", "") == "shape"]
    for i, (name, shape) in enumerate(shapes):
        found.update({f"{i}.{key}": value for key, value in _shape_arrays(name, shape, names).items()})
        found[f"{i}.name"] = np.array(name)
    for _, child in scene.named_children():
        if getattr(child, "category", "") == "emitter":
            if child.type != "constant":
                raise ValueError(f"expected area lights and a constant sky, got {child.type!r}")
            found["sky"] = child.radiance.value.detach().numpy()
    return found


def load_peer(peer: Peer, row: Row, resolution: int, spp: int, **more: Any) -> None:
    """Let a peer load a row's scene, from its file or from arrays; `more` are further words of the request."""
    settings: dict[str, Any] = {"resolution": resolution, "spp": spp, "arrays": None, **more}
    settings |= {"path": row.path, "arguments": row.arguments, "parameters": list(row.parameters)}
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        if KNOWN[peer.name].reads_arrays:
            settings["arrays"] = str(Path(folder) / "scene.npz")
            np.savez(settings["arrays"], **arrays_of(tr.load_file(row.path, **row.arguments)))
        peer.ask("load", **settings)
