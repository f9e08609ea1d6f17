"""Inverse problems of shapes: where a body is, and what form it has, from its outlines, its shading and its shadow.

Mitsuba's derivatives of what moves leave lamps at points out, so lamps have areas here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
import trimesh

import torchrender as tr
from tutorials.meshes import directions

from .inverse_task import JUDGE_SEED, Task, Unknown, Values, View, around, as_tensors, camera
from .visibility_scenes import grey, welded

OBJECT = "object"
VERTICES = f"{OBJECT}.vertex_positions"
PROJECTIVE = {"type": "direct_projective"}
DIRECT = {"type": "path", "max_depth": 2, "rr_depth": 100}
POSE = (0.2, -0.35, 0.15, 0.15, -0.1, 0.2)


def posed(pose: torch.Tensor, still: torch.Tensor) -> torch.Tensor:
    """Points (N, 3) turned about z, then y, then x, by angles in radians, and shifted; `pose` has x, y, z of both."""
    axes = pose[:3].diag()
    x, y, z = (tr.rotation.so3_exp(axis) for axis in axes)
    return still @ (x @ y @ z).T + pose[3:]


class BodyTask(Task):
    """Of a mesh that moves."""

    moved: ClassVar[str] = OBJECT

    def _described(self) -> dict[str, Any]:
        return {**super()._described(), "moved": self.moved}

    def _reference(self, targets: torch.Tensor) -> torch.Tensor:
        start = {unknown.name: unknown.start for unknown in self.unknowns}
        return self.picture(self.views[0], as_tensors(start), self.target_spp, 0)


@dataclass
class PoseTask(BodyTask):
    """Six numbers, judged by where the vertices are; the object of the scene is where none of them moves it."""

    kind: ClassVar[str] = "pose"

    def _truth(self) -> Values:
        self.still = self.scene.get_parameter(VERTICES).detach().clone()
        self.true = posed(torch.tensor(POSE), self.still)
        return {"pose": torch.tensor(POSE)}

    def params_of(self, values: Values) -> Values:
        return {VERTICES: posed(values["pose"], self.still)}

    def error(self, found: dict[str, np.ndarray]) -> float:
        """Root mean square distance of the vertices from where they are, relative to the body's diagonal."""
        apart = posed(torch.from_numpy(found["pose"]).float(), self.still) - self.true
        size = (self.still.amax(0) - self.still.amin(0)).norm()
        return float(apart.square().sum(1).mean().sqrt() / size)


@dataclass
class MeshTask(BodyTask):
    """The vertices of a mesh, judged by its masks from places that no given picture was taken from.

    The scene has the mesh with which the search begins.

    Args:
        true: the same scene with the true one.
    """

    true: tr.Scene | None = None
    kind: ClassVar[str] = "mesh"

    def _truth(self) -> Values:
        self.true_renderer = tr.Renderer(self.true)
        return {}  # the true mesh has other vertices

    def renderer_of(self, values: Values) -> tr.Renderer:
        """Where there are no vertices, of the true mesh."""
        return self.renderer if values else self.true_renderer

    def _judged(self, values: Values) -> torch.Tensor:
        masks = [self.picture(view, values, self.judge_spp, JUDGE_SEED, outputs=("alpha",)) for view in self.held_out]
        return torch.stack([mask.alpha for mask in masks])

    def error(self, found: dict[str, np.ndarray]) -> float:
        """1 - intersection / union of all held-out masks, whose pixels are shares."""
        masks = self._judged(as_tensors(found))
        both, either = torch.minimum(masks, self.judged).sum(), torch.maximum(masks, self.judged).sum()
        return 1 - float(both / either)

    def _targets(self) -> torch.Tensor:
        views = [view.sensor for view in self.views]
        with torch.no_grad():
            return self.true_renderer(sensor=views, seed=0, spp=self.target_spp, sampler="sobol")


def smooth_mesh(vertices: torch.Tensor, faces: torch.Tensor, bsdf: dict[str, Any]) -> tr.Mesh:
    mesh = tr.Mesh(vertices, faces, bsdf=bsdf)
    mesh.compute_normals()  # smooth, and they follow the vertices
    return mesh


