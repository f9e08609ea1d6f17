"""The samplers number by number, in integers of any size: csrc/core/sampler/ from the papers' formulas."""

from __future__ import annotations

import math

import numpy as np

ONE = 1 << 32
MASK = ONE - 1
KEY_BLOCKS = 1 << 31
LARGEST_PATTERN = 1 << 16
TILE = 16  # pixels on a side, at most, that share a Sobol sequence


def philox(counter: tuple[int, int, int, int], seed: int) -> list[int]:
    """Philox4x32 with 7 rounds."""
    c, k0, k1 = list(counter), seed & MASK, seed >> 32
    for _ in range(7):
        first, second = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(second >> 32) ^ c[1] ^ k0, second & MASK, (first >> 32) ^ c[3] ^ k1, first & MASK]
        k0, k1 = (k0 + 0x9E3779B9) & MASK, (k1 + 0xBB67AE85) & MASK
    return c


def permutation(n: int, key: int) -> list[int]:
    """A permutation of 0 .. n - 1: rounds that are one-to-one on as many bits, until below n; then a rotation."""
    bits = max(1, (n - 1).bit_length())
    keys = [key * factor & MASK for factor in (0x9E3779B1, 0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)]
    keys = [k ^ k >> 15 for k in keys]
    rotation = (key * 0xD3833E81 & MASK) * n >> 32
    found = []
    for i in range(n):
        while True:
            for k in keys:
                i = (i + (k >> 16)) * (k | 1) & (1 << bits) - 1
                i ^= i >> (bits + 1) // 2
            if i < n:
                break
        found.append((i + rotation) % n)
    return found


def stratified4(n: int, first: int, seed: int, sensor: int, pixel: int, sample: int, block: int) -> list[float]:
    """A pair, a number stratified by itself and a free one, of one of n samples, in [0, 1)."""
    patterns = -(-n // LARGEST_PATTERN)
    n = -(-n // patterns)
    within = (sample - first) % n
    jitter = [x / ONE for x in philox((pixel, sample, block, sensor), seed)]
    keys = philox((pixel, sample - within, block | KEY_BLOCKS, sensor), seed)
    columns = math.isqrt(n)
    rows = -(-n // columns)
    stratum = permutation(n, keys[0])[within]
    row, column = divmod(stratum, columns)
    x = (permutation(columns, keys[2])[column] + (permutation(rows, keys[1])[row] + jitter[0]) / rows) / columns
    return [x, (stratum + jitter[1]) / n, (permutation(n, keys[3])[within] + jitter[2]) / n, jitter[3]]


def reverse(x: int) -> int:
    return int(f"{x:032b}"[::-1], 2)


def scramble(x: int, key: int) -> int:
    """Owen's nested scrambling of a 32-bit fraction by a hash (Laine and Karras, Burley, Vegdahl)."""
    x = reverse(x)
    x ^= x * 0x3D20ADEA & MASK
    x = (x + key) * (key >> 16 | 1) & MASK
    x ^= x * 0x05526C56 & MASK
    x ^= x * 0x53A22864 & MASK
    return reverse(x)


def direction_numbers() -> list[list[int]]:
    """Columns of the first four dimensions' generator matrices as 32-bit fractions, from Joe and Kuo's table."""
    found = [[1 << (31 - i) for i in range(32)]]
    for degree, coefficients, initial in ((1, 0, [1]), (2, 1, [1, 3]), (3, 1, [1, 3, 1])):
        m = list(initial)
        for i in range(degree, 32):
            term = m[i - degree] ^ m[i - degree] << degree
            for k in range(1, degree):
                term ^= (coefficients >> (degree - 1 - k) & 1) * m[i - k] << k
            m.append(term)
        found.append([m[i] << (31 - i) for i in range(32)])
    return found


DIRECTIONS = direction_numbers()


def sobol_point(index: int) -> list[int]:
    """Four coordinates of the unscrambled sequence, 32-bit fractions."""
    x = [0, 0, 0, 0]
    for i in range(32):
        if index >> i & 1:
            x = [a ^ columns[i] for a, columns in zip(x, DIRECTIONS, strict=True)]
    return x


def sobol4(n: int, first: int, seed: int, sensor: int, pixel: int, sample: int, block: int) -> list[float]:
    """Four coordinates of one of n samples, in [0, 1)."""
    size = min(1 << (n - 1).bit_length(), LARGEST_PATTERN)
    within = (sample - first) % size
    side = TILE
    while side * side * size > LARGEST_PATTERN:
        side //= 2
    row, column = pixel >> 16, pixel & 0xFFFF
    tile = (row - row % side) << 16 | column - column % side
    row, column = row % side, column % side
    keys = philox((tile, sample - within, block | KEY_BLOCKS, sensor), seed)
    fifth = keys[2] ^ keys[3] >> 1
    fifth = (fifth ^ fifth >> 16) * 0x85EBCA6B & MASK
    fifth = (fifth ^ fifth >> 13) * 0xC2B2AE35 & MASK
    keys.append(fifth ^ fifth >> 16)
    place = sum((column >> i & 1) << 2 * i | (row >> i & 1) << 2 * i + 1 for i in range(4))
    shuffled = scramble(place * size + within, keys[0]) % (side * side * size)
    return [scramble(x, key) / ONE for x, key in zip(sobol_point(shuffled), keys[1:], strict=True)]


def draw4(sampler: str, n: int, first: int, seed: int, sensor: int, pixel: int, sample: int, block: int) -> np.ndarray:
    """The four numbers of a block of a sample in the renderer's order, not yet rounded down to 24 bits."""
    if sampler == "independent":
        return np.array(philox((pixel, sample, block, sensor), seed)) / ONE
    u = {"stratified": stratified4, "sobol": sobol4}[sampler](n, first, seed, sensor, pixel, sample, block)
    return np.array(u if block == 0 else [u[2], u[0], u[1], u[3]])
