"""The chi-square test of a sampler against its density."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..errors import describe
from .statistics import chi2_p_value, sidak

Density = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class ChiSquareResult:
    """What :func:`chi2_test` found; true if the test passed.

    Attributes:
        statistic, dof, p_value: of the chi-square distribution.
        level: p-values below it reject, corrected for the number of tests.
        mass: integral of the density over the domain.
        message: the outcome in words.
        observed, expected: counts per bin (rows, columns), float64; the first dimension is z (sphere) or y (square).
    """

    passed: bool
    statistic: float
    dof: int
    p_value: float
    level: float
    mass: float
    message: str
    observed: torch.Tensor
    expected: torch.Tensor

    def __bool__(self) -> bool:
        return self.passed


def chi2_test(
    samples: torch.Tensor,
    pdf: Density,
    *,
    domain: str = "sphere",
    valid: torch.Tensor | None = None,
    bins: tuple[int, int] = (16, 32),
    significance: float = 0.01,
    tests: int = 1,
    min_expected: float = 5.0,
    tolerance: float = 1e-3,
) -> ChiSquareResult:
    """Test whether samples follow a density (Pearson's chi-square test, Šidák-corrected).

    Args:
        samples: directions (N, 3) of unit length, or points (N, 2) of the unit square.
        pdf: takes points of the domain (M, 3) or (M, 2), float64, and returns their density (M,): per solid angle for
            directions, per area for the square. Delta components are left out of both.
        domain: ``"sphere"``, ``"hemisphere"`` (z >= 0) or ``"square"``.
        valid: (N,) booleans; a sample that failed (false) counts for what the density lacks to one.
        bins: number of bins in z and azimuth, or in y and x: all of one area.
        significance: probability of rejecting a correct sampler in all `tests` tests together.
        tests: number of tests that are judged together.
        min_expected: bins with a smaller expected count are pooled.
        tolerance: accuracy of the integral of the density, and by how much it may exceed one.

    Returns:
        A `ChiSquareResult`.

    Raises:
        TypeError, ValueError: if an argument is not one of those above, or the density is negative or not finite.
    """
    if domain not in ("sphere", "hemisphere", "square"):
        raise ValueError(f"domain: expected 'sphere', 'hemisphere' or 'square', got {domain!r}")
    width = 2 if domain == "square" else 3
    if not isinstance(samples, torch.Tensor) or samples.dim() != 2 or samples.shape[1] != width or not len(samples):
        raise TypeError(f"samples: expected a tensor (N, {width}), got {describe(samples)}")
    samples = samples.detach().double().cpu()
    valid = torch.ones(len(samples), dtype=torch.bool) if valid is None else valid.detach().cpu().bool()
    if valid.shape != samples.shape[:1]:
        raise ValueError(f"valid: expected shape {tuple(samples.shape[:1])}, got {tuple(valid.shape)}")
    kept = samples[valid]
    level = sidak(significance, tests)
    expected_share = _integrate(pdf, domain, bins, tolerance)
    mass = float(expected_share.sum())
    expected = expected_share * len(samples)

    def result(
        message: str,
        statistic: float = math.inf,
        dof: int = 0,
        p_value: float = 0.0,
        observed: torch.Tensor | None = None,
    ) -> ChiSquareResult:
        counts = torch.zeros(bins, dtype=torch.float64) if observed is None else observed
        passed = not message
        text = f"chi2 = {statistic:.1f}, {dof} degrees of freedom, p = {p_value:.3g}, level {level:.3g}"
        return ChiSquareResult(passed, statistic, dof, p_value, level, mass, message or text, counts, expected)

    if width == 3 and len(kept) and not bool(((kept.norm(dim=1) - 1).abs() < 1e-3).all()):
        worst = float((kept.norm(dim=1) - 1).abs().max())
        return result(f"samples are not unit vectors: the length is off by up to {worst:.3g}")
    if not bool(torch.isfinite(kept).all()):
        return result("samples are not finite")
    cell, inside = _cells(kept, domain, bins)
    if not bool(inside.all()):
        outside = int((~inside).sum())
        return result(
            f"{outside} of {len(kept)} samples are outside of the domain, such as {kept[~inside][0].tolist()}"
        )
    observed = torch.bincount(cell, minlength=bins[0] * bins[1]).double().reshape(bins)
    if mass > 1 + tolerance:
        return result(f"the density integrates to {mass:.5f}, more than one", observed=observed)
    impossible = (observed > 0) & (_surroundings(expected, domain) == 0)
    if bool(impossible.any()):
        count = int(observed[impossible].sum())
        return result(f"{count} of {len(kept)} samples lie where the density is zero all around", observed=observed)
    # What the density lacks to one is the share of samples that fail.
    counts = torch.cat([observed.flatten(), torch.tensor([float(len(samples) - len(kept))])])
    means = torch.cat([expected.flatten(), torch.tensor([max(0.0, 1 - mass) * len(samples)])])
    counts, means = _pool(counts, means, min_expected)
    dof = len(counts) - 1
    if dof < 1:
        return result("fewer than two bins have enough samples: take more samples or bins", observed=observed)
    statistic = float(((counts - means) ** 2 / means).sum())
    p_value = chi2_p_value(statistic, dof)
    failure = f"chi2 = {statistic:.1f} with {dof} degrees of freedom: p = {p_value:.3g} is below {level:.3g}"
    return result(failure if p_value < level else "", statistic, dof, p_value, observed)


def _pool(counts: torch.Tensor, means: torch.Tensor, min_expected: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Merge the bins with small expected counts into one; if that is still small, into the next larger one."""
    order = means.argsort()
    counts, means = counts[order], means[order]
    small = int((means < min_expected).sum())
    while 0 < small < len(means) and float(means[:small].sum()) < min_expected:
        small += 1
    if small == 0:
        return counts, means
    head = torch.stack([counts[:small].sum(), means[:small].sum()])
    return torch.cat([head[:1], counts[small:]]), torch.cat([head[1:], means[small:]])


def _surroundings(expected: torch.Tensor, domain: str) -> torch.Tensor:
    """The largest expected count among each bin and its neighbours.

    A bin on the edge of a lobe can have a corner in it that the integration misses, but not a bin that is surrounded by
    zeros.
    """
    padded = torch.nn.functional.pad(
        expected[None, None], (1, 1, 0, 0), "replicate" if domain == "square" else "circular"
    )
    padded = torch.nn.functional.pad(padded, (0, 0, 1, 1), "replicate")
    largest = torch.nn.functional.max_pool2d(padded, 3, stride=1)[0, 0]
    if domain != "square":  # around the poles all bins are neighbours
        largest[0], largest[-1] = largest[0].max(), largest[-1].max()
    return largest


def _cells(points: torch.Tensor, domain: str, bins: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    """Bin numbers (N,) and whether each point lies in the domain."""
    if domain == "square":
        a, b = points[:, 1], points[:, 0]
        inside = ((points >= 0) & (points <= 1)).all(1)
    else:
        z, low = points[:, 2].clamp(-1, 1), (-1.0 if domain == "sphere" else 0.0)
        a = (z - low) / (1 - low)
        b = torch.atan2(points[:, 1], points[:, 0]) / (2 * math.pi) % 1
        inside = z >= low
    row = (a * bins[0]).long().clamp(0, bins[0] - 1)
    column = (b * bins[1]).long().clamp(0, bins[1] - 1)
    return row * bins[1] + column, inside


def _points(a: torch.Tensor, b: torch.Tensor, domain: str) -> torch.Tensor:
    """Points of the domain at coordinates in the unit square; equal areas stay equal."""
    if domain == "square":
        return torch.stack([b, a], dim=-1)
    z = 2 * a - 1 if domain == "sphere" else a
    radius, azimuth = torch.sqrt((1 - z * z).clamp(min=0)), 2 * math.pi * b
    return torch.stack([radius * torch.cos(azimuth), radius * torch.sin(azimuth), z], dim=-1)


def _integrate(pdf: Density, domain: str, bins: tuple[int, int], tolerance: float) -> torch.Tensor:
    """Integral of the density over each bin (rows, columns).

    By Gauss-Legendre rules on cells that are split until the integral over their four parts agrees with that over the
    whole.
    """
    area = {"sphere": 4 * math.pi, "hemisphere": 2 * math.pi, "square": 1.0}[domain]
    rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in bins), indexing="ij")
    low = torch.stack([rows.flatten() / bins[0], columns.flatten() / bins[1]], dim=1)
    size = torch.tensor([1 / bins[0], 1 / bins[1]], dtype=torch.float64)
    owner = torch.arange(len(low))
    total = torch.zeros(len(low), dtype=torch.float64)
    estimate = _rule(pdf, domain, low, size) * area
    for depth in range(9):
        half = size / 2
        corners = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]], dtype=torch.float64) * half
        parts = (low[:, None] + corners).reshape(-1, 2)
        finer = _rule(pdf, domain, parts, half) * area
        summed = finer.reshape(-1, 4).sum(1)
        # The allowed error of each cell is its share of the whole tolerance, by number or by value.
        allowed = torch.maximum(summed.abs(), torch.full_like(summed, 1 / len(total))) * tolerance * 0.05
        done = (summed - estimate).abs() <= allowed if depth < 8 else torch.ones_like(summed, dtype=torch.bool)
        total.index_add_(0, owner[done], summed[done])
        if bool(done.all()):
            break
        again = ~done.repeat_interleave(4)
        low, estimate, owner, size = parts[again], finer[again], owner.repeat_interleave(4)[again], half
    return total.reshape(bins)


