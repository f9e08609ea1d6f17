"""The scene of a mirage: hot air above a road, which mirrors the lorries at its end.

Where it is hotter air bends light less, so that rays that come in flat are bent upwards before they meet the road. The
index of refraction of air is n = 1 + 2.77e-4 (288.15 K / T), by the law of Gladstone and Dale with the value of air of
15 °C for visible light. Between 30 °C and 60 °C that is a difference of 2.3e-5, which `index_base` and `index_scale`
keep out of the rounding. The air's box is 410 m long and its layers are 2 cm thick: voxels are as long as the index
allows, 6 m, and `step` lets rays go 2 m at a time, for which scenes have to be of double precision.
"""

from __future__ import annotations

from typing import Any

import torch

import torchrender as tr

INDEX = "air.interior_medium.index"
AMBIENT = 303.15  # kelvin
EYE = 0.9  # metres
FIRST, LENGTH, TOP = 5.0, 410.0, 0.64  # the air's box, from the eye on, and its height
FAR = 420.0  # distance of the backdrop
BACKDROP = (16.0, 8.0)  # its width and height
VOXELS = (64, 32, 20)  # along, up, across
SCALE = 1e-5  # of differences of the index
ROAD = 0.12  # radiance of the road


def heat(y: torch.Tensor) -> torch.Tensor:
    """The truth: how much hotter than 30 °C the air is at a height, in kelvin."""
    return 20 * torch.exp(-y / 0.06) + 10 * torch.exp(-y / 0.25)


def index_of(hotter: torch.Tensor) -> torch.Tensor:
    """The medium's values (Z, Y, X) from temperatures above the ambient one, a layer each."""
    refractivity = 2.77e-4 * 288.15
    change = refractivity / (AMBIENT + hotter) - refractivity / AMBIENT
    long, up, across = VOXELS
    return (change / SCALE)[None, :, None].expand(long, up, across)


def layers() -> torch.Tensor:
    """Heights of the voxels' centres."""
    return (torch.arange(VOXELS[1], dtype=torch.float64) + 0.5) / VOXELS[1] * TOP


def backdrop(height: int = 384) -> torch.Tensor:
    """A picture (H, 2 H, 3) of sky, hills and lorries, the first row at the bottom."""
    width, tall = BACKDROP
    y, x = torch.meshgrid(
        (torch.arange(height) + 0.5) / height * tall,
        ((torch.arange(2 * height) + 0.5) / (2 * height) - 0.5) * width,
        indexing="ij",
    )

    def paint(picture: torch.Tensor, where: torch.Tensor, colour: tuple[float, ...]) -> torch.Tensor:
        return torch.where(where[..., None], torch.tensor(colour), picture)

    up = (y / tall)[..., None].sqrt()
    picture = torch.lerp(torch.tensor([1.0, 0.85, 0.65]), torch.tensor([0.25, 0.45, 0.9]), up)
    picture = paint(picture, y < 0.9 + 0.35 * torch.sin(1.1 * x + 1) + 0.15 * torch.sin(2.9 * x), (0.25, 0.4, 0.35))
    for at, red, green, blue in ((-3.9, 0.8, 0.2, 0.15), (-0.4, 0.9, 0.75, 0.2), (2.6, 0.2, 0.4, 0.8)):
        left = x - at
        box = (left > 0) & (left < 1.5) & (y > 0.25) & (y < 1.7)
        cab = (left > 1.5) & (left < 2.1) & (y > 0.25) & (y < 1.2 - 0.4 * (left - 1.8).clamp(min=0))
        window = (left > 1.6) & (left < 2.0) & (y > 0.75) & (y < 1.05)
        stripe = box & (torch.remainder(left, 0.3) < 0.08)
        wheels = torch.hypot(torch.remainder(left - 0.05, 0.8) - 0.3, y - 0.2) < 0.2
        picture = paint(picture, box | cab, (red, green, blue))
        picture = paint(picture, stripe, (0.9 * red + 0.1, 0.9 * green + 0.1, 0.9 * blue + 0.1))
        picture = paint(picture, window, (0.75, 0.85, 0.95))
        picture = paint(picture, wheels & (left > 0) & (left < 2.1), (0.05, 0.05, 0.06))
    return picture


def mirage(width: int, height: int) -> dict[str, Any]:
    """Air over a road, a backdrop behind, in metres; y is up, and the camera looks along z; pixels of the picture."""
    T = tr.Transform
    wide, tall = BACKDROP
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    black = {"type": "diffuse", "reflectance": 0.0}
    texture = {"type": "bitmap", "data": backdrop(), "raw": True}
    box = T.translate([-20, 0, FIRST]) @ T.scale([40, TOP, LENGTH])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "air": {
            "type": "cube",
            "to_world": box @ T.scale(0.5) @ T.translate([1, 1, 1]),
            "bsdf": {"type": "null"},
            "interior": {
                "type": "gradientindex",
                "index": index_of(heat(layers())),
                "index_base": 1 + 2.77e-4 * 288.15 / AMBIENT,
                "index_scale": SCALE,
                "to_world": box,
                "interpolation": "quadratic",
                "step": 100.0,  # of 2 cm
            },
        },
        "road": {
            "type": "rectangle",
            "to_world": T.translate([0, 1e-3, 200]) @ T.rotate([1, 0, 0], -90) @ T.scale([20, 300, 1]),
            "bsdf": black,
            "emitter": {"type": "area", "radiance": ROAD},
        },
        "backdrop": {
            "type": "rectangle",
            "to_world": T.translate([0, tall / 2, FAR]) @ T.rotate([0, 1, 0], 180) @ T.scale([wide / 2, tall / 2, 1]),
            "bsdf": black,
            "emitter": {"type": "area", "radiance": texture},
        },
        "camera": {
            "type": "perspective",
            "fov_axis": "y",
            "fov": 1.2,
            "to_world": T.look_at([0, EYE, 0], [0, EYE + 0.001, 1], [0, 1, 0]),
            "near_clip": 0.1,
            "film": film,
        },
    }
