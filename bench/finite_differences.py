"""Derivatives of a picture by sums of voxels, from pictures alone: what unbiased gradients have to agree with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, variance

import numpy as np
import torch

from .ours import Ours
from .serving import weight_of

THIN = 0.5  # densities from 0 to this are thin, others dense
BLOCKS = 4  # along each side
STEP = 0.12  # of optical depth, along a side of a changed region
SEED = 1 << 41  # far from the gradients'


@dataclass(frozen=True)
class Sums:
    """A mean of independent numbers, with its squared standard error."""

    mean: float
    error2: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Sums:
        return cls(fmean(values), variance(values) / len(values))

    def z(self, other: Sums) -> float:
        """The difference from another mean, in its standard deviations; 0 if both are the same without any error."""
        error = math.sqrt(self.error2 + other.error2)
        difference = self.mean - other.mean
        return difference / error if error else math.copysign(math.inf, difference) if difference else 0.0


def groups_of(density: np.ndarray) -> dict[str, np.ndarray]:
    """Masks (Z, Y, X, 1) of cells: all, empty, thin and dense ones, and blocks by their place."""
    groups = {"all": np.ones_like(density, bool), "empty": density == 0}
    groups |= {"thin": (density > 0) & (density < THIN), "dense": density >= THIN}
    edges = [np.linspace(0, n, BLOCKS + 1).round().astype(int) for n in density.shape[:3]]
    for k in range(BLOCKS):
        for j in range(BLOCKS):
            for i in range(BLOCKS):
                mask = np.zeros_like(density, bool)
                mask[edges[0][k] : edges[0][k + 1], edges[1][j] : edges[1][j + 1], edges[2][i] : edges[2][i + 1]] = True
                groups[f"block {k} {j} {i}"] = mask
    return {name: mask for name, mask in groups.items() if mask.any()}


def derivatives(
    ours: Ours, parameter: str, density: np.ndarray, groups: dict[str, np.ndarray], side: float, spp: int, runs: int
) -> dict[str, Sums]:
    """d mean(image * weight) / d t at t = 0, where t is added to the density of a group's cells.

    Densities must not be negative, so the differences are to one side, with two steps, which makes the error of second
    order in the step: f'(0) = (-3 f(0) + 4 f(h) - f(2 h)) / (2 h). The pictures of one run have the same random
    numbers: most paths do not meet the changed cells and cancel. `side` is the optical depth of a density of 1 along
    the whole grid.
    """
    start = torch.from_numpy(density.copy())
    added = {name: torch.from_numpy(mask.astype(np.float32)) for name, mask in groups.items()}

    def scalar(seed: int, value: torch.Tensor) -> float:
        with torch.no_grad():
            image = ours.renderer(seed=seed, spp=spp, params={parameter: value})
        return float((image.double() * torch.from_numpy(weight_of(*image.shape[:2], np))).mean())

    found: dict[str, list[float]] = {name: [] for name in groups}
    for number in range(max(2, runs)):
        seed = SEED + number
        here = scalar(seed, start)
        for name, mask in added.items():
            h = STEP / side * (BLOCKS if name.startswith("block") else 1)
            once, twice = (scalar(seed, start + steps * h * mask) for steps in (1, 2))
            found[name].append((-3 * here + 4 * once - twice) / (2 * h))
    return {name: Sums.of(values) for name, values in found.items()}
