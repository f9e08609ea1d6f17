"""The scenes of the benchmark of moving silhouettes and shadows, as dicts for `torchrender.load_dict`.

Lamp, blocker and floor are those of Redner's test of shadows (`test_shadow_blocker.py`). Boxes and monkeys do not touch
what is below them: where solids touch or cross, outlines are not edges of either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr
from scenes.make_materials import rgb
from scenes.make_scenes import write_ply
from torchrender.loaders.geometry import load_mesh

from .rows import SCENES

T = tr.Transform
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Moving:
    """A scene in which one thing is moved along a unit vector.

    `make` takes a folder for the files of meshes and gives the scene's objects. `parameter` is what is moved: positions
    of vertices (V, 3), or a matrix. Central differences have the steps `step` and `step` / 2. `terms` has "seen" where
    silhouettes that the camera sees move, "shadows" where those do that are in the way of other light; others are 0.
    """

    name: str
    make: Callable[[Path], dict[str, Any]]
    parameter: str
    direction: Vector
    max_depth: int
    step: float
    terms: tuple[str, ...] = ("seen", "shadows")
    ours: str = ""  # why no other program has it

    def described(self, folder: Path, resolution: int, spp: int) -> dict[str, Any]:
        """The scene's dict; files of meshes are written to the folder."""
        path = {"type": "path", "max_depth": self.max_depth, "rr_depth": 100}
        made = self.make(folder)
        film = {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "rgb"}
        film |= {"component_format": "float32", "rfilter": {"type": "box"}}
        camera = {"type": "perspective", "fov_axis": "x", "film": film, **made.pop("camera")}
        camera["sampler"] = {"type": "independent", "sample_count": spp}
        return {"type": "scene", "integrator": path, "camera": camera, **made}

    def change(self, value: torch.Tensor) -> torch.Tensor:
        """What a motion by 1 adds to the parameter, in double precision."""
        change = torch.zeros(value.shape, dtype=torch.float64)
        (change[:3, 3] if value.shape == (4, 4) else change)[...] = torch.tensor(self.direction, dtype=torch.float64)
        return change


def grey(reflectance: float) -> dict[str, Any]:
    """Diffuse, of both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(*3 * [reflectance])}}


def flat(y: float, half: float, bsdf: Mapping[str, Any], x: float = 0, z: float = 0, up: bool = True) -> dict[str, Any]:
    """A level square of the side 2 `half` around (x, y, z)."""
    to_world = T.translate([x, y, z]) @ T.rotate([1, 0, 0], -90 if up else 90) @ T.scale(half)
    return {"type": "rectangle", "to_world": to_world, "bsdf": dict(bsdf)}


def look(origin: Vector, target: Vector, fov: float) -> dict[str, Any]:
    return {"fov": fov, "to_world": T.look_at(origin, target, [0, 1, 0])}


SKY = {"type": "constant", "radiance": rgb(1.0, 0.9, 0.8)}


def welded(name: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices (V, 3) and faces (F, 3) of a mesh of `scenes/meshes`, with no place twice."""
    found = load_mesh(SCENES / "meshes" / f"{name}.ply")
    vertices, faces = (np.asarray(found[key]) for key in ("vertices", "faces"))
    vertices, shared = np.unique(vertices, axis=0, return_inverse=True)
    return torch.from_numpy(vertices).float(), torch.from_numpy(shared.reshape(-1)[faces]).long()


def mesh(folder: Path, name: str, bsdf: Mapping[str, Any], lift: float = 0, smooth: bool = True) -> dict[str, Any]:
    """A mesh of `scenes/meshes` with its vertices welded, so that all programs compute the same normals from them."""
    vertices, faces = (part.numpy() for part in welded(name))
    path = folder / f"{name}.ply"
    write_ply(path, np.add(vertices, [0, lift, 0]), faces)
    return {"type": "ply", "filename": str(path), "face_normals": not smooth, "bsdf": dict(bsdf)}


def monkey_in_the_sky(folder: Path) -> dict[str, Any]:
    camera = look((0, 0.6, 4.5), (0, 0, 0), 40)
    return {"camera": camera, "monkey": mesh(folder, "monkey", grey(0.6)), "sky": SKY}


def black_monkey(folder: Path) -> dict[str, Any]:
    """One that has no shading, so that nothing is left but its silhouette."""
    made = monkey_in_the_sky(folder)
    return {**made, "monkey": {**made["monkey"], "bsdf": {"type": "diffuse", "reflectance": rgb(0, 0, 0)}}}