def sphere(subdivisions: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices and faces of an icosahedron that is divided so many times, of the radius 1."""
    made = trimesh.creation.icosphere(subdivisions)
    return torch.from_numpy(made.vertices.copy()).float(), torch.from_numpy(made.faces.copy()).long()


def pose(quick: bool) -> Task:
    """The monkey's pose from one picture of it and of its shadow on a wall; an ellipsoid's if it is to be small."""
    resolution = 24 if quick else 128
    vertices, faces = sphere(2)
    body = (vertices * torch.tensor([1.0, 0.7, 0.4]), faces) if quick else welded("monkey")
    lamp = {"type": "area", "radiance": 60.0}
    black = {"type": "diffuse", "reflectance": 0.0}
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": DIRECT,
            "view": camera((0.0, 0.0, 6.0), 44, resolution, (0.4, -0.4, 0.0)),
            OBJECT: smooth_mesh(*body, grey(0.5)),
            "wall": {
                "type": "rectangle",
                "to_world": tr.Transform.translate([0, 0, -2]) @ tr.Transform.scale(6),
                "bsdf": {"type": "diffuse", "reflectance": 0.7},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": tr.Transform.look_at([-3, 4, 6], [0, 0, 0], [0, 1, 0]) @ tr.Transform.scale(0.7),
                "bsdf": black,
                "emitter": lamp,
            },
        }
    )
    judge = camera(around(50, 25, 6.0), 44, resolution)
    unknowns = [Unknown("pose", np.zeros(6, np.float32), low=-math.pi, high=math.pi)]
    return PoseTask(scene, unknowns, [View(0)], [View(judge)], PROJECTIVE, target_spp=1024)


def soft_sky(height: int = 32) -> torch.Tensor:
    """A sky without edges, which lights every side differently: (height, 2 height, 3)."""
    v = (torch.arange(height) + 0.5) / height * math.pi
    u = (torch.arange(2 * height) + 0.5) / height * math.pi
    towards = torch.stack(
        [v.sin()[:, None] * u.cos(), v.cos()[:, None].expand(-1, 2 * height), v.sin()[:, None] * u.sin()], 2
    )
    sky = torch.full((height, 2 * height, 3), 0.15)
    lights = [((1, 1, 1), (1.6, 1.2, 0.8)), ((-1, 0.5, 0.3), (0.3, 0.6, 1.2)), ((0.2, -1, -0.6), (0.5, 0.9, 0.4))]
    for place, colour in lights:
        place = torch.nn.functional.normalize(torch.tensor(place, dtype=torch.float32), dim=0)
        sky += torch.exp(4 * (towards @ place - 1))[..., None] * torch.tensor(colour)
    return sky


def monkey(quick: bool) -> Task:
    """A sphere becomes the monkey, by 16 pictures around it."""
    resolution, subdivisions, count = (24, 3, 4) if quick else (128, 5, 16)
    distance, fov = 4.5, 36
    vertices, faces = sphere(subdivisions)

    def views(number: int, turned: float) -> Sequence[tr.PerspectiveCamera]:
        places = distance * directions(number, turned)
        return [camera(tuple(place), fov, resolution) for place in places.tolist()]

    def scene(vertices: torch.Tensor, faces: torch.Tensor) -> tr.Scene:
        cameras = {f"view{i}": view for i, view in enumerate(views(count, 0.0))}
        body = smooth_mesh(vertices, faces, grey(0.6))
        sky = {"type": "envmap", "data": soft_sky()}
        return tr.load_dict({"type": "scene", "integrator": DIRECT, **cameras, OBJECT: body, "sky": sky})

    unknowns = [Unknown(VERTICES, vertices.numpy(), low=-math.inf, high=math.inf)]
    held_out = [View(view) for view in views(count // 2, 1.0)]
    given = [View(i) for i in range(count)]
    task = {"target_spp": 64, "judge_spp": 16, "true": scene(*welded("monkey"))}
    return MeshTask(scene(vertices, faces), unknowns, given, held_out, PROJECTIVE, **task)
