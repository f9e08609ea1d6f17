"""A scene of a few pixels in which colours, a texture and a reference are found under names."""

from __future__ import annotations

from typing import Any

import torch

from torchrender import Transform

COLOUR, TEXELS = "red.reflectance.value", "ball.bsdf.reflectance.data"


def ball_and_wall(height: int = 6, width: int = 8, spp: int = 2, **objects: Any) -> dict[str, Any]:
    """A textured ball before a red wall under a constant sky; `objects` are added or replace others."""
    texels = torch.full((4, 4, 3), 0.5, device="cpu")
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": Transform.look_at([0, 0, 4], [0, 0, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": spp},
        },
        "red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.1, 0.1]}},
        "wall": {"type": "rectangle", "bsdf": {"type": "ref", "id": "red"}},
        "ball": {
            "type": "sphere",
            "radius": 0.5,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels}},
        },
        "sky": {"type": "constant"},
        **objects,
    }
