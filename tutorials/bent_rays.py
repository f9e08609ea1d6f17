"""What the tutorials of gradient-index media share: ways of rays as lines, pictures of an index, beams."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import torch

import torchrender as tr


def cube(half: float = 1.0) -> tr.Transform:
    """The matrix that takes the unit cube, which a grid fills, to [-half, half]^3."""
    return tr.Transform.translate([-half] * 3) @ tr.Transform.scale(2 * half)


def coordinates(size: int, half: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """x, y and z of the centres of voxels in [-half, half]^3, each (size, size, size) in the order (Z, Y, X)."""
    axis = ((torch.arange(size) + 0.5) / size * 2 - 1) * half
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return x, y, z


def disk(count: int, generator: torch.Generator | None = None) -> torch.Tensor:
    """(count, 2) points of the unit disk, evenly distributed: a spiral by the golden angle, or at random."""
    if generator is None:
        square = (torch.arange(count) + 0.5) / count
        angle = torch.arange(count) * (math.pi * (3 - math.sqrt(5)))
    else:
        square, turn = torch.rand(2, count, generator=generator)
        angle = 2 * math.pi * turn
    return torch.sqrt(square)[:, None] * torch.stack([torch.cos(angle), torch.sin(angle)], 1)


def across(direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Two unit vectors (..., 3) at right angles to unit vectors and to each other."""
    least = torch.nn.functional.one_hot(direction.abs().argmin(-1), 3).to(direction.dtype)
    first = torch.nn.functional.normalize(torch.linalg.cross(direction, least), dim=-1)
    return first, torch.linalg.cross(direction, first)


def paths(
    index: torch.Tensor,
    half: float,
    origins: torch.Tensor,
    directions: torch.Tensor,
    inside: Callable[[torch.Tensor], torch.Tensor],
    step: float,
) -> list[torch.Tensor]:
    """Ways of rays as lines to draw, (N, 3) a point of time, while `inside` of positions (N, 3) says that they bend.

    `tr.gradientindex.trace` gives their ends alone. Here the same equations, dx/ds = p / n, dp/ds = grad n, are solved
    over the field in PyTorch; rays go on straight where they are not inside. `step` is a length.
    """
    x, p = origins, directions
    line = [x]
    for _ in range(math.ceil(4 * half / step)):
        n, slope = tr.gradientindex.evaluate(index, (x + half) / (2 * half))
        bends = inside(x)[:, None]
        p = torch.where(bends, p + step * slope / (2 * half), p)
        p = torch.where(bends, torch.nn.functional.normalize(p, dim=1) * n[:, None], p)
        x = x + step * torch.nn.functional.normalize(p, dim=1)
        line.append(x)
    return line


def save_slices(
    pictures: dict[str, torch.Tensor],
    path: Path,
    title: str,
    half: float = 1.0,
    lines: list[torch.Tensor] | None = None,
) -> None:
    """Draw slices (H, W), the first row at the bottom, beside each other with one scale of colours; over the first one
    the ways of rays, points (N, 2) one after the other."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    low = min(float(p[p.isfinite()].min()) for p in pictures.values())
    high = max(float(p[p.isfinite()].max()) for p in pictures.values())
    figure, axes = pyplot.subplots(
        1, len(pictures), figsize=(4.2 * len(pictures) + 0.8, 4), squeeze=False, layout="constrained"
    )
    for axis, (name, picture) in zip(axes[0], pictures.items(), strict=True):
        axis.imshow(picture.detach(), origin="lower", extent=(-half, half, -half, half), vmin=low, vmax=high)
        axis.set_title(name)
    if lines is not None:
        ways = torch.stack(lines).detach()
        axes[0, 0].plot(ways[..., 0], ways[..., 1], color="white", linewidth=0.6)
        axes[0, 0].set(xlim=(-1.3 * half, 1.3 * half), ylim=(-1.3 * half, 1.3 * half), facecolor="black")
    figure.colorbar(axes[0, 0].images[0], ax=list(axes[0]), shrink=0.8)
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
