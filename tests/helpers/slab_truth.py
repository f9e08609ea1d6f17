"""Radiance of plane layers that absorb, emit and scatter any number of times: deterministic, and differentiable.

Discrete ordinates (Chandrasekhar, Radiative Transfer, 1950): radiance in N directions upward and N downward, Gauss's
nodes on (0, 1), obeys a linear differential equation, whose solution in a thin layer is a matrix exponential. Layers
are put together by adding and doubling (van de Hulst, Multiple Light Scattering, 1980). One more node at cosine 1 with
weight 0 is what a vertical camera ray sees.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch

NODES = 16


@contextmanager
def one_thread() -> Iterator[None]:
    """The matrices are small: several threads would wait for each other."""
    kept = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(kept)


def directions() -> tuple[torch.Tensor, torch.Tensor]:
    """Cosines and weights of one hemisphere; the last, with weight 0, is the vertical."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    return torch.tensor([*(0.5 + 0.5 * x), 1.0]), torch.tensor([*(0.5 * w), 0.0])


def azimuthal_mean(g: torch.Tensor, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """4 pi times Henyey and Greenstein's function between cosines a and b to the vertical, averaged over azimuths."""
    total, previous, last = torch.zeros(len(a), len(b), dtype=a.dtype), [1 + 0 * a, 1 + 0 * b], [a, b]
    for order in range(2 * NODES):
        total = total + (2 * order + 1) * g**order * torch.outer(*previous)
        # Legendre's recursion
        following = [
            ((2 * order + 3) * x * p - (order + 1) * q) / (order + 2)
            for x, p, q in zip((a, b), last, previous, strict=True)
        ]
        previous, last = last, following
    return total


@dataclass
class Layer:
    """Transmission upward and downward, reflection at the bottom and at the top, light emitted upward and downward.

    Upward light at the top is `up @ below + top @ above + glow_up`, downward light at the bottom
    `down @ above + bottom @ below + glow_down`.
    """

    up: torch.Tensor
    down: torch.Tensor
    bottom: torch.Tensor
    top: torch.Tensor
    glow_up: torch.Tensor
    glow_down: torch.Tensor

    def under(self, other: Layer) -> Layer:
        """This layer and another one on it."""
        eye = torch.eye(len(self.up), dtype=self.up.dtype)
        rising = torch.linalg.inv(eye - self.top @ other.bottom)
        falling = torch.linalg.inv(eye - other.bottom @ self.top)
        return Layer(
            other.up @ rising @ self.up,
            self.down @ falling @ other.down,
            self.bottom + self.down @ falling @ other.bottom @ self.up,
            other.top + other.up @ rising @ self.top @ other.down,
            other.glow_up + other.up @ rising @ (self.glow_up + self.top @ other.glow_down),
            self.glow_down + self.down @ falling @ (other.glow_down + other.bottom @ self.glow_up),
        )


def layer(sigma: torch.Tensor, albedo: torch.Tensor, emission: torch.Tensor, g: torch.Tensor, height: float) -> Layer:
    """A layer of constant extinction, albedo, emission and mean cosine."""
    cosine, weight = directions()
    n = len(cosine)
    both, weights = torch.cat([cosine, -cosine]), torch.cat([weight, weight])
    phase = azimuthal_mean(g, both, both)
    rate = sigma * (0.5 * albedo * phase * weights - torch.eye(2 * n, dtype=torch.float64)) / both[:, None]
    source = (emission / both)[:, None]
    doublings = max(0, int(np.ceil(np.log2(max(1.0, float(sigma.detach()) * height / float(cosine.min()))))))
    part = height / 2**doublings
    row = torch.zeros(1, 2 * n + 1, dtype=torch.float64)
    whole = torch.linalg.matrix_exp(torch.cat([torch.cat([rate, source], 1), row]) * part)
    uu, ud, us = whole[:n, :n], whole[:n, n : 2 * n], whole[:n, -1]
    du, dd, ds = whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n], whole[n : 2 * n, -1]
    down = torch.linalg.inv(dd)
    made = Layer(uu - ud @ down @ du, down, -down @ du, ud @ down, us - ud @ down @ ds, -down @ ds)
    for _ in range(doublings):
        made = made.under(made)
    return made


def vertical_radiance(
    sigma: torch.Tensor,
    albedo: torch.Tensor,
    emission: torch.Tensor | None = None,
    g: torch.Tensor | float = 0.0,
    *,
    height: float = 1.0,
    sky: torch.Tensor | float = 1.0,
    floor: torch.Tensor | float = 0.0,
) -> tuple[torch.Tensor, torch.Tensor]:
    """What is seen straight downward from above, and straight upward from below: two numbers.

    Args:
        sigma, albedo, emission: of K layers of one height, the lowest first: (K,).
        g: mean cosine of Henyey and Greenstein's function.
        sky: radiance from all directions above.
        floor: albedo of a diffuse floor below everything.
    """
    cosine, weight = directions()
    emission = torch.zeros_like(sigma) if emission is None else emission
    g = torch.as_tensor(g, dtype=torch.float64)
    layers = [layer(s, a, e, g, height) for s, a, e in zip(sigma, albedo, emission, strict=True)]
    stack = layers[0]
    for other in layers[1:]:
        stack = stack.under(other)
    one = torch.ones_like(cosine)
    reflect = floor * 2 * torch.outer(one, cosine * weight)
    falling = torch.linalg.solve(
        torch.eye(len(cosine), dtype=torch.float64) - stack.bottom @ reflect,
        stack.down @ (sky * one) + stack.glow_down,
    )
    rising = stack.up @ reflect @ falling + stack.top @ (sky * one) + stack.glow_up
    return rising[-1], falling[-1]


def h_function(albedo: float, cosine: float = 1.0, nodes: int = 64) -> float:
    """Chandrasekhar's H of isotropic scattering, by iteration of its integral equation."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    mu, w = 0.5 + 0.5 * x, 0.5 * w
    h = np.ones(nodes)

    def inverse(at: np.ndarray) -> np.ndarray:
        return np.sqrt(1 - albedo) + 0.5 * albedo * ((w * mu * h) / (at[:, None] + mu)).sum(1)

    for _ in range(2000):
        h = 0.5 * (h + 1 / inverse(mu))
    return float(1 / inverse(np.array([cosine]))[0])
