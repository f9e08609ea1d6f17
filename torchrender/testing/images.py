"""The z-test of an image against a reference."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch

from ..errors import describe
from .statistics import normal_p_value, sidak


@dataclass(frozen=True)
class ZTestResult:
    """What :func:`z_test` found; true if the test passed.

    Attributes:
        max_z: the largest ``|z|`` of a block; `where` is its index (row, column, ..., channel) among the blocks.
        mean_z: ``|z|`` of the mean over each channel, the largest of them.
        threshold, mean_threshold: above them a z rejects.
        message: the outcome in words.
        z: of every block.
    """

    passed: bool
    max_z: float
    where: tuple[int, ...]
    mean_z: float
    threshold: float
    mean_threshold: float
    message: str
    z: torch.Tensor

    def __bool__(self) -> bool:
        return self.passed


def mean_and_variance(f: Callable[[int], torch.Tensor], seeds: Iterable[int]) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean of ``f(seed)`` over the seeds and the variance of that mean, entry by entry, in float64.

    Args:
        f: such as ``lambda seed: tr.render(scene, seed=seed)``.
        seeds: two or more.
    """
    count, mean = 0, torch.zeros((), dtype=torch.float64, device="cpu")
    squares = mean
    for seed in seeds:
        value = f(seed).detach().double()
        count += 1
        # Welford's update
        delta = value - mean
        mean = mean + delta / count
        squares = squares + delta * (value - mean)
    if count < 2:
        raise ValueError(f"seeds: expected two or more, got {count}")
    return mean, squares / (count * (count - 1))


def z_test(
    image: torch.Tensor,
    reference: torch.Tensor,
    *,
    variance: torch.Tensor | float = 0.0,
    reference_variance: torch.Tensor | float = 0.0,
    block: int = 1,
    significance: float = 0.01,
    tests: int = 1,
    atol: float = 0.0,
) -> ZTestResult:
    """Test whether two images have the same expectation, given the variances of their entries.

    Two things are tested, with half of the significance each: the largest difference of any block (Šidák-corrected for
    their number), which finds local errors, and the mean of each channel, which finds a small bias everywhere.
    The blocks' means have to be about normal: average over blocks of pixels and many samples, and do not take variances
    from fewer than some ten runs per block (see :func:`mean_and_variance`).

    Args:
        image, reference: (H, W, C), or any equal shapes with ``block=1``.
        variance, reference_variance: of the entries as they are (of the mean, if they are means), >= 0, same shape or a
            number. Entries are taken as independent, as pixels are with a box filter. (Errors of neighbouring pixels
            cancel with the sampler ``"sobol"``: tests of blocks and means then reject less often than they say.)
        block: average blocks of this many pixels squared before testing; rows and columns left over are dropped.
        significance: probability of rejecting equal images in all `tests` tests together.
        tests: number of tests that are judged together.
        atol: differences up to this size do not count; with variances of zero the images have to agree to it.

    Returns:
        A `ZTestResult`.

    Raises:
        TypeError, ValueError: if an argument is not one of those above.
    """
    for name, value in (("image", image), ("reference", reference)):
        if not isinstance(value, torch.Tensor) or not value.is_floating_point() or not value.numel():
            raise TypeError(f"{name}: expected a floating-point tensor, got {describe(value)}")
    if image.shape != reference.shape:
        raise ValueError(f"reference: expected shape {tuple(image.shape)}, got {tuple(reference.shape)}")
    total = torch.zeros(image.shape, dtype=torch.float64)
    for name, value in (("variance", variance), ("reference_variance", reference_variance)):
        value = torch.as_tensor(value).detach().double().cpu()
        if value.dim() and value.shape != image.shape:
            raise ValueError(f"{name}: expected shape {tuple(image.shape)} or a number, got {tuple(value.shape)}")
        if not bool(((value >= 0) & torch.isfinite(value)).all()):
            raise ValueError(f"{name}: expected finite values >= 0")
        total = total + value
    difference = image.detach().double().cpu() - reference.detach().double().cpu()
    if block != 1:
        difference, total = _blocks(difference, block), _blocks(total, block) / block**2
    z = _score(difference, total, atol)
    level = sidak(significance, tests) / 2
    threshold = _quantile(sidak(level, z.numel()))
    channels = z.shape[-1] if z.dim() == 3 else 1
    flat, spread = difference.reshape(-1, channels), total.reshape(-1, channels)
    means = _score(flat.mean(0), spread.mean(0) / len(flat), atol)
    mean_threshold = _quantile(sidak(level, channels))
    worst = int(torch.nan_to_num(z.flatten(), nan=torch.inf).argmax())
    where = tuple(int(i) for i in torch.unravel_index(torch.tensor(worst), z.shape))
    max_z, mean_z = float(z.flatten()[worst]), float(means.max())
    # Written so that a NaN fails.
    passed = bool((z <= threshold).all()) and bool((means <= mean_threshold).all())
    message = (
        f"largest |z| = {max_z:.2f} at {where} (threshold {threshold:.2f}), "
        f"|z| of the mean = {mean_z:.2f} (threshold {mean_threshold:.2f})"
    )
    return ZTestResult(passed, max_z, where, mean_z, threshold, mean_threshold, message, z)


def _score(difference: torch.Tensor, variance: torch.Tensor, atol: float) -> torch.Tensor:
    """|difference| beyond `atol` in standard deviations; infinite where there is none left."""
    excess = torch.where(difference.abs() <= atol, torch.zeros_like(difference), difference.abs() - atol)
    return torch.where(excess == 0, excess, excess / variance.sqrt())


def _blocks(image: torch.Tensor, block: int) -> torch.Tensor:
    """Means over blocks of an (H, W, C) image."""
    if image.dim() != 3 or not 1 <= block <= min(image.shape[:2]):
        shape = tuple(image.shape)
        raise ValueError(f"block: expected 1 to the size of an (H, W, C) image, got {block!r} for shape {shape}")
    height, width = image.shape[0] // block, image.shape[1] // block
    cut = image[: height * block, : width * block]
    return cut.reshape(height, block, width, block, -1).mean((1, 3))


def _quantile(level: float) -> float:
    """The |z| that a standard normal variable exceeds with probability `level`, by bisection."""
    low, high = 0.0, 40.0
    for _ in range(100):
        middle = (low + high) / 2
        if float(normal_p_value(torch.tensor(middle, dtype=torch.float64))) > level:
            low = middle
        else:
            high = middle
    return high
