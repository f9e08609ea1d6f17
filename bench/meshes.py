"""A mesh of as many triangles as asked for."""

from __future__ import annotations

import math

import numpy as np


def bumpy_sphere(triangles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sphere of about radius 1 with bumps: positions (V, 3), faces (F, 3), normals (V, 3), F about `triangles`.

    A grid of longitudes and twice as many triangles as vertices; its surface does not depend on their number.
    """
    rows = max(3, math.isqrt(triangles // 4) + 1)
    columns = 2 * rows
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns, endpoint=False), indexing="ij"
    )
    bumps = np.sin(7 * phi) * np.sin(9 * theta) * np.sin(theta) ** 2  # none at the poles
    radius = 1 + 0.08 * bumps
    direction = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    vertices = (radius[..., None] * direction).reshape(-1, 3)
    here = np.arange(rows)[:, None] * columns + np.arange(columns)
    right = np.arange(rows)[:, None] * columns + (np.arange(columns) + 1) % columns
    below, across = here + columns, right + columns
    upper = np.stack([here, right, across], -1)[1:]  # the first row's would have no area
    lower = np.stack([here, across, below], -1)[:-1]  # the last row's neither
    faces = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    normals = np.zeros_like(vertices)
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for k in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, k], areas[:, axis], len(vertices))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.maximum(lengths, 1e-30), direction.reshape(-1, 3))
    return vertices.astype(np.float32), faces.astype(np.int32), normals.astype(np.float32)
