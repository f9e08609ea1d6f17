"""Recursive control variates: an estimate serves the next step, whose parameters have changed a little.

Nicolet, Rousselle, Novák, Keller, Jakob, Müller, "Recursive Control Variates for Inverse Rendering", ACM Transactions
on Graphics 42 (4), 2023; of a gradient it is STORM (Cutkosky and Orabona, "Momentum-Based Variance Reduction in
Non-Convex SGD", NeurIPS 2019). With F_t an estimate from fresh random numbers, and H_t one from the same numbers at the
parameters of the step before,

    P_t = F_t + w_t (P_{t-1} - H_t),

whose expectation is that of F_t if w_t does not depend on the noise of P_{t-1} and H_t. A weight from running variances
of the same samples does. So two chains are run, each with half of the samples, and with the weights that the other
one's fresh samples give: the mean of both is unbiased after any number of steps, whatever the samples' distribution.
(Parameters that an optimiser finds follow the noise of earlier steps: given them, the error of P_{t-1} is no longer
zero in the mean. It is what momentum has, too.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

BLOCK = 768  # numbers, one after the other, that share a weight: 256 pixels of three channels
MEMORY = 0.7  # of what moments have been, in those after a step


@dataclass(frozen=True)
class Chain:
    """One of two, after a step.

    Attributes:
        estimate: P, flat.
        fresh: F, flat.
        moments: of the fresh samples (3, blocks): var H, cov(H, F - H), E[(F - H)^2]; None before the second step.
        variance: that of P (blocks,), as the other chain's moments say; None before the second step.
    """

    estimate: torch.Tensor
    fresh: torch.Tensor
    moments: torch.Tensor | None = None
    variance: torch.Tensor | None = None

    def observed(self, fresh: torch.Tensor, old: torch.Tensor) -> torch.Tensor:
        """The moments after one more step; `fresh` is F, `old` H.

        H and the fresh estimate of the step before are independent and belong to the same parameters, so that half the
        mean square of their difference is the variance of each, and its mean product with F - H a covariance, without
        knowing the expectations. The mean square of F - H has the change of the picture besides its noise: weights are
        then a little smaller than the best ones.
        """
        change, noise = fresh - old, old - self.fresh
        moments = torch.stack(
            [block_means(noise * noise) / 2, block_means(noise * change), block_means(change * change)]
        )
        return moments if self.moments is None else torch.lerp(moments, self.moments, MEMORY)

    def advanced(self, fresh: torch.Tensor, old: torch.Tensor, own: torch.Tensor, others: torch.Tensor) -> Chain:
        """The next step, by the moments of the other chain; `own` ones are for that."""
        spread, drift, change = others
        bound = (spread * change).sqrt()
        drift = torch.minimum(torch.maximum(drift, -bound), bound)
        before = spread if self.variance is None else self.variance
        both = spread + before
        weight = torch.where(both > 0, ((spread + drift) / both).clamp(0, 1), 0)  # cov(F, H) / (var H + var P)
        rest = 1 - weight
        variance = rest**2 * spread + 2 * rest * drift + change + weight**2 * before
        estimate = fresh + spread_blocks(weight, len(fresh)) * (self.estimate - old)
        return Chain(estimate, fresh, own, variance)


@dataclass(frozen=True)
class Recursion:
    """A tensor that is estimated step by step by two independent chains: none before the first step."""

    chains: tuple[Chain, ...] = ()

    def step(self, fresh: Sequence[torch.Tensor], old: Sequence[torch.Tensor] | None) -> tuple[torch.Tensor, Recursion]:
        """The mean of both chains after a step, and what the next one goes on from.

        Args:
            fresh: independent estimates, one a chain, of one shape.
            old: what the same random numbers give at the parameters of the step before; None begins anew.
        """
        flat = [tensor.detach().reshape(-1) for tensor in fresh]
        if old is None or not self.chains:
            chains = tuple(Chain(tensor, tensor) for tensor in flat)
        else:
            olds = [tensor.detach().reshape(-1) for tensor in old]
            numbers = list(zip(self.chains, flat, olds, strict=True))
            moments = [chain.observed(new, at_old) for chain, new, at_old in numbers]
            chains = tuple(
                chain.advanced(new, at_old, moments[i], moments[1 - i])
                for i, (chain, new, at_old) in enumerate(numbers)
            )
        first, second = chains
        return ((first.estimate + second.estimate) / 2).reshape(fresh[0].shape), Recursion(chains)

    def state(self) -> list[dict[str, Any]]:
        """Of a checkpoint."""
        return [vars(chain).copy() for chain in self.chains]

    @classmethod
    def restored(cls, state: list[dict[str, Any]]) -> Recursion:
        """The inverse of `state`."""
        return cls(tuple(Chain(**chain) for chain in state))


def block_means(values: torch.Tensor) -> torch.Tensor:
    """Means over blocks of a flat tensor; the last block may be shorter."""
    whole = len(values) // BLOCK * BLOCK
    means = values[:whole].view(-1, BLOCK).mean(1)
    return means if whole == len(values) else torch.cat([means, values[whole:].mean().view(1)])


def spread_blocks(weights: torch.Tensor, count: int) -> torch.Tensor:
    """Each block's weight for all of its numbers, `count` in all."""
    return weights[:, None].expand(-1, BLOCK).reshape(-1)[:count]