def monkey_on_a_floor(folder: Path) -> dict[str, Any]:
    made = monkey_in_the_sky(folder)
    return {**made, "camera": look((0, 2.2, 4.5), (0, -0.3, 0), 40), "ground": flat(-1.0, 4, grey(0.5))}


def shadow_of_a_square(_: Path) -> dict[str, Any]:
    black = {"type": "diffuse", "reflectance": rgb(0, 0, 0)}
    lamp = {**flat(5, 0.1, black, up=False), "emitter": {"type": "area", "radiance": rgb(1000, 1000, 1000)}}
    shapes = {"ground": flat(0, 2, grey(0.5)), "blocker": flat(3, 0.5, grey(0.5), x=0.1, z=-0.05), "lamp": lamp}
    return {"camera": look((0, 2, -5), (0, 0, 0), 45), **shapes}


def shadow_of_a_point(folder: Path) -> dict[str, Any]:
    made = shadow_of_a_square(folder)
    return {**made, "lamp": {"type": "point", "position": [0, 5, 0], "intensity": rgb(40, 40, 40)}}


def room(folder: Path) -> dict[str, Any]:
    """The Cornell box; its smaller block is 0.1 above the floor."""
    white = {"type": "diffuse", "reflectance": rgb(0.885809, 0.698859, 0.666422)}
    walls = {"red_wall": rgb(0.570068, 0.0430135, 0.0443706), "green_wall": rgb(0.105421, 0.37798, 0.076425)}
    coloured = {name: {"type": "diffuse", "reflectance": colour} for name, colour in walls.items()}
    names = ("floor", "ceiling", "back", "red_wall", "green_wall", "large_box", "light")
    shapes = {name: mesh(folder, name, coloured.get(name, white), smooth=False) for name in names}
    shapes["light"]["emitter"] = {"type": "area", "radiance": rgb(18.387, 13.9873, 6.75357)}
    box = mesh(folder, "small_box", white, lift=0.1, smooth=False)
    return {"camera": look((0, 0, 3.9), (0, 0, 0), 39.3077), "box": box, **shapes}


def above_a_mirror(alpha: float) -> Callable[[Path], dict[str, Any]]:
    """The monkey above a rough conductor, which fills most of the picture."""

    def make(folder: Path) -> dict[str, Any]:
        metal = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha}
        metal["specular_reflectance"] = rgb(0.9, 0.9, 0.9)
        made = monkey_on_a_floor(folder)
        return {**made, "camera": look((0, 2.2, 4.5), (0, -0.7, 0), 40), "ground": flat(-1.3, 4, metal)}

    return make


# Unit vectors along which sums over the picture do not cancel, nor what moves silhouettes and what moves shadows.
UP, FAR, NEAR, DOWN = (0.0, 1.0, 0.0), (0.48, 0.8, 0.36), (0.64, 0.48, -0.6), (0.6, -0.64, 0.48)
SEEN, SHADOWS = ("seen",), ("shadows",)
NO_POINTS = "the boundary terms of Mitsuba's integrators leave lights at points out, and Redner has none"
MOVING = (
    Moving("silhouettes", black_monkey, "monkey.vertex_positions", FAR, 2, 0.02, SEEN),
    Moving("own shadows, sky", monkey_in_the_sky, "monkey.vertex_positions", FAR, 2, 0.02),
    Moving("shadow, small lamp", shadow_of_a_square, "blocker.to_world", DOWN, 2, 0.05, SHADOWS),
    Moving("shadow, sky", monkey_on_a_floor, "monkey.vertex_positions", FAR, 2, 0.02),
    Moving("indirect light", room, "box.vertex_positions", DOWN, 5, 0.02),
    Moving("rough mirror, 0.05", above_a_mirror(0.05), "monkey.vertex_positions", NEAR, 3, 0.02),
    Moving("rough mirror, 0.2", above_a_mirror(0.2), "monkey.vertex_positions", NEAR, 3, 0.02),
    Moving("receiver along its normal", shadow_of_a_square, "ground.to_world", UP, 2, 0.05),
    Moving("lamp", shadow_of_a_square, "lamp.to_world", DOWN, 2, 0.05, SHADOWS),
    Moving("camera", shadow_of_a_square, "camera.to_world", FAR, 2, 0.05),
    # (Its edges lie along rows of pixels, whose weights are steps: differences of 0.05 are off by 0.07 %.)
    Moving("shadow, point light", shadow_of_a_point, "blocker.to_world", DOWN, 2, 0.01, SHADOWS, NO_POINTS),
)
