"""What the reference scenes are made of; NumPy alone, see `reference_scenes.py`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[1] / "data"
SIZE = 48  # pixels along either side of the film
BLOCK = 4  # pixels along either side of the blocks over which references are averaged


@dataclass(frozen=True)
class ReferenceScene:
    """A scene in `load_dict` format and the parameters whose derivative of mean(image * weight) is compared."""

    scene: dict
    gradients: tuple[str, ...] = ()


def translate(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def scale(x: float, y: float | None = None, z: float | None = None) -> np.ndarray:
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def rotate(axis: str, degrees: float) -> np.ndarray:
    """Rotation about a coordinate axis, counter-clockwise seen against the axis."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(4)
    matrix[j, j] = matrix[k, k] = cos
    matrix[k, j], matrix[j, k] = sin, -sin
    return matrix


def look_at(origin, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    origin, target = np.asarray(origin, float), np.asarray(target, float)
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def weight(height: int = SIZE, width: int = SIZE, channels: int = 3) -> np.ndarray:
    """The smooth weight of the scalar mean(image * weight), (H, W, C); the stored comparison scenes use it, too."""
    x, y = 2 * np.pi * np.arange(width) / width, 2 * np.pi * np.arange(height) / height
    pattern = 1 + 0.5 * np.sin(x)[None, :] * np.cos(y)[:, None]
    return pattern[..., None] * np.array([1.0, 0.8, 0.6])[:channels]


def _rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def _camera(origin=(0.0, 1.0, 5.0), target=(0.0, 0.0, 0.0), fov=40.0, film: dict | None = None, **more) -> dict:
    film = {"rfilter": {"type": "box"}, **(film or {})}
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": look_at(origin, target),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "component_format": "float32", **film},
        "sampler": {"type": "independent"},
        **more,
    }


def _scene(integrator: dict, sensor: dict, **objects) -> dict:
    return {"type": "scene", "integrator": integrator, "sensor": sensor, **objects}


def _noise(seed: int, height: int, width: int, low: float, high: float, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (height, width, channels)).astype(np.float32)


def _bitmap(seed: int, height: int, width: int, low: float = 0.1, high: float = 0.9, **more) -> dict:
    return {"type": "bitmap", "data": _noise(seed, height, width, low, high), "raw": True, **more}


def _diffuse(reflectance) -> dict:
    return {"type": "diffuse", "reflectance": reflectance}


PATH5 = {"type": "path", "max_depth": 5, "rr_depth": 100}
FLOOR = translate(0, -1, 0) @ rotate("x", -90) @ scale(3)
LAMP = translate(0.3, 2.5, 0.5) @ rotate("x", 90) @ scale(0.6)
TO_UV = np.array([[2.0, 0.5, 0.2], [-0.4, 3.0, 0.1], [0.0, 0.0, 1.0]])


def _lamp(radiance) -> dict:
    return {"type": "rectangle", "to_world": LAMP, "emitter": {"type": "area", "radiance": radiance}}


def _floor(reflectance) -> dict:
    return {"type": "rectangle", "to_world": FLOOR, "bsdf": _diffuse(reflectance)}
