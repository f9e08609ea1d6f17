"""Scenes that show materials: a solid, or many balls, on a chequered floor under a sky and a lamp.

The functions give dicts for `torchrender.load_dict`. `bench/materials.py` measures these scenes, `gallery.py` makes
pictures of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import torchrender as tr

MAX_DEPTH = 6
FLOOR = "floor.bsdf.reflectance.color0.value"  # the name of the brighter squares' colour


def rgb(*values: float) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": list(values)}


def sky(height: int = 64) -> np.ndarray:
    """Radiance from everywhere, (height, 2 height, 3): a warm horizon, blue above, brown below, two bright clouds."""
    v, u = np.meshgrid(np.linspace(0, 1, height), (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    up = (0.5 - v)[..., None]  # half turns above the horizon
    haze = np.exp(-9 * np.abs(up))
    above = haze * [1.0, 0.8, 0.6] + (1 - haze) * [0.2, 0.4, 0.8]
    below = haze * [0.4, 0.32, 0.25] + (1 - haze) * [0.15, 0.12, 0.1]
    texels = np.where(up > 0, above, below)
    for column, elevation, size, radiance in ((0.1, 0.2, 0.06, 8.0), (0.62, 0.14, 0.1, 2.0)):
        around = np.abs(u - column)
        around = np.minimum(around, 1 - around)  # the map goes round
        spot = np.exp(-((2 * around) ** 2 + (0.5 - v - elevation) ** 2) / size**2)
        texels = texels + radiance * spot[..., None]
    return texels.astype(np.float32)


def camera(
    resolution: int, spp: int = 64, *, origin: Sequence[float] = (0, 2.3, 5.6), target: Sequence[float] = (0, 0.8, 0)
) -> dict[str, Any]:
    """Looks down a little at the middle of the floor; a square picture through a box filter."""
    return {
        "type": "perspective",
        "fov": 30,
        "to_world": tr.Transform.look_at(origin, target, [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": resolution,
            "height": resolution,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": spp},
    }


def surroundings() -> dict[str, Any]:
    """Floor, lamp and sky."""
    squares = {"type": "checkerboard", "color0": rgb(0.6, 0.55, 0.5), "color1": rgb(0.15, 0.2, 0.25)}
    return {
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.rotate([1, 0, 0], -90).scale(6),
            "bsdf": {"type": "diffuse", "reflectance": {**squares, "to_uv": tr.Transform.scale([12, 12, 1])}},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.look_at([-3, 4.5, 2.5], [0, 0.8, 0], [0, 1, 0]).scale(0.7),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": rgb(14.0, 13.0, 12.0)},
        },
        "sky": {"type": "envmap", "data": sky()},
    }


def ball(material: str = "material", *, radius: float = 1.0, at: Sequence[float] = (0, 0)) -> dict[str, Any]:
    """A ball of the material of that name, which lies on the floor at (x, z)."""
    return {
        "type": "sphere",
        "center": [at[0], radius, at[1]],
        "radius": radius,
        "bsdf": {"type": "ref", "id": material},
    }


def shown(
    material: Mapping[str, Any], solids: Mapping[str, Any] | None = None, *, resolution: int = 256, spp: int = 64
) -> dict[str, Any]:
    """A material on a ball, or on other solids that refer to it as "material"."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH},
        "sensor": camera(resolution, spp),
        "material": dict(material),
        **(solids or {"ball": ball()}),
        **surroundings(),
    }


def together(materials: Mapping[str, Mapping[str, Any]], *, resolution: int = 256, spp: int = 64) -> dict[str, Any]:
    """All materials, each on a ball of its own, in rows; they are objects of the scene under their names."""
    columns = max(1, round((1.6 * len(materials)) ** 0.5))
    rows = -(-len(materials) // columns)
    step = 3.4 / columns
    places = [
        ((column - (columns - 1) / 2) * step, 0.4 + (row - (rows - 1) / 2) * 1.6 * step)
        for row in range(rows)
        for column in range(columns)
    ]
    balls = {
        f"{name}_ball": ball(name, radius=0.4 * step, at=place)
        for name, place in zip(materials, places)  # the last row may have room left
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH},
        "sensor": camera(resolution, spp, origin=(0, 4.2, 5.2), target=(0, 0.1, 0.3)),
        **{name: dict(material) for name, material in materials.items()},
        **balls,
        **surroundings(),
    }
