"""Hashes of places, for those who look for vertices that are in one place."""

from __future__ import annotations

import torch

# Odd constants of 64 bits with irregular digits, as signed numbers.
ODD = (-7046029254386353131, -4417276706812531889, 1609587929392839161, -8796714831421723037)


def mix(x: torch.Tensor) -> torch.Tensor:
    """A hash of 64-bit integers, by multiplications and shifts; overflow wraps around."""
    for constant in ODD[:2]:
        x = (x ^ (x >> 29)) * constant
    return x ^ (x >> 32)


def hash_places(points: torch.Tensor) -> torch.Tensor:
    """Hashes (V,), int64, of points (V, 3): equal where all coordinates are, and else by chance alone."""
    bits = (points.detach().double() + 0.0).view(torch.int64)  # + 0.0: minus zero becomes zero
    key = torch.zeros_like(bits[:, 0])
    for column in bits.unbind(1):  # mixed in between: signs are the highest bits, two of which would cancel in a sum
        key = mix(key * ODD[3] + column * ODD[2])
    return key
