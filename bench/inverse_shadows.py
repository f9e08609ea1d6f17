"""The inverse problem of shadow art: one tube throws a heart on one wall and a star on another.

It is that of `tutorials/shadow_art.py`, but its suns are lamps of some size, far away: Mitsuba's derivatives of what
moves leave lights without an extent out. Nothing is held out, since the two pictures are all that is wanted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch

import torchrender as tr
from scenes import make_shadows

from .inverse_shapes import PROJECTIVE, BodyTask
from .inverse_task import JUDGE_SEED, Task, Unknown, Values, View, as_tensors

TUBE, WALLS = "tube", {"heart": make_shadows.heart, "star": make_shadows.star}
LAMP, DISTANCE = 0.5, 100.0  # half of a lamp's side, and how far it is: the other wall has 2 % of its light
NEAR = 0.9  # from a camera to its wall


@dataclass
class ShadowTask(BodyTask):
    """The vertices of a tube, judged by its shadows.

    Args:
        drawn: what these are to be, (views, H, W, 3): no mesh is known that throws just them.
    """

    drawn: torch.Tensor = field(kw_only=True)
    kind: ClassVar[str] = "mesh"
    moved: ClassVar[str] = TUBE

    def _truth(self) -> Values:
        return {}

    def _targets(self) -> torch.Tensor:
        return self.drawn

    def _judged(self, values: Values) -> torch.Tensor:
        if not values:
            return self.drawn
        return torch.stack([self.picture(v, values, self.judge_spp, JUDGE_SEED, sampler="sobol") for v in self.views])

    def shown(self, found: Sequence[dict[str, np.ndarray]]) -> torch.Tensor:
        """Both shadows: as they are to be, then of what each program found."""
        columns = [self.drawn, *(self._judged(as_tensors(each)) for each in found)]
        return torch.cat([torch.cat(list(pictures)) for pictures in columns], 1)


def shadows(quick: bool) -> Task:
    """Two walls, which are all that the cameras see, and between these and two lamps a tube."""
    resolution, rings, corners = (24, 48, 12) if quick else (128, 192, 48)
    vertices, faces = make_shadows.tube(rings, corners)
    scene = make_shadows.make_scene(vertices, faces, resolution)
    scene.integrator = tr.PathTracer(max_depth=2)
    distance = DISTANCE + make_shadows.WALL
    for name, degrees in zip(WALLS, (0, 90), strict=True):
        turn = tr.Transform.rotate([0, 1, 0], degrees)
        del scene[f"{name}_sun"]
        # Mitsuba's derivatives of outlines know this camera alone; it is as close to the wall, the tube being behind it
        camera = scene[f"{name}_camera"]
        near = tr.Transform.look_at([0, 0, NEAR - make_shadows.WALL], [0, 0, -make_shadows.WALL], [0, 1, 0])
        scene[f"{name}_camera"] = tr.PerspectiveCamera(
            fov=math.degrees(2 * math.atan(make_shadows.SEEN / NEAR)),
            to_world=turn @ near,
            film=camera.film,
        )
        place = tr.Transform.look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0]) @ tr.Transform.scale(LAMP)
        scene[f"{name}_lamp"] = {
            "type": "rectangle",
            "to_world": turn @ place,
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            # white walls have a radiance of 1 in it
            "emitter": {"type": "area", "radiance": math.pi * distance**2 / (2 * LAMP) ** 2},
        }
    drawn = torch.stack([make_shadows.draw(inside, resolution) for inside in WALLS.values()])
    unknown = Unknown(f"{TUBE}.vertex_positions", vertices.numpy(), low=-math.inf, high=math.inf)
    views = [View(i) for i in range(len(WALLS))]
    return ShadowTask(scene, [unknown], views, views, PROJECTIVE, target_spp=1024, judge_spp=64, drawn=drawn)
