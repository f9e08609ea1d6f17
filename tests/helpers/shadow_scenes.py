"""A room with a box and a plate that throw shadows, under every light, for tests of what moves."""

from __future__ import annotations

import torch

import torchrender as tr

T = tr.Transform
DOWN = T.rotate([1, 0, 0], 180)


def diffuse(reflectance) -> dict:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def area(shape: dict, **more) -> dict:
    return {**shape, "emitter": {"type": "area", "radiance": 12.0, **more}}


STOKES = [0.5, -0.4, 0.6]  # Q, U and V over I
FROM_ABOVE = T.look_at([0.5, 0.3, 2.9], [0, 0, 0], [0, 1, 0])
RECTANGLE = {"type": "rectangle", "to_world": T.translate([0.3, 0.2, 2.6]) @ DOWN @ T.scale(0.4)}
LIGHTS = {
    "rectangle": area(RECTANGLE),
    "ball": area({"type": "sphere", "center": [0.3, 0.2, 2.6], "radius": 0.3}),
    "tube": area({"type": "cylinder", "p0": [-0.5, 0, 2.5], "p1": [0.6, 0.2, 2.6], "radius": 0.15}),
    "point": {"type": "point", "position": [0.5, 0.3, 2.7], "intensity": 6.0},
    "spot": {"type": "spot", "to_world": FROM_ABOVE, "intensity": 9.0, "cutoff_angle": 45, "beam_width": 5},
    "sun": {"type": "directional", "direction": [0.2, 0.1, -1], "irradiance": 3.0},
    "sky": {"type": "constant", "radiance": 1.0},
}
LIGHTS["polarised point"] = {**LIGHTS["point"], "stokes": STOKES}
LIGHTS["polarised rectangle"] = area(RECTANGLE, stokes=STOKES)


BOX_FACES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip


def room(
    light: str,
    depth: int = 2,
    floor: dict | None = None,
    sensor: dict | None = None,
    variant: str = "rgb",
    box_colour=(0.8, 0.5, 0.3),
) -> tr.Scene:
    """A turned box and a plate above a floor."""
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "gaussian"}}
    camera = {"type": "perspective", "fov": 50, **(sensor or {})}
    matrix = T.translate([-0.3, 0.2, 0.7]) @ T.rotate([0, 0.3, 1], 30) @ T.scale(0.35)
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3).double() @ matrix.matrix[:3, :3].T
    box = tr.Mesh((corners + matrix.matrix[:3, 3]).numpy(), BOX_FACES)
    box.bsdf = diffuse({"type": "rgb", "value": list(box_colour)})
    tilted = T.translate([0.9, -0.7, 0.6]) @ T.rotate([1, 0.3, 0], 30) @ T.scale(0.45)
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth, "rr_depth": 99},
            "camera": {"to_world": T.look_at([0, -3.5, 1.6], [0, 0, 0.5], [0, 0, 1]), "film": film, **camera},
            "floor": {"type": "rectangle", "to_world": T.scale(3), "bsdf": floor or diffuse(0.7)},
            "box": box,
            "plate": {"type": "disk", "to_world": tilted, "bsdf": diffuse(0.6)},
            "lamp": LIGHTS[light],
        },
        variant=variant,
        dtype=torch.float64,
    )
