"""The scene of shadow art: a tube, and two suns that throw its shadows on two walls."""

from __future__ import annotations

import math
from typing import Any

import torch

import torchrender as tr

WALL = 2.0  # from the middle to the walls, which are 2 * WALL wide and high
SEEN = 1.2  # half of what a picture shows of its wall
HEIGHT = 0.9  # both shadows reach from -HEIGHT to HEIGHT: what is high in one is as high in the other


def tube(rings: int, corners: int, radius: float = 0.6, thickness: float = 0.25) -> tuple[torch.Tensor, torch.Tensor]:
    """A tube bent to a ring about z: (rings * corners, 3) vertices and twice as many triangles, facing outside."""
    along = (2 * math.pi / rings * torch.arange(rings))[:, None]
    around = (2 * math.pi / corners * torch.arange(corners))[None, :]
    far = radius + thickness * torch.cos(around)
    z = (thickness * torch.sin(around)).expand(rings, -1)
    vertices = torch.stack([far * torch.cos(along), far * torch.sin(along), z], dim=-1).reshape(-1, 3)
    i, j = torch.meshgrid(torch.arange(rings), torch.arange(corners), indexing="ij")
    ring, corner = (i + 1) % rings * corners, (j + 1) % corners
    a, b, c, d = i * corners + j, ring + j, ring + corner, i * corners + corner
    return vertices, torch.stack([a, b, c, a, c, d], dim=-1).reshape(-1, 3)


def heart(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Inside of a heart with a hole of its own shape, which reaches from -HEIGHT to HEIGHT in y."""

    def inside(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return (x.square() + y.square() - 1) ** 3 < x.square() * y**3

    # This curve of degree six lies between y = -1 and 1.2272.
    x, y = x / HEIGHT * 1.1136, y / HEIGHT * 1.1136 + 0.1136
    return inside(x, y) & ~inside(x / 0.45, (y - 0.05) / 0.45)


def star(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Inside of a star with five tips, which reaches from -HEIGHT to HEIGHT in y."""
    low = -math.cos(math.pi / 5)  # of the two tips below, where the one above is at 1
    scale = (1 - low) / (2 * HEIGHT)
    x, y = x * scale, y * scale + (1 + low) / 2
    # Folded into half of one of its tips, the star is on one side of a line from the tip to the corner between two.
    half = math.pi / 5
    angle = torch.remainder(torch.atan2(x, y) + half, 2 * half) - half
    radius = torch.hypot(x, y)
    across, out = (radius * torch.sin(angle)).abs(), radius * torch.cos(angle)
    inner = 0.5
    corner = (inner * math.sin(half), inner * math.cos(half))
    return (1 - out) * corner[0] > across * (1 - corner[1])


def draw(inside: Any, resolution: int, detail: int = 8) -> torch.Tensor:
    """A shadow as a picture (H, W, 3): 1 in the light, 0 inside, shares between on the border."""
    n = resolution * detail
    side = SEEN * ((torch.arange(n) + 0.5) / n * 2 - 1)
    y, x = torch.meshgrid(-side, side, indexing="ij")
    share = torch.nn.functional.avg_pool2d((~inside(x, y)).float()[None], detail)[0]
    return share[..., None].expand(-1, -1, 3).contiguous()


def make_scene(vertices: torch.Tensor, faces: torch.Tensor, resolution: int) -> tr.Scene:
    """The tube between two walls, a sun for each and a camera for each, `heart` behind and `star` on the left."""
    white = {"type": "diffuse", "reflectance": 1.0}
    place = tr.Transform.translate([0, 0, -WALL]) @ tr.Transform.scale(WALL)
    turned = tr.Transform.rotate([0, 1, 0], 90)  # what is behind is on the left
    mesh = tr.Mesh(vertices, faces, bsdf={"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.5}})
    mesh.compute_normals()
    scene: dict[str, Any] = {"type": "scene", "tube": mesh}
    for name, to_world in {"heart": tr.Transform(), "star": turned}.items():
        scene[f"{name}_wall"] = {"type": "rectangle", "to_world": to_world @ place, "bsdf": white}
        # An irradiance of pi on a white wall is a radiance of 1.
        scene[f"{name}_sun"] = {
            "type": "directional",
            "to_world": to_world @ tr.Transform.look_at([0, 0, 0], [0, 0, -1], [0, 1, 0]),
            "irradiance": math.pi,
        }
        # Close to the wall, with the tube behind.
        camera = tr.Transform.look_at([0, 0, 0.1 - WALL], [0, 0, -WALL], [0, 1, 0]) @ tr.Transform.scale(
            [SEEN, SEEN, 1]
        )
        scene[f"{name}_camera"] = {
            "type": "orthographic",
            "to_world": to_world @ camera,
            "near_clip": 1e-3,
            "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}},
        }
    return tr.load_dict(scene)
