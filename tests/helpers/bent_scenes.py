"""Shapes filled with media whose index varies, rays for them, and derivatives of these in both modes."""

from __future__ import annotations

from collections.abc import Callable

import torch

import torchrender as tr

DOUBLE = torch.float64
BOX = tr.Transform.translate([-1, -1, -1]) @ tr.Transform.scale(2)


def glass(
    index: object,
    bsdf: object = "dielectric",
    dtype: torch.dtype = DOUBLE,
    shape: object = "cube",
    others: dict | None = None,
    **medium: object,
) -> tr.Scene:
    """A shape, by its type or described, of this index in air; the grid fills [-1, 1]^3."""
    described = {"type": shape} if isinstance(shape, str) else shape
    boundary = {"type": bsdf} if isinstance(bsdf, str) else bsdf
    inside = {"type": "gradientindex", "index": index, "to_world": BOX, **medium}
    if isinstance(described, tr.Mesh):
        described.interior, described.bsdf = tr.load_dict(inside, dtype=dtype), tr.load_dict(boundary, dtype=dtype)
        lens: object = described
    else:
        lens = {**described, "interior": inside, "bsdf": boundary}
    return tr.load_dict({"type": "scene", "lens": lens, **(others or {})}, dtype=dtype)


def square_box(half: float) -> torch.Tensor:
    """From the unit cube to [-half, half]^3."""
    return tr.Transform.translate([-half] * 3) @ tr.Transform.scale(2 * half)


def centers(size: int, half: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """x, y, z (size, size, size) of the voxels' centres of a grid that fills [-half, half]^3."""
    line = ((torch.arange(size, dtype=DOUBLE) + 0.5) / size * 2 - 1) * half
    z, y, x = torch.meshgrid(line, line, line, indexing="ij")
    return x, y, z


def random_index(size: int, amount: float = 0.03, seed: int = 0) -> torch.Tensor:
    noise = torch.randn(size, size, size, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)
    return 1.5 + amount * noise


def beam(n: int, width: float = 1.0, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays that come from below, almost along z."""
    generator = torch.Generator().manual_seed(seed)
    o = (torch.rand(n, 3, generator=generator, dtype=DOUBLE) - 0.5) * width
    o[:, 2] = -3
    return o, torch.tensor([0.02, 0.03, 1.0], dtype=DOUBLE).expand(n, 3).contiguous()


def number_of(rays: tr.gradientindex.BentRays) -> torch.Tensor:
    """A function of everything that is differentiable."""
    weight = torch.linspace(0.5, 1.5, len(rays.valid), dtype=rays.position.dtype)
    found = torch.sin(3 * rays.position[:, :2]).sum(1) + torch.cos(2 * rays.direction).sum(1)
    found = found + rays.optical_path.square() + rays.length.sin() + rays.index
    found = found + rays.transmittance.sum(1) + rays.emission.square().sum(1)
    return (weight * found).sum()


def in_both_modes(
    f: Callable[[torch.Tensor], torch.Tensor], x: torch.Tensor, along: torch.Tensor
) -> tuple[float, float]:
    """The derivative of a number along a direction, in reverse and in forward mode."""
    leaf = x.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(f(leaf), leaf)
    _, forward = torch.func.jvp(f, (x,), (along,))
    return float((gradient.double() * along.double()).sum()), float(forward)


def difference(
    f: Callable[[torch.Tensor], torch.Tensor], x: torch.Tensor, along: torch.Tensor, step: float = 1e-5
) -> float:
    return float(f(x + step * along) - f(x - step * along)) / (2 * step)


def direction_like(x: torch.Tensor, seed: int = 2) -> torch.Tensor:
    return torch.randn(x.shape, generator=torch.Generator().manual_seed(seed), dtype=x.dtype)
