"""When gradients have become noise: a criterion for ending an optimisation, or for a smaller step size."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch

from ..errors import describe


class NoiseStop:
    """Says when the gradients of the last steps no longer agree on a direction, more than chance makes them.

    Gradients of a rendering are unbiased, and the noise of each is independent of all before it, as long as every step
    has a seed of its own. Within a window of steps let M_i be the sum of the first i gradients g_1, ..., g_i. Where
    the true gradient is zero, g_i M_{i-1} is zero on average whatever came before (a martingale difference), and ::

        signal = sum_i g_i M_{i-1} / sqrt(sum_i (g_i M_{i-1})^2)

    is about standard normal for many parameters, and smaller for few (for one it is the statistic of Dickey and Fuller,
    1979). Where there is a slope, it grows to sqrt(3 n) / 2 in a window of n steps; where steps are so long that they
    leap to and fro, it is negative. Products are summed over all parameters, each tensor divided by the mean square of
    its gradients before, so that units do not matter. Once `signal` is below `threshold` in `patience` windows in a
    row, more steps of this size gain nothing: stop, or go on with smaller ones.

    Inner products of successive gradients are Pflug's criterion ("Non-asymptotic confidence bounds for stochastic
    approximation algorithms with constant step size", Monatshefte für Mathematik 110, 1990; Chee and Toulis,
    "Convergence diagnostics for stochastic gradient descent with constant learning rate", AISTATS 2018); all pairs of a
    window, as here, show a weaker slope. Comparing gradients with their noise: Mahsereci, Balles, Lassner and Hennig,
    "Early stopping without a validation set", 2017.

    In a loop::

        stop = tr.optim.NoiseStop(optimizer)
        for it in range(1000):
            ...  # zero_grad, render with seed=it, backward, optimizer.step()
            if stop():
                break

    Args:
        params: an optimiser, or the tensors whose gradients are looked at.
        window: steps in a window, at least 4.
        threshold: in standard errors. Without any slope a window is below 1 with a probability of 0.84.
        patience: windows in a row.

    Attributes:
        signal: of the last complete window; infinite before the first.

    Raises:
        TypeError, ValueError: for arguments out of range.
    """

    def __init__(
        self,
        params: torch.optim.Optimizer | Iterable[torch.Tensor],
        window: int = 50,
        threshold: float = 1.0,
        patience: int = 2,
    ) -> None:
        if isinstance(params, torch.optim.Optimizer):
            params = [p for group in params.param_groups for p in group["params"]]
        self.params = [params] if isinstance(params, torch.Tensor) else list(params)
        for parameter in self.params:
            if not isinstance(parameter, torch.Tensor):
                raise TypeError(f"params: expected an optimiser or tensors, got {describe(parameter)}")
        if not self.params:
            raise ValueError("params: expected tensors, got none")
        if not window >= 4:
            raise ValueError(f"window: expected at least 4 steps, got {window!r}")
        if not patience >= 1:
            raise ValueError(f"patience: expected at least 1 window, got {patience!r}")
        self.window, self.threshold, self.patience = int(window), float(threshold), int(patience)
        self.signal = math.inf
        self._below = 0
        self._begin()

    def _begin(self) -> None:
        self._steps, self._sum, self._squares = 0, 0.0, 0.0
        # by parameter: sum of the gradients, sum of their squares, number
        self._past: dict[int, tuple[torch.Tensor, float, int]] = {}

    @torch.no_grad()
    def __call__(self) -> bool:
        """Look at the gradients of a step; whether they have been noise for long enough.

        Gradients that are None, and tensors without any, count as zero.
        """
        product = 0.0
        for i, parameter in enumerate(self.params):
            gradient = parameter.grad
            if gradient is None:
                continue
            squared = float(gradient.double().square().sum())
            if not math.isfinite(squared):
                raise ValueError(f"params: the gradient of number {i} is not finite")
            if i in self._past:
                total, size, count = self._past[i]
                product += float((gradient * total).sum()) * count / size if size > 0 else 0.0
                self._past[i] = total.add_(gradient), size + squared, count + 1
            else:
                self._past[i] = gradient.clone(), squared, 1
        self._steps += 1
        self._sum += product
        self._squares += product**2
        if self._steps < self.window:
            return self._below >= self.patience
        self.signal = self._sum / math.sqrt(self._squares) if self._squares > 0 else 0.0
        self._below = self._below + 1 if self.signal < self.threshold else 0
        self._begin()
        return self._below >= self.patience
