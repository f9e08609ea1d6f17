"""Grids of signed distances, scenes of them, and rays around them."""

from __future__ import annotations

import torch

import torchrender as tr

DOUBLE = torch.float64
T = tr.Transform
SHEAR = torch.tensor([[1.0, 0.2, 0, 0], [0, 1, 0.1, 0], [0.1, 0, 0.7, 0], [0, 0, 0, 1]])
PLACES = {
    "object": T(),
    "turned": T.translate([0.3, -0.2, 1]).rotate([1, 2, 0.5], 50).scale([2, 1.5, 0.8]),
    "mirrored": T.rotate([0, 1, 0], 30).scale([-1, 1, 1.2]),
    "sheared": T.translate([0, 0, -2]) @ T(SHEAR),
}


def coordinates(*n: int) -> tuple[torch.Tensor, ...]:
    """z, y, x of a grid (D, H, W)."""
    return torch.meshgrid(*(torch.linspace(0, 1, k, dtype=DOUBLE) for k in n), indexing="ij")


def dented(n: tuple[int, int, int], noise: float, seed: int = 0) -> torch.Tensor:
    """A ball with numbers that are off by chance: (D, H, W, 1)."""
    z, y, x = coordinates(*n)
    generator = torch.Generator().manual_seed(seed)
    off = noise * (2 * torch.rand(n, generator=generator, dtype=DOUBLE) - 1)
    return (torch.sqrt((x - 0.5) ** 2 + (y - 0.45) ** 2 + (z - 0.5) ** 2) - 0.35 + off)[..., None]


def shape(grid: torch.Tensor, **more: object) -> dict:
    return {"type": "sdfgrid", "grid": grid, **more}


def scene_of(grid: torch.Tensor, dtype: torch.dtype = torch.float32, **more: object) -> tr.Scene:
    return tr.load_dict({"type": "scene", "ball": shape(grid, **more)}, dtype=dtype)


def rays(matrix: torch.Tensor, n: int = 300, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays from around and from within the unit cube, some along its axes; in the world."""
    generator = torch.Generator().manual_seed(seed)
    o, target = (torch.rand(n, 3, generator=generator, dtype=DOUBLE) for _ in range(2))
    kind = torch.arange(n) % 4
    o = torch.where((kind < 2)[:, None], 3 * o - 1, o)
    d = target - o
    axis = torch.arange(n) % 3
    along = torch.eye(3, dtype=DOUBLE)[axis] * torch.where(d.gather(1, axis[:, None]) < 0, -1.0, 1.0)
    d = torch.where((kind == 3)[:, None], along, d)
    return o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T


# One a channel, so that the colour says which way a normal points (Woodham, "Photometric method for determining surface
# orientation from multiple images", 1980).
LAMPS = [
    ([3.5, 0.5, 3.5], [60.0, 0.0, 0.0]),
    ([-1.0, 3.1, 3.5], [0.0, 60.0, 0.0]),
    ([-1.0, -2.1, 3.5], [0.0, 0.0, 60.0]),
]
PAINT = {"type": "diffuse", "reflectance": 0.8}


def lit(grid: torch.Tensor, rfilter: str = "box", material: dict = PAINT) -> tr.Scene:
    """A grid under three lamps, seen so near that there is nothing else in view."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {
                "type": "perspective",
                "fov": 10,
                "to_world": T.look_at([0.6, 0.5, 3], [0.5, 0.5, 0.5], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 20, "height": 20, "rfilter": {"type": rfilter}},
            },
            "ball": shape(grid, bsdf=material),
            **{
                f"lamp{i}": {"type": "point", "position": position, "intensity": {"type": "rgb", "value": colour}}
                for i, (position, colour) in enumerate(LAMPS)
            },
        }
    )
