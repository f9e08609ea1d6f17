"""Points of curves in plain PyTorch, as csrc/core/shape/curve.h has them: functions that autograd differentiates.

K points, each on a segment with control points (K, 4, 3) and radii (K, 4), of which a straight segment uses the first
two. Coordinates are b1, the azimuth in turns, and b2, the place along the segment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch


@dataclass
class Segments:
    """Control points (K, 4, 3) and radii (K, 4) of a segment for each of K points; `straight`: all of them are."""

    points: torch.Tensor
    radii: torch.Tensor
    straight: bool

    def axis(self, place: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Centre, its first two derivatives (K, 3), radius and its derivative (K,) at `place` (K,) in [0, 1]."""
        f, g, zero = place, 1 - place, torch.zeros_like(place)
        if self.straight:
            weights = [[g, f, zero, zero], [zero - 1, zero + 1, zero, zero], [zero] * 4]
        else:
            cube = [g**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - g * g * (1 - g / 2), f**3 / 6]
            weights = [
                cube,
                [-g * g / 2, f * (1.5 * f - 2), g * (2 - 1.5 * g), f * f / 2],
                [g, 3 * f - 2, 1 - 3 * f, f],
            ]
        w, slope, curvature = (torch.stack(row, 1) for row in weights)
        c, d, dd = ((self.points * x[..., None]).sum(1) for x in (w, slope, curvature))
        return c, d, dd, (self.radii * w).sum(1), (self.radii * slope).sum(1)

    def evaluate(self, b1: torch.Tensor, b2: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The points and their derivatives by b2, along the curve, and by b1, around it: each (K, 3)."""
        place = b2.clamp(0, 1)
        c, d, dd, r, dr = self.axis(place)
        t, n, b, length = _frame(d)
        phi = 2 * math.pi * b1[:, None]
        e, turned = n * phi.cos() + b * phi.sin(), b * phi.cos() - n * phi.sin()
        r, dr = r[:, None], dr[:, None]
        if self.straight:
            beyond = (b2 - place)[:, None]
            s = beyond - dr / length
            level = (1 - s * s).clamp(min=1e-10).sqrt()
            m = e * level + t * s
            along = torch.where(beyond != 0, (t - e * (s / level)) * r, d + m * dr)
            return c + m * r, along, turned * (2 * math.pi * r * level)
        bend = (dd - t * _dot(t, dd)) / length
        kappa = (bend[:, :1] * b[:, 1:2] - bend[:, 1:2] * b[:, :1]) / (t[:, :1] ** 2 + t[:, 1:2] ** 2).sqrt()
        return c + e * r, d + e * dr + (turned * kappa - t * _dot(bend, e)) * r, turned * (2 * math.pi * r)

    def meet(
        self, o: torch.Tensor, d: torch.Tensor, near: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Distance and coordinates (K,) where rays (K, 3) meet their segments, near these distances."""
        t, place = near.detach(), self._nearest((o + d * near[:, None]).detach())
        sphere = (place <= 0) | (place >= 1) if self.straight else torch.zeros_like(place, dtype=torch.bool)
        # Newton's iteration to convergence, and from there on attached: each step doubles the right derivatives
        for step in range(11):
            if step == 8:
                t, place = t.detach(), place.detach()
            t, place = self._step(o, d, t, place, sphere)
        c, axis, _, _, dr = self.axis(place)
        frame_t, n, b, length = _frame(axis)
        x = o + d * t[:, None] - c
        azimuth = torch.atan2(_dot(x, b)[:, 0], _dot(x, n)[:, 0]) / (2 * math.pi)
        b1, b2 = torch.where(azimuth < 0, azimuth + 1, azimuth), place
        if self.straight:
            beyond = _dot(x, frame_t)[:, 0] / torch.linalg.vector_norm(x, dim=1) + dr / length[:, 0]
            beyond = torch.where(place <= 0, beyond.clamp(max=0), beyond.clamp(min=0))
            b2 = torch.where(sphere, place + beyond, place)
        return t, b1, b2

    def _step(
        self, o: torch.Tensor, d: torch.Tensor, t: torch.Tensor, place: torch.Tensor, sphere: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """A step of Newton's for (x - c).c' = 0, on a cone -r r', and |x - c| = r."""
        c, axis, dd, r, dr = self.axis(place)
        x = o + d * t[:, None] - c
        on_cone = float(self.straight)
        f1 = _dot(x, axis)[:, 0] + on_cone * r * dr
        f2 = _dot(x, x)[:, 0] - r * r
        m00, m01 = _dot(d, axis)[:, 0], _dot(x, dd)[:, 0] - _dot(axis, axis)[:, 0] + on_cone * dr * dr
        m10, m11 = 2 * _dot(x, d)[:, 0], -2 * (_dot(x, axis)[:, 0] + r * dr)
        f1, m00 = torch.where(sphere, 0.0, f1), torch.where(sphere, 0.0, m00)
        m01, m11 = torch.where(sphere, 1.0, m01), torch.where(sphere, 0.0, m11)
        determinant = m00 * m11 - m01 * m10
        inverse = torch.where(determinant == 0, 0.0, 1 / torch.where(determinant == 0, 1.0, determinant))
        moved = place - (f2 * m00 - f1 * m10) * inverse
        return t - (f1 * m11 - f2 * m01) * inverse, moved.clamp(0, 1)

    def _nearest(self, x: torch.Tensor) -> torch.Tensor:
        """Roughly the place (K,) on whose circle points (K, 3) lie."""
        with torch.no_grad():
            if self.straight:
                d, r0, dr = self.points[:, 1] - self.points[:, 0], self.radii[:, 0], self.radii[:, 1] - self.radii[:, 0]
                up = _dot(x - self.points[:, 0], d)[:, 0] + r0 * dr
                return (up / (_dot(d, d)[:, 0] - dr * dr)).clamp(0, 1)
            places = torch.linspace(0, 1, 65, dtype=x.dtype).expand(len(x), -1)
            points, radii = (v.repeat_interleave(65, 0) for v in (self.points, self.radii))
            spread = Segments(points, radii, straight=False)
            c = spread.axis(places.flatten())[0].reshape(len(x), 65, 3)
            return places.gather(1, ((c - x[:, None]) ** 2).sum(2).argmin(1)[:, None])[:, 0]


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum(1, keepdim=True)


def _frame(d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Tangent, horizontal normal, binormal (K, 3) and length (K, 1) of derivatives d (K, 3)."""
    length = _dot(d, d).sqrt()
    t = d / length
    level2 = t[:, :1] ** 2 + t[:, 1:2] ** 2
    upright = level2 < 1e-12
    level = torch.where(upright, 1.0, level2).sqrt()
    n = torch.cat([torch.where(upright, 0.0, -t[:, 1:2] / level), torch.where(upright, 1.0, t[:, :1] / level)], 1)
    n = torch.nn.functional.pad(n, (0, 1))
    return t, n, torch.linalg.cross(t, n), length
