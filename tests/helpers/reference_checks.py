"""z-tests of images and gradients against stored references."""

from __future__ import annotations

import numpy as np
import reference_scenes
import torch

import torchrender as tr

RUNS = 24
# Largest |z| of up to 3072 entries, mean of z squared (entries are correlated between channels), |z| of one sum.
MAX_Z, MAX_MEAN_SQUARE, MAX_SUM_Z = 6.5, 1.5, 4.5
# The references' gradients were summed in single precision: over the 8.4 million samples of a run of the comparison
# scenes up to 0.2 % get lost (the same renderer with 4 or 16 samples a pixel finds what we find), less over fewer.
ROUNDING, LESS_ROUNDING = 2e-3, 3e-4


def check(what: str, runs: list[np.ndarray], mean: np.ndarray, variance: np.ndarray, share: float, systematic=1e-5):
    """z-test of the mean of `runs` against a stored mean and variance.

    Args:
        share: samples of the reference over samples of all runs. Where an entry is hit rarely, the variance over our
            few runs may be far too small by chance; it is taken to be at least half of what the reference predicts.
        systematic: relative deviation of known origin (rounding) that is allowed on top of the noise.
    """
    ours = np.stack(runs).astype(np.float64).reshape(len(runs), -1)
    mean, variance = mean.astype(np.float64).ravel(), variance.astype(np.float64).ravel()
    assert np.isfinite(ours).all(), f"{what}: values that are not finite"
    spread = ours.var(0, ddof=1) / len(runs)
    total = np.maximum(spread, 0.5 * share * variance) + variance
    scale = np.abs(mean).max()
    total = total + (systematic * np.abs(mean)) ** 2 + (1e-7 * scale) ** 2
    z = (ours.mean(0) - mean) / np.sqrt(total)
    worst = np.abs(z).argmax()
    text = f"{what}: entry {worst}: ours {ours.mean(0)[worst]:.6g}, reference {mean[worst]:.6g}, z = {z[worst]:.1f}"
    assert np.abs(z).max() < MAX_Z, text
    assert (z**2).mean() < (MAX_MEAN_SQUARE if z.size > 100 else MAX_SUM_Z**2), f"{what}: mean z² {(z**2).mean():.2f}"


def check_sum(what: str, runs: list[np.ndarray], stored: np.ndarray, share: float, systematic: float) -> None:
    """The sum over all entries; these share paths, so the variance of the sum is stored for itself."""
    sums = np.array([run.astype(np.float64).sum() for run in runs])
    mean, variance = map(float, stored)
    total = max(sums.var(ddof=1) / len(sums), 0.5 * share * variance) + variance + (systematic * mean) ** 2
    z = (sums.mean() - mean) / np.sqrt(total)
    assert abs(z) < MAX_SUM_Z, f"{what}: sum of all entries {sums.mean():.6g}, reference {mean:.6g}, z = {z:.1f}"


def blocks(image: torch.Tensor, size: int) -> np.ndarray:
    """Means over size x size pixels of (H, W, C)."""
    height, width, channels = image.shape
    view = image.detach().double().reshape(height // size, size, width // size, size, channels)
    return view.mean((1, 3)).numpy()


def gradient_runs(scene: tr.Scene, names: list[str], spp: int) -> dict[str, list[np.ndarray]]:
    """Gradients of mean(image * weight) by each of `names`, RUNS times."""
    parameters = scene.train_only(*names)
    runs: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for run in range(RUNS):
        image = tr.render(scene, spp=1, spp_grad=spp, seed=5000 + run)
        weight = torch.from_numpy(reference_scenes.weight(*image.shape)).to(image.dtype)
        gradients = torch.autograd.grad((image * weight).mean(), parameters)
        for name, gradient in zip(names, gradients, strict=True):
            runs[name].append(gradient.double().numpy())
    return runs
