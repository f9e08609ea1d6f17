"""One optimisation of a density grid from pictures, with gradients from any program, for a given time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchrender as tr

from .ours import Ours
from .peers import Peer

# From densities (Z, Y, X, 1), a view and a seed: the gradient of the mean squared difference, and seconds it took.
Gradient = Callable[[torch.Tensor, int, int], tuple[torch.Tensor, float]]


@dataclass(frozen=True)
class Recipe:
    """What is the same for all programs."""

    size: int  # voxels along a side at the end
    seconds: float
    views: int
    spp: int = 16
    spp_grad: int = 8
    rate: float = 0.2
    start: float = 0.01  # density
    grow_at: tuple[float, float] = (0.15, 0.4)  # parts of the time after which the grid becomes twice as fine


@dataclass(frozen=True)
class Found:
    density: torch.Tensor
    iterations: int
    bad: int  # entries of gradients that were not finite, taken as 0


def gradient_of_ours(ours: Ours, parameter: str, targets: list[torch.Tensor], recipe: Recipe) -> Gradient:
    """This renderer's gradients."""

    def gradient(density: torch.Tensor, view: int, seed: int) -> tuple[torch.Tensor, float]:
        value = density.clone().requires_grad_()
        start = time.perf_counter()
        image = ours.renderer(
            sensor=view, seed=seed, spp=recipe.spp, spp_grad=recipe.spp_grad, params={parameter: value}
        )
        (found,) = torch.autograd.grad((image - targets[view]).square().mean(), value)
        return found, time.perf_counter() - start

    return gradient


def gradient_of_peer(peer: Peer, folder: Path, targets: list[torch.Tensor], recipe: Recipe) -> Gradient:
    """A peer's, by files in `folder`."""
    for view, target in enumerate(targets):
        np.save(folder / f"target{view}.npy", target.numpy())

    def gradient(density: torch.Tensor, view: int, seed: int) -> tuple[torch.Tensor, float]:
        values, result = folder / "values.npy", folder / "result.npy"
        np.save(values, density.numpy())
        answer = peer.ask(
            "loss_gradient",
            seed=seed,
            values=str(values),
            target=str(folder / f"target{view}.npy"),
            view=view,
            spp=recipe.spp,
            spp_grad=recipe.spp_grad,
            file=str(result),
        )
        return torch.from_numpy(np.load(result)).reshape(density.shape), answer["seconds"]

    return gradient


def reconstruct(gradient: Gradient, recipe: Recipe) -> Found:
    """Adam on the inverse sigmoid of densities, coarse to fine, one random view an iteration, until the time is up.

    Iterations count with the seconds that their gradient and their step take; the last one may go beyond.
    """
    bounded = tr.constraints.UnitInterval()
    coarse = max(1, recipe.size // 4)
    raw = torch.nn.Parameter(bounded.right_inverse(torch.full((coarse, coarse, coarse, 1), recipe.start)))
    # gradients of a mean by voxels are tiny, next to which the usual epsilon would be large
    optimiser = torch.optim.Adam([raw], lr=recipe.rate, betas=(0.9, 0.95), eps=1e-20)
    generator = torch.Generator().manual_seed(0)
    spent, iterations, bad, left = 0.0, 0, 0, list(recipe.grow_at)
    while spent < recipe.seconds:
        if left and spent >= left[0] * recipe.seconds and len(raw) < recipe.size:
            left.pop(0)
            raw = tr.optim.upsample_tensor(raw, (2 * len(raw),) * 3, optimiser, wrap_mode="clamp")
        for group in optimiser.param_groups:
            group["lr"] = recipe.rate * 0.5 * (1 + math.cos(math.pi * spent / recipe.seconds))
        view = int(torch.randint(recipe.views, (), generator=generator))
        density = bounded(raw)
        found, seconds = gradient(density.detach(), view, iterations)
        start = time.perf_counter()
        finite = torch.isfinite(found)
        bad += int((~finite).sum())
        optimiser.zero_grad()
        density.backward(torch.where(finite, found, 0.0))
        optimiser.step()
        spent += seconds + time.perf_counter() - start
        iterations += 1
    return Found(tr.optim.resample(bounded(raw).detach(), (recipe.size,) * 3, "clamp"), iterations, bad)


def psnr(found: torch.Tensor, true: torch.Tensor) -> float:
    """Peak signal-to-noise ratio in dB, the peak being 1."""
    return -10 * math.log10(max(float((found - true).square().mean()), 1e-20))
