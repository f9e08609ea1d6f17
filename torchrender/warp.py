"""Maps from the unit square to what is sampled, those of the native core (csrc/core/math/warp.h)."""

from __future__ import annotations

import math

import torch


def disk(u1: torch.Tensor, u2: torch.Tensor) -> torch.Tensor:
    """Uniform on the unit disk (N, 2), by concentric squares (Shirley and Chiu 1997)."""
    x, y = 2 * u1 - 1, 2 * u2 - 1
    wide = x.abs() > y.abs()
    r, other = torch.where(wide, x, y), torch.where(wide, y, x)
    phi = torch.where(r == 0, 0.0, other / torch.where(r == 0, 1.0, r)) * (math.pi / 4)
    phi = torch.where(wide, phi, math.pi / 2 - phi)
    return torch.stack([r * torch.cos(phi), r * torch.sin(phi)], 1)


def cosine_hemisphere(u1: torch.Tensor, u2: torch.Tensor) -> torch.Tensor:
    """Directions (N, 3) with the density cos(theta) / pi about +z."""
    p = disk(u1, u2)
    z = torch.sqrt((1 - (p * p).sum(1)).clamp(min=0.0)).clamp(min=1e-7)
    return torch.cat([p, z[:, None]], 1)


def sphere(u1: torch.Tensor, u2: torch.Tensor) -> torch.Tensor:
    """Uniform directions (N, 3)."""
    z = 1 - 2 * u2
    r, phi = torch.sqrt((1 - z * z).clamp(min=0.0)), u1 * (2 * math.pi)
    return torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], 1)


def cone(u1: torch.Tensor, u2: torch.Tensor, cutoff: torch.Tensor) -> torch.Tensor:
    """Uniform directions (N, 3) in the cone about +z whose half angle has 1 - cos = `cutoff`."""
    a = u2 * cutoff
    r, phi = torch.sqrt((a * (2 - a)).clamp(min=0.0)), u1 * (2 * math.pi)
    return torch.stack([r * torch.cos(phi), r * torch.sin(phi), 1 - a], 1)


def triangle(u1: torch.Tensor, u2: torch.Tensor) -> torch.Tensor:
    """Uniform barycentric coordinates (N, 2) of the second and third corner."""
    t = torch.sqrt((1 - u1).clamp(min=0.0))
    return torch.stack([1 - t, t * u2], 1)
