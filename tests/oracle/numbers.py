"""Random numbers (Philox4x32 with 7 rounds) and what is sampled with them: csrc/core/math/philox.h and warp.h."""

from __future__ import annotations

import math

import numpy as np
import torch

MASK32 = np.uint64(0xFFFFFFFF)
EMITTER_BLOCK, BSDF_BLOCK, BLOCKS_PER_SCATTERING = 1, 2, 2  # block 0 is the camera's


def random4(seed: int, sensor: int, pixel: torch.Tensor, sample: torch.Tensor, block: int) -> torch.Tensor:
    """Four numbers in [0, 1), multiples of 2^-24, for each of N samples: (N, 4) float64."""
    c = [pixel.numpy().astype(np.uint64), sample.numpy().astype(np.uint64)]
    c += [np.full_like(c[0], block), np.full_like(c[0], sensor)]
    k0, k1 = np.uint64(seed & 0xFFFFFFFF), np.uint64(seed >> 32)
    for _ in range(7):
        first, second = np.uint64(0xD2511F53) * c[0], np.uint64(0xCD9E8D57) * c[2]
        shift = np.uint64(32)
        c = [(second >> shift) ^ c[1] ^ k0, second & MASK32, (first >> shift) ^ c[3] ^ k1, first & MASK32]
        k0, k1 = (k0 + np.uint64(0x9E3779B9)) & MASK32, (k1 + np.uint64(0xBB67AE85)) & MASK32
    return torch.from_numpy(np.stack([(x >> np.uint64(8)).astype(np.float64) for x in c], 1) / 16777216.0)


def search(cdf: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """For a cumulative distribution (n,) and numbers (N,): index, probability of it, and what is left of the number."""
    index = torch.searchsorted(cdf, u.contiguous(), right=True).clamp(max=len(cdf) - 1)
    before = torch.where(index > 0, cdf[(index - 1).clamp(min=0)], 0.0)
    mass = cdf[index] - before
    return index, mass, (u - before) / mass.clamp(min=1e-20)


def cumulative(weights: torch.Tensor) -> torch.Tensor:
    """Cumulative distribution of weights (..., n), uniform where all are 0."""
    weights = torch.where(weights.sum(-1, keepdim=True) > 0, weights, torch.ones_like(weights))
    total = torch.cumsum(weights, -1)
    cdf = (total / total[..., -1:]).clamp(max=1.0)
    cdf[..., -1] = 1.0
    return cdf


def disk(u1: torch.Tensor, u2: torch.Tensor) -> torch.Tensor:
    """Uniform on the unit disk (N, 2), by concentric squares."""
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
