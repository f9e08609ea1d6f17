"""Around meshes that an optimiser moves: views from all sides, pictures on a turntable, refinement, distances."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
import trimesh

import torchrender as tr


def directions(count: int, turned: float = 0.0) -> torch.Tensor:
    """`count` unit vectors (count, 3), evenly on a sphere (a Fibonacci lattice), `turned` by an angle about y."""
    number = torch.arange(count) + 0.5
    height, angle = 1 - 2 * number / count, math.pi * (3 - math.sqrt(5)) * number + turned
    radius = (1 - height.square()).sqrt()
    return torch.stack([radius * torch.sin(angle), height, radius * torch.cos(angle)], dim=1)


def cameras(places: torch.Tensor, resolution: int, fov: float) -> list[tr.PerspectiveCamera]:
    """Cameras at `places` (N, 3) that look at the origin, square films with a box filter, `fov` in degrees."""
    size = (resolution, resolution)
    return [tr.PerspectiveCamera.look_at(p, (0.0, 0.0, 0.0), fov=fov, size=size, filter="box") for p in places.tolist()]


def turntable(
    scene: tr.Scene, resolution: int, *, count: int = 8, distance: float = 4.5, fov: float = 36.0, spp: int = 16
) -> torch.Tensor:
    """`count` pictures beside each other (H, count * H, 3), from around the object and from a little above."""
    angle = 2 * math.pi / count * torch.arange(count)
    height = torch.full_like(angle, math.sin(math.radians(15)))
    around = math.cos(math.radians(15))
    places = distance * torch.stack([around * torch.sin(angle), height, around * torch.cos(angle)], dim=1)
    with torch.no_grad():
        images = tr.render(scene, sensor=cameras(places, resolution, fov), spp=spp, seed=0)
    return torch.cat(list(images), dim=1)


def subdivide(vertices: torch.Tensor, faces: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Every triangle as four of them, the new vertices in the middles of edges; positions (V, 3), faces (F, 3)."""
    finer, corners = trimesh.remesh.subdivide(vertices.detach().double().numpy(), faces.numpy())[:2]
    return torch.from_numpy(finer).to(vertices.dtype), torch.from_numpy(np.asarray(corners)).long()


def points_outside(vertices: torch.Tensor, faces: torch.Tensor, count: int, eyes: torch.Tensor) -> np.ndarray:
    """Of `count` points evenly on a mesh those that are seen from one of the `eyes` (N, 3): what is hidden inside, no
    picture can tell."""
    mesh = trimesh.Trimesh(vertices.detach().double().numpy(), faces.numpy(), process=False)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=0)
    scene = tr.load_dict({"type": "scene", "shape": tr.Mesh(vertices.detach(), faces)})
    start = torch.from_numpy(np.asarray(points)).float()
    seen = torch.zeros(len(points), dtype=torch.bool)
    for eye in eyes:
        ray = eye - start
        normal = torch.from_numpy(mesh.face_normals[face]).float()
        # from a little above the surface, on the side of the eye
        above = start + 1e-4 * normal * (normal * ray).sum(1, keepdim=True).sign()
        seen |= ~tr.ray_occluded(scene, above, eye - above, tmax=1.0)
    return np.asarray(points)[seen.numpy()]


def chamfer(found: np.ndarray, true: np.ndarray) -> float:
    """The mean distance of points (N, 3) from the nearest ones of the other set, mean over both directions, as a part
    of the diagonal of the true ones' bounding box."""
    from scipy.spatial import KDTree

    there, back = KDTree(true).query(found)[0].mean(), KDTree(found).query(true)[0].mean()
    return float((there + back) / 2 / np.linalg.norm(np.ptp(true, axis=0)))


def write_ply(path: Path, vertices: torch.Tensor, faces: torch.Tensor) -> None:
    """Write a mesh (V, 3), (F, 3) as a binary PLY file."""
    trimesh.Trimesh(vertices.detach().double().numpy(), faces.numpy(), process=False).export(path)
