"""Saving what the tutorials make: pictures as PNG (to look at) and EXR (the numbers), signed pictures, loss curves."""

from __future__ import annotations

from pathlib import Path

import torch

import torchrender as tr


def save(image: torch.Tensor, folder: Path, name: str, exposure: float = 0.0) -> None:
    """Write linear radiance (H, W, 3) as `name.exr` and, tone mapped, as `name.png`. `exposure` is in stops."""
    image = image.detach().float().cpu()
    tr.io.write_image(folder / f"{name}.exr", image)
    tr.io.write_image(folder / f"{name}.png", image * 2.0**exposure)


def save_signed(image: torch.Tensor, folder: Path, name: str) -> None:
    """Write a picture (H, W, 3) of either sign, such as a derivative: red is positive, blue negative, white zero.

    The EXR file keeps the numbers; the PNG shows the mean over the channels, scaled to its 99.5 % quantile.
    """
    image = image.detach().float().cpu()
    tr.io.write_image(folder / f"{name}.exr", image)
    value = image.mean(-1)
    # quantile() takes at most 16 million entries, which is more than any film here has.
    value = (value / value.abs().flatten().quantile(0.995).clamp(min=1e-12)).clamp(-1, 1)
    positive, negative = value.clamp(min=0), (-value).clamp(min=0)
    colours = torch.stack([1 - negative, 1 - positive - negative, 1 - positive], dim=-1)
    tr.io.write_image(folder / f"{name}.png", colours.clamp(0, 1))


def save_curves(curves: dict[str, list[float]], path: Path, title: str) -> None:
    """Draw curves over the iterations with a logarithmic axis into a PNG file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4))
    for label, values in curves.items():
        axes.semilogy(values, label=label)
    axes.set_xlabel("iteration")
    axes.set_title(title)
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
