"""A learning rate by trial, for losses that are noisy."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import torch


def find_rate(
    optimizer: torch.optim.Optimizer,
    step: Callable[[int], torch.Tensor | float],
    *,
    steps: int = 20,
    factor: float = 3.0,
    trials: int = 12,
) -> float:
    """The learning rate with which a few steps from here bring the loss down furthest.

    Rates are tried one after the other, each from the same parameters, the same state of the optimiser, and the same
    random numbers, beginning with the one that the optimiser has: larger ones by `factor` as long as that makes the
    loss smaller, and smaller ones if no larger one did. A rate is better than another if the losses of its last third
    of steps are smaller by more than the standard error of their differences, step by step: equal seeds make most of
    the noise cancel in these. So of rates that noise cannot tell apart the first one tried is kept. Afterwards
    parameters, optimiser and torch's generator are as before. Trying rates over a range: Smith, "Cyclical learning
    rates for training neural networks", WACV 2017, section 3.3, there in one run whose rate grows.

        def step(it):
            optimizer.zero_grad()
            loss = (tr.render(scene, spp=16, seed=it) - target).square().mean()
            loss.backward()
            optimizer.step()
            return loss

        for group in optimizer.param_groups:
            group["lr"] = tr.optim.find_rate(optimizer, step)

    Args:
        optimizer: with the first rate to be tried. Where its groups have several, their ratios are kept.
        step: makes one step of the optimisation, of the number that it gets, and returns the loss before it.
        steps: of each trial, at least 6. As many as an optimisation takes to gain something that can be seen.
        factor: between rates, more than 1.
        trials: rates that are tried, at most.

    Returns:
        The rate of the first group.

    Raises:
        ValueError: for arguments out of range, and if the loss of the first trial is not finite.
    """
    if not steps >= 6:
        raise ValueError(f"steps: expected at least 6, got {steps!r}")
    if not factor > 1:
        raise ValueError(f"factor: expected a number larger than 1, got {factor!r}")
    if not trials >= 2:
        raise ValueError(f"trials: expected at least 2, got {trials!r}")
    rates = [float(group["lr"]) for group in optimizer.param_groups]
    if not rates[0] > 0:
        raise ValueError(f"optimizer: expected a learning rate above 0 to begin with, got {rates[0]!r}")
    start = _State(optimizer)

    def losses(scale: float) -> torch.Tensor:
        """Those of the last third of a trial's steps; infinite from the first one on that is not finite."""
        start.restore()
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * scale
        found = torch.full((steps,), math.inf, dtype=torch.float64)
        for i in range(steps):
            found[i] = torch.as_tensor(step(i)).detach()
            if not bool(found[i].isfinite()):
                found[i] = math.inf
                break
        return found[-(steps // 3) :]

    try:
        best, scale, left = losses(1.0), 1.0, trials - 1
        if not bool(best.isfinite().all()):
            raise ValueError(f"optimizer: the loss is not finite with its learning rate {rates[0]!r}; begin lower")
        for direction in (factor, 1 / factor):
            while left > 0:
                left -= 1
                other = losses(scale * direction)
                if not _smaller(other, best):
                    break
                best, scale = other, scale * direction
            if scale != 1:
                break
    finally:
        start.restore()
    return rates[0] * scale


def _smaller(losses: torch.Tensor, others: torch.Tensor) -> bool:
    """Whether losses are below others by more than the standard error of the mean of their differences."""
    gain = others - losses
    return bool(losses.isfinite().all()) and float(gain.mean()) > float(gain.std()) / math.sqrt(len(gain))


class _State:
    """Parameters, gradients, an optimiser's state and torch's generator, to come back to."""

    def __init__(self, optimizer: torch.optim.Optimizer) -> None:
        self.optimizer = optimizer
        self.params = [p for group in optimizer.param_groups for p in group["params"]]
        self.values = [p.detach().clone() for p in self.params]
        self.gradients = [None if p.grad is None else p.grad.clone() for p in self.params]
        self.state: dict[str, Any] = copy.deepcopy(optimizer.state_dict())
        self.random = torch.get_rng_state()

    @torch.no_grad()
    def restore(self) -> None:
        for parameter, value, gradient in zip(self.params, self.values, self.gradients, strict=True):
            parameter.copy_(value)
            parameter.grad = None if gradient is None else gradient.clone()
        self.optimizer.load_state_dict(copy.deepcopy(self.state))
        torch.set_rng_state(self.random)
