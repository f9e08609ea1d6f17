"""BSDFs by themselves, in directions of all sides."""

from __future__ import annotations

import torch
from uniform_numbers import uniform

import torchrender as tr


def probe(bsdf: dict, dtype: torch.dtype = torch.float64) -> tr.testing.BsdfProbe:
    scene = {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}
    return tr.testing.BsdfProbe(tr.load_dict(scene, dtype=dtype), "ball.bsdf")


def directions(n: int, seed: int) -> torch.Tensor:
    """Directions (n, 3), not uniform, of either side."""
    return torch.nn.functional.normalize(uniform(n, seed) - 0.5, dim=1)
