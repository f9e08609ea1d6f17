"""Materials that layers lie around, and means of images of them."""

from __future__ import annotations

import torch
from motion_scenes import at_ball, ball, black_room, scene

import torchrender as tr

PAINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}}
DARK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.6]}}
MIRROR = {"type": "conductor"}
GLASS = {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0}
BRUSHED = {"type": "roughconductor", "alpha": 0.4, "distribution": "ggx"}
Z = 3.29  # two-sided, 1e-3


def room(bsdf: dict, depth: int = 3, **more) -> tr.Scene:
    return tr.load_dict(scene(depth, at_ball(), ball=ball(bsdf), room=black_room(), **more))


def means(loaded: tr.Scene, runs: int = 16, spp: int = 64, **more) -> torch.Tensor:
    """Mean radiance of each run (runs, C)."""
    return torch.stack([tr.render(loaded, spp=spp, seed=100 + k, **more).double().mean((0, 1)) for k in range(runs)])


def equal_means(a: torch.Tensor, b: torch.Tensor) -> None:
    gap = (a.mean(0) - b.mean(0)).abs()
    error = (a.var(0) / len(a) + b.var(0) / len(b)).sqrt()
    # several channels, and few runs: a wider limit than that of one normal number
    assert bool((gap <= 4.5 * error + 1e-6).all()), f"{a.mean(0)} and {b.mean(0)}, error {error}"


def soft(description: dict) -> dict:
    """The scene with a filter that light paths can be differentiated through."""
    return {**description, "camera": {**description["camera"], "film": {"type": "hdrfilm", "width": 6, "height": 6}}}
