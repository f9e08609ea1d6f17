"""P-values and the correction for several tests, in double precision."""

from __future__ import annotations

import math

import torch


def sidak(significance: float, tests: int) -> float:
    """The level for each of `tests` independent tests that gives `significance` for all together (Šidák 1967)."""
    if not 0 < significance < 1:
        raise ValueError(f"significance: expected a number between 0 and 1, got {significance!r}")
    if tests < 1:
        raise ValueError(f"tests: expected a positive number, got {tests!r}")
    return -math.expm1(math.log1p(-significance) / tests)


def chi2_p_value(statistic: float, dof: int) -> float:
    """Probability that a chi-square variable with `dof` degrees of freedom is larger than `statistic`."""
    half = torch.tensor([dof / 2, statistic / 2], dtype=torch.float64)
    return float(torch.special.gammaincc(half[0], half[1]))


def normal_p_value(z: torch.Tensor) -> torch.Tensor:
    """Two-sided probability of a standard normal variable larger than `z` in magnitude, entry by entry, as float64."""
    return torch.special.erfc(z.double().abs() / math.sqrt(2))


def student_p_value(t: torch.Tensor, dof: float) -> torch.Tensor:
    """Two-sided probability of a Student variable with `dof` >= 1 degrees of freedom beyond ``|t|``, as float64.

    `dof` is rounded down to an integer, for which the distribution has a finite series (Abramowitz and Stegun 26.7.3
    and 26.7.4). Above 200 the normal distribution is used, at t (1 - 1 / (4 dof)) / sqrt(1 + t^2 / (2 dof)) (26.7.8).
    """
    t, count = t.double().abs(), int(dof)
    if count < 1:
        raise ValueError(f"dof: expected at least 1, got {dof!r}")
    if count > 200:
        return normal_p_value(t * (1 - 1 / (4 * dof)) / torch.sqrt(1 + t * t / (2 * dof)))
    theta = torch.atan(t / math.sqrt(count))
    cosine, sine = torch.cos(theta), torch.sin(theta)
    total = torch.zeros_like(theta)
    if count % 2:
        term = cosine.clone()
        for k in range(1, (count - 1) // 2 + 1):
            total = total + term
            term = term * cosine**2 * (2 * k) / (2 * k + 1)
        inside = 2 / math.pi * (theta + sine * total)
    else:
        term = torch.ones_like(theta)
        for k in range(1, count // 2 + 1):
            total = total + term
            term = term * cosine**2 * (2 * k - 1) / (2 * k)
        inside = sine * total
    return (1 - inside).clamp(0, 1)
