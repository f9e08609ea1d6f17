"""Bent rays through a box of voxels in plain PyTorch: the renderer's scheme in floating point, all steps on the tape.

In voxels, q, and voxels a step, u: half a kick, drifts and kicks in turn, until a drift crosses a face of the box, and
there tau - 1/2 of a kick, tau being the part of the last drift (Hairer, Lubich, Wanner, "Geometric Numerical
Integration", 2006, section I.1.4). Written from the equations, with the splines by their recursion.
"""

from __future__ import annotations

from typing import NamedTuple

import torch


def _spline(x: torch.Tensor, degree: int) -> torch.Tensor:
    """The centred B-spline of this degree, by Cox and de Boor's recursion over truncated powers."""
    if degree == 0:
        return ((x >= -0.5) & (x < 0.5)).to(x.dtype)
    k = (degree + 1) / 2
    return ((k + x) * _spline(x + 0.5, degree - 1) + (k - x) * _spline(x - 0.5, degree - 1)) / degree


def _slope(x: torch.Tensor, degree: int) -> torch.Tensor:
    return _spline(x + 0.5, degree - 1) - _spline(x - 0.5, degree - 1)


class Phi:
    """n^2 / 2 over voxels (Z, Y, X) from control values of n: `degree` 1, which has no continuous gradient, 2 or 3."""

    def __init__(self, index: torch.Tensor, degree: int) -> None:
        self.values, self.degree = index.square() / 2, degree

    def __call__(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Value (N,) and gradient (N, 3) at q (N, 3), x, y, z."""
        taps, weights, slopes = [], [], []
        for k in range(3):
            x = q[:, k : k + 1]
            first = (x.detach() - 0.5 * self.degree).floor().long()
            tap = first + torch.arange(self.degree + 1)
            off = x - (tap + 0.5)
            taps.append(tap.clamp(0, self.values.shape[2 - k] - 1))
            weights.append(_spline(off, self.degree))
            slopes.append(_slope(off, self.degree))
        near = self.values[taps[2][:, :, None, None], taps[1][:, None, :, None], taps[0][:, None, None, :]]

        def sum_of(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
            return torch.einsum("nzyx,nx,ny,nz->n", near, x, y, z)

        gradient = [sum_of(*(slopes[j] if j == k else weights[j] for j in range(3))) for k in range(3)]
        return sum_of(*weights), torch.stack(gradient, 1)


class BoxRays(NamedTuple):
    """Where rays leave the box: `position` and `velocity` in voxels, `optical` and `length` in steps.

    `depth` and `emitted`: optical depth, and radiance over n^2 as it comes out where the ray began.
    """

    position: torch.Tensor
    velocity: torch.Tensor
    optical: torch.Tensor
    length: torch.Tensor
    steps: torch.Tensor
    depth: torch.Tensor
    emitted: torch.Tensor


class Glow:
    """Absorption and emission (Z, Y, X) over the box of `voxels` (3,), trilinear, constant beyond outermost centres."""

    def __init__(self, sigma: torch.Tensor, eps: torch.Tensor, voxels: torch.Tensor, step: float) -> None:
        self.sigma, self.eps, self.voxels, self.step = sigma, eps, voxels, step

    def pieces(self, q: torch.Tensor, n: torch.Tensor, w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Depth and emission of pieces that kicks of weight w stand for, each homogeneous."""
        length = w * n * self.step
        x = self._at(self.sigma, q) * length
        mean = torch.where(x.abs() < 1e-6, 1 - x / 2, -torch.expm1(-x) / torch.where(x == 0, 1.0, x))
        return x, self._at(self.eps, q) / n**2 * length * mean

    def _at(self, grid: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
        size = torch.tensor(grid.shape[::-1], dtype=q.dtype)
        at = q / self.voxels * 2 - 1  # of PyTorch's own look-up, whose -1 and 1 are the edges of the outer voxels
        volume = grid[None, None]
        where = at.clamp(-1 + 1 / size, 1 - 1 / size)[None, :, None, None]
        found = torch.nn.functional.grid_sample(volume, where, mode="bilinear", align_corners=False)
        return found.reshape(-1)


def trace_box(
    phi: Phi, q: torch.Tensor, u: torch.Tensor, kick: torch.Tensor, most: int = 1000, glow: Glow | None = None
) -> BoxRays:
    """Rays from q with velocity u; `kick` (3, 3) is what grad Phi is multiplied with."""
    size = torch.tensor(phi.values.shape[::-1], dtype=q.dtype)
    depth = emitted = torch.zeros_like(q[:, 0])

    def shine(w: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        if glow is None:
            return depth, emitted
        x, light = glow.pieces(q, torch.sqrt(2 * value), w)
        return depth + x, emitted + torch.exp(-depth) * light

    value, slope = phi(q)
    u = u + slope @ kick / 2
    optical, length = value / 2, torch.sqrt(2 * value) / 2
    depth, emitted = shine(torch.full_like(value, 0.5))
    steps = torch.zeros(len(q), dtype=torch.int64)
    live = torch.ones(len(q), dtype=torch.bool)
    for _ in range(most):
        part, _ = _to_face(q, u, size)
        live = live & (part > 1)
        if not bool(live.any()):
            break
        q = torch.where(live[:, None], q + u, q)
        value, slope = phi(q)
        u = torch.where(live[:, None], u + slope @ kick, u)
        optical = torch.where(live, optical + value, optical)
        length = torch.where(live, length + torch.sqrt(2 * value), length)
        depth, emitted = shine(live.to(q.dtype))
        steps = steps + live
    part, _ = _to_face(q, u, size)
    q = q + part[:, None] * u
    value, slope = phi(q)
    rest = part - 0.5
    depth, emitted = shine(rest)
    return BoxRays(
        q,
        u + rest[:, None] * (slope @ kick),
        2 * (optical + rest * value),
        length + rest * torch.sqrt(2 * value),
        steps,
        depth,
        emitted,
    )


def _to_face(q: torch.Tensor, u: torch.Tensor, size: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The part of a drift to the face of the box that it leads to."""
    ahead = torch.where(u > 0, size, torch.zeros_like(size))
    still = u == 0
    part = torch.where(still, torch.inf, (ahead - q) / torch.where(still, 1.0, u))
    found = part.min(1)
    return found.values, found.indices