# Nodes and weights of the Gauss-Legendre rule with five points on [0, 1].
_R1, _R2 = math.sqrt(5 - 2 * math.sqrt(10 / 7)) / 3, math.sqrt(5 + 2 * math.sqrt(10 / 7)) / 3
_W1, _W2 = (322 + 13 * math.sqrt(70)) / 900, (322 - 13 * math.sqrt(70)) / 900
_NODES = torch.tensor([-_R2, -_R1, 0.0, _R1, _R2], dtype=torch.float64) / 2 + 0.5
_WEIGHTS = torch.tensor([_W2, _W1, 128 / 225, _W1, _W2], dtype=torch.float64) / 2


def _rule(pdf: Density, domain: str, low: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """The integral over cells at `low` (K, 2) of extent `size` (2,) in the unit square, (K,)."""
    a = low[:, 0, None, None] + size[0] * _NODES[:, None]
    b = low[:, 1, None, None] + size[1] * _NODES[None, :]
    a, b = torch.broadcast_tensors(a, b)
    points = _points(a.reshape(-1), b.reshape(-1), domain)
    values = torch.as_tensor(pdf(points)).detach().double().cpu()
    if values.shape != points.shape[:1]:
        raise ValueError(f"pdf: expected shape ({len(points)},), got {tuple(values.shape)}")
    if not bool((torch.isfinite(values) & (values >= 0)).all()):
        bad = points[~(torch.isfinite(values) & (values >= 0))][0].tolist()
        raise ValueError(f"pdf: expected finite densities >= 0, but not at {bad}")
    weights = _WEIGHTS[:, None] * _WEIGHTS
    return (values.reshape(-1, 5, 5) * weights).sum((1, 2)) * float(size[0] * size[1])
