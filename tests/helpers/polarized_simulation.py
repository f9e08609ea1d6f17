"""A plain simulation of polarised light in a ball of a scattering medium under a sun, as a textbook has it.

Mueller matrices are 4 x 4, each direction has a reference axis of its own, and matrices are turned by angles between
axes. It shares nothing with the renderer but the convention: a Stokes vector is as the receiver sees it, Q along the
axis, U 45 degrees counter-clockwise from it. Every sample is a smooth function of all parameters, collisions being made
within the ball: dual numbers give the derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

DOUBLE = torch.float64


@dataclass
class Ball:
    """What is seen: tensors, which may be dual numbers.

    Attributes:
        to_world: (4, 4) of the camera, which looks along +z of its own space.
        center, radius: of the ball.
        sun: (4, 4), a space along whose +z its light travels, and whose x axis is that of its Stokes vector.
        irradiance: what the sun brings on a plane across its light.
        shares: (3,), Q, U and V of that over I.
        sigma, albedo: extinction and albedo of the medium.
        share: of Rayleigh scattering; the rest is Henyey and Greenstein's with `g`, and depolarises.
    """

    to_world: torch.Tensor
    center: torch.Tensor
    radius: torch.Tensor
    sun: torch.Tensor
    irradiance: torch.Tensor
    shares: torch.Tensor
    sigma: torch.Tensor
    albedo: torch.Tensor
    share: torch.Tensor
    g: torch.Tensor

    def samples(self, orders: int, n: int, seed: int = 0) -> torch.Tensor:
        """Samples (n, 4) of the Stokes vector in the middle of the image, of so many orders of scattering at most."""
        generator = torch.Generator().manual_seed(seed)
        p, up, d = (self.to_world[:3, k].expand(n, 3) for k in (3, 1, 2))
        d, sun, sun_axis = _unit(d), _unit(self.sun[:3, 2]).expand(n, 3), _unit(self.sun[:3, 0]).expand(n, 3)
        light = torch.cat([torch.ones(1, dtype=DOUBLE), self.shares])
        axis = _unit(torch.linalg.cross(up, -d))  # the horizontal, of light that travels along -d
        p = p + d * self._ends(p, d)[0]
        through = self.irradiance * torch.eye(4, dtype=DOUBLE).expand(n, 4, 4)
        total = torch.zeros(n, 4, dtype=DOUBLE)
        for _ in range(orders):
            reach = 1 - torch.exp(-self.sigma * self._ends(p, d)[1])
            u = torch.rand(n, 1, generator=generator, dtype=DOUBLE)
            p = p - d * torch.log(1 - u * reach) / self.sigma
            through = through * (reach * self.albedo)[..., None]
            shade = torch.exp(-self.sigma * self._ends(p, -sun)[1])
            total = total + through @ self._scattering(sun, -d, axis, sun_axis) @ light * shade
            w = _unit(torch.randn(n, 3, generator=generator, dtype=DOUBLE))  # the next direction, uniform
            following = _any_axis(-w)
            through = through @ self._scattering(-w, -d, axis, following) * (4 * math.pi)
            d, axis = w, following
        return total

    def _ends(self, p: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The distances (n, 1) at which lines meet the ball."""
        o = p - self.center
        b = _dot(o, d)
        root = (b * b - _dot(o, o) + self.radius**2).clamp(min=1e-12).sqrt()
        return -b - root, -b + root

    def _scattering(self, arriving, leaving, leaving_axis, arriving_axis) -> torch.Tensor:
        """The phase matrix per solid angle between directions in which light travels, on the axes of both."""
        mu = _dot(arriving, leaving)[:, 0]
        normal = _unit(torch.linalg.cross(arriving, leaving))
        zero, g = torch.zeros_like(mu), self.g
        same, other, both = 1 + mu * mu, 1 - mu * mu, 2 * mu
        m = _matrix(
            [[same, other, zero, zero], [other, same, zero, zero], [zero, zero, both, zero], [zero, zero, zero, both]]
        )
        depolarised = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * mu) ** 1.5)
        first = torch.zeros(4, 4, dtype=DOUBLE)
        first[0, 0] = 1
        m = self.share * 3 / (16 * math.pi) * m + ((1 - self.share) * depolarised)[:, None, None] * first
        return _rotation(normal, leaving_axis, leaving) @ m @ _rotation(arriving_axis, normal, arriving)


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(-1, keepdim=True)


def _unit(v: torch.Tensor) -> torch.Tensor:
    return v / _dot(v, v).sqrt()


def _matrix(rows: list[list[torch.Tensor]]) -> torch.Tensor:
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _any_axis(k: torch.Tensor) -> torch.Tensor:
    """A unit vector across each direction."""
    x, y = torch.tensor([1.0, 0, 0], dtype=DOUBLE), torch.tensor([0, 1.0, 0], dtype=DOUBLE)
    return _unit(torch.linalg.cross(torch.where(k[:, :1].abs() > 0.9, y, x), k))


def _rotation(start: torch.Tensor, end: torch.Tensor, k: torch.Tensor) -> torch.Tensor:
    """The matrix that takes Stokes vectors from one axis to another one, of light that travels along k."""
    angle = torch.atan2(_dot(torch.linalg.cross(start, end), k), _dot(start, end))[:, 0]
    c, s = torch.cos(2 * angle), torch.sin(2 * angle)
    zero, one = torch.zeros_like(c), torch.ones_like(c)
    return _matrix([[one, zero, zero, zero], [zero, c, s, zero], [zero, -s, c, zero], [zero, zero, zero, one]])
