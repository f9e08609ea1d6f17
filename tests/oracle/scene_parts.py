"""Shapes and materials of the scenes that the oracle renders."""

from __future__ import annotations

import copy

import numpy as np
import reference_scenes as r

import torchrender as tr

SIZE = 8
MIRROR = r.scale(-1, 1, 1)


def small(scene: dict) -> dict:
    """A reference scene with a film of 8 x 8 pixels."""
    scene = copy.deepcopy(scene)
    film = scene["sensor"]["film"]
    if "crop_width" in film:
        film.update(width=12, height=10, crop_offset_x=2, crop_offset_y=1, crop_width=SIZE, crop_height=SIZE)
    else:
        film.update(width=SIZE, height=SIZE)
    return scene


def tube(rows: int = 4, columns: int = 6, **more) -> tr.Mesh:
    vertices, normals, colours, faces, face_colours = r.twisted_mesh(rows, columns)
    attributes = {"vertex_color": colours, "face_color": face_colours}
    texcoords = np.stack([vertices[:, 0] * 0.4 + vertices[:, 2], vertices[:, 1]], 1)
    return tr.Mesh(vertices, faces, vertex_normals=normals, vertex_texcoords=texcoords, attributes=attributes, **more)


def hills(seed: int, **more) -> dict:
    heights = np.random.default_rng(seed).uniform(0, 0.3, (5, 4))
    return {"type": "heightfield", "heights": heights, **more}


def distances(seed: int, **more) -> dict:
    """A dented ball, as a grid whose numbers are off by chance."""
    random = np.random.default_rng(seed)
    z, y, x = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in (5, 6, 7)), indexing="ij")
    grid = np.sqrt(x * x + y * y + z * z) - 0.35 + random.uniform(-0.03, 0.03, x.shape)
    return {"type": "sdfgrid", "grid": grid[..., None], **more}


def smoothed(mesh: tr.Mesh) -> tr.Mesh:
    """The mesh with normals that follow its positions, as one from a file without normals has."""
    mesh.compute_normals()
    return mesh


def metal(seed: int, alpha: float = 0.4) -> dict:
    reflectance = r._bitmap(seed, 3, 3)
    return {"type": "roughconductor", "alpha": alpha, "distribution": "ggx", "specular_reflectance": reflectance}


def bumps(seed: int, lowest: float = 0.6, **more) -> dict:
    """A map of rough normals of any length, some of which hide from the viewer."""
    texels = np.random.default_rng(seed).uniform([0, 0, lowest], 1, (4, 5, 3))
    return {"type": "bitmap", "data": texels.astype(np.float32), "raw": True, **more}
