"""Reconstruction filters, and the weighted mean of samples in pixels: csrc/cpu/film.h."""

from __future__ import annotations

import math

import torch

from torchrender.scene.film import Film


def box(x: torch.Tensor, film: Film) -> torch.Tensor:
    return torch.ones_like(x)


def tent(x: torch.Tensor, film: Film) -> torch.Tensor:
    return (1 - x.abs() / film.filter.radius).clamp(min=0.0)


def gaussian(x: torch.Tensor, film: Film) -> torch.Tensor:
    s = 0.5 / film.filter.stddev**2
    radius = 4 * film.filter.stddev
    return torch.where(x.abs() < radius, torch.exp(-s * x * x) - math.exp(-s * radius * radius), 0.0)


def cubic(x: torch.Tensor, b: float, c: float) -> torch.Tensor:
    """Mitchell and Netravali, "Reconstruction Filters in Computer Graphics", 1988."""
    x = x.abs()
    inner = ((12 - 9 * b - 6 * c) * x + (-18 + 12 * b + 6 * c)) * x * x + (6 - 2 * b)
    outer = (((-b - 6 * c) * x + (6 * b + 30 * c)) * x - (12 * b + 48 * c)) * x + (8 * b + 24 * c)
    return torch.where(x < 1, inner, torch.where(x < 2, outer, 0.0)) / 6


def lanczos(x: torch.Tensor, film: Film) -> torch.Tensor:
    n = film.filter.lobes
    return torch.where(x.abs() < n, torch.sinc(x) * torch.sinc(x / n), 0.0)


FILTERS = {
    "box": box,
    "tent": tent,
    "gaussian": gaussian,
    "mitchell": lambda x, film: cubic(x, film.filter.B, film.filter.C),
    "catmullrom": lambda x, film: cubic(x, 0.0, 0.5),
    "lanczos": lanczos,
}


def reach(film: Film) -> int:
    """Pixels on each side of a sample's own that it contributes to."""
    return max(0, math.ceil(film.filter.reach - 0.5))


def develop(film: Film, positions: torch.Tensor, values: torch.Tensor, magnitude: bool = False) -> torch.Tensor:
    """Image (h, w, K) of the film's window from samples (N, K) at positions (N, 2), x and y in pixels.

    `magnitude`: weights count without their sign.
    """
    y0, x0, height, width = film.window
    f = FILTERS[film.filter.type]
    x, y = positions.unbind(1)
    column, row = torch.floor(x), torch.floor(y)
    total = values.new_zeros(height * width, values.shape[1])
    weights = values.new_zeros(height * width)
    around = range(-reach(film), reach(film) + 1)
    for i in around:
        for j in around:
            weight = f(row + i + 0.5 - y, film) * f(column + j + 0.5 - x, film)
            weight = weight.abs() if magnitude else weight
            r, c = (row + i - y0).long(), (column + j - x0).long()
            inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            pixel = (r * width + c)[inside]
            total = total.index_add(0, pixel, (values * weight[:, None])[inside])
            weights = weights.index_add(0, pixel, weight[inside])
    image = total / torch.where(weights != 0, weights, 1.0)[:, None]
    return image.reshape(height, width, -1)
