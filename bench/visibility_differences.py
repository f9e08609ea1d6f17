"""Derivatives of a picture by a motion, from pictures alone: what unbiased derivatives have to agree with."""

from __future__ import annotations

import numpy as np
import torch

from .finite_differences import SEED, Sums
from .serving import weight_of
from .visibility_ours import Moved


def differences(moved: Moved, spp: int, runs: int) -> Sums:
    """d mean(image * weight) / d t at t = 0, where the thing is moved by t along its direction.

    Central differences D(h) and D(h / 2), of the same random numbers in all four pictures of a run, give
    (4 D(h / 2) - D(h)) / 3, whose error is of fourth order in the step.
    """

    def scalar(seed: int, amount: float) -> float:
        with torch.no_grad():
            image = moved.renderer(seed=seed, spp=spp, sampler="sobol", params=moved.at(torch.tensor(amount)))
        return float((image.double() * torch.from_numpy(weight_of(*image.shape[:2], np))).mean())

    def central(seed: int, step: float) -> float:
        return (scalar(seed, step) - scalar(seed, -step)) / (2 * step)

    h = moved.moving.step
    return Sums.of([(4 * central(SEED + i, h / 2) - central(SEED + i, h)) / 3 for i in range(max(2, runs))])
