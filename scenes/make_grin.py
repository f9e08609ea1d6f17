"""The scene of a cube of glass whose index of refraction varies, which throws a picture."""

from __future__ import annotations

from typing import Any

import torch

import torchrender as tr

INDEX = "cube.interior_medium.index"  # the name of what is sought
LEAST, MOST = 1.45, 1.55  # indices of refraction
LIT = 0.44  # half of the beam's width; the cube is 1 wide
BEHIND = 1.0  # from the cube to the screen


def beam_and_screen(
    width: float, lamp: float, screen: tr.Transform, film: dict[str, Any], turn: tr.Transform | None = None
) -> dict[str, Any]:
    """Parallel light along z from a square of this half width at z = `lamp`, and what measures it, in the dark."""
    turn = tr.Transform() if turn is None else turn
    return {
        "type": "scene",
        "integrator": {"type": "ptracer", "max_depth": 6},
        "lamp": {
            "type": "rectangle",
            "to_world": turn @ tr.Transform.translate([0, 0, lamp]) @ tr.Transform.scale(width),
            "emitter": {"type": "directionalarea", "radiance": 1.0},
        },
        "screen": {
            "type": "rectangle",
            "to_world": turn @ screen,
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", **film}},
        },
    }


def grin_cube(
    turn: tr.Transform, index: torch.Tensor | int, resolution: int, interpolation: str = "quadratic"
) -> dict[str, Any]:
    """The cube between a lamp of parallel light and a screen that measures what arrives, along z.

    Args:
        turn: moves lamp and screen, so that the light comes along another axis.
        index: control values (Z, Y, X); or their number along a side, and the index is even.
        resolution: pixels along a side of the picture.
        interpolation: of the index, "quadratic" or "cubic".
    """
    place = tr.Transform.translate
    if isinstance(index, int):
        index = torch.full((index,) * 3, (LEAST + MOST) / 2)
    medium = {
        "type": "gradientindex",
        "index": index,
        "to_world": place([-0.5] * 3),
        "interpolation": interpolation,
    }
    film = {"width": resolution, "height": resolution}
    film["rfilter"] = {"type": "gaussian"}  # where light arrives has a derivative by its slope
    screen = place([0, 0, 0.5 + BEHIND]) @ tr.Transform.rotate([0, 1, 0], 180) @ tr.Transform.scale(0.5)
    cube = {"type": "cube", "to_world": tr.Transform.scale(0.5), "interior": medium, "bsdf": {"type": "dielectric"}}
    return {**beam_and_screen(LIT, -1, screen, film, turn), "cube": cube}
