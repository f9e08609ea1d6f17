"""Uniform numbers and directions for tests of samplers."""

from __future__ import annotations

import math

import torch


def uniform(n: int, seed: int = 1) -> torch.Tensor:
    return torch.rand(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def direction(theta: float, phi: float = 0.3) -> torch.Tensor:
    t, p = math.radians(theta), phi
    return torch.tensor([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)], dtype=torch.float64)
