"""Objects of scenes with media that are seen along single lines: balls, lights, random grids, plane layers."""

from __future__ import annotations

import media_scenes as ms
import media_truth as truth
import numpy as np
import torch
from media_truth import cameras, lines, pencil

DOUBLE = torch.float64


def colour(values) -> dict | float:
    return {"type": "rgb", "value": values} if isinstance(values, list) else values


def ball(medium: dict, kind: str = "homogeneous", **more) -> dict:
    """A medium in a ball of radius 1 at the origin."""
    return {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": kind, **medium}, **more}


def sky(radiance=1.0) -> dict:
    return {"type": "constant", "radiance": colour(radiance)}


def random_grid(seed: int, shape=(3, 4, 5, 1), high: float = 3.0, **more) -> dict:
    """A grid whose cells are empty to a third, turned and sheared, larger than the ball in some directions."""
    data = np.maximum(ms.noise(seed, shape, -0.5 * high, high), 0)
    shear = np.eye(4)
    shear[0, 1] = 0.3
    to_world = ms.rotate("x", 20) @ shear @ ms.scale(0.9, 0.6, 1.1) @ ms.UNIT_TO_CUBE
    return ms.grid(data, ms.translate(0.1, 0, 0) @ to_world, **more)


LAMP = (2.0, 1.0, 1.0), (0.0, 0.5, 0.0), (0.3, 0.0, -0.6)  # centre and half edges; it faces the ball
LIGHTS = {
    "point": (
        {"type": "point", "position": [1.5, 1.0, 1.2], "intensity": colour([9.0, 6.0, 3.0])},
        truth.point_light,
    ),
    "constant": (sky([0.5, 1.0, 2.0]), truth.constant_light),
    "area": (None, truth.square_light(*LAMP)),
}


def lamp(center, u, v, radiance) -> dict:
    """The rectangle of `square_light`."""
    matrix = np.eye(4)
    normal = np.cross(u, v)
    matrix[:3] = np.stack([u, v, normal / np.linalg.norm(normal), center], 1)
    emitter = {"type": "area", "radiance": colour(radiance)}
    return {"type": "rectangle", "to_world": matrix, "emitter": emitter}


WIDE = 2000.0  # half the width of layers that stand for endless ones


def layers(sigma, albedo, emission=None, g: float = 0.0, floor: float = 0.0, size: int = 16) -> dict:
    """Layers of height 1 over a floor, under a sky of 1; cameras look straight down and, from below, straight up."""
    height = len(sigma)
    to_world = ms.translate(-WIDE, -WIDE, 0) @ ms.scale(2 * WIDE, 2 * WIDE, height)

    def grid(values) -> dict:
        return ms.grid(np.array(values, dtype=np.float32).reshape(height, 1, 1, 1), to_world, "nearest")

    medium = {
        "type": "heterogeneous",
        "sigma_t": grid(sigma),
        "albedo": grid(albedo),
        "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
    }
    if emission is not None:
        medium["emission"] = grid(emission)
    box = ms.translate(0, 0, height / 2) @ ms.scale(WIDE, WIDE, height / 2)
    return {
        "above": pencil([0, 0, height + 1], [0, 0, 0], size),
        "below": pencil([0, 0, -0.25], [0, 0, 1], size),
        "box": ms.boundary(medium, box),
        "floor": {
            "type": "rectangle",
            "to_world": ms.translate(0, 0, -0.5) @ ms.scale(WIDE),
            "bsdf": {"type": "diffuse", "reflectance": floor},
        },
        "sky": sky(),
    }


STACKS = {
    "thin": ([0.1, 0.0, 0.2], [0.9, 0.5, 0.7], None, 0.0, 0.5),
    "middle": ([0.5, 1.5, 0.0, 0.3], [0.9, 0.6, 1.0, 1.0], [0.1, 0.0, 0.2, 0.05], 0.5, 0.3),
    "dense": ([4.0, 1.0, 3.0], [0.95, 0.8, 0.9], None, 0.0, 0.3),
    "backward": ([1.0, 2.0], [0.8, 0.9], [0.3, 0.0], -0.5, 0.0),
}


def cloud(**medium) -> dict:
    origins, targets = lines(3, 17)
    return {
        **cameras(origins, targets, 24),
        "ball": ball({"sigma_t": 2.0, "albedo": colour([0.9, 0.8, 0.5]), **medium}, "heterogeneous"),
        "bulb": {"type": "point", "position": [1.5, 1.0, 1.2], "intensity": 9.0},
        "sky": sky([0.3, 0.5, 0.7]),
    }
