"""Measured figures with their spread, and straight lines through them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median, quantiles


@dataclass(frozen=True)
class Measured:
    """The median of `n` measurements of one cost, in the unit that its column names, with both quartiles."""

    median: float
    q1: float
    q3: float
    n: int

    @classmethod
    def of(cls, samples: Iterable[float]) -> Measured:
        """From measurements; ValueError if there are none."""
        values = list(samples)
        if not values:
            raise ValueError("Measured.of: no measurements")
        if len(values) == 1:
            return cls(values[0], values[0], values[0], 1)
        q1, _, q3 = quantiles(values, n=4, method="inclusive")
        return cls(median(values), q1, q3, len(values))

    @property
    def spread(self) -> float:
        """Half of the distance between the quartiles, relative to the median."""
        return (self.q3 - self.q1) / (2 * self.median) if self.median else 0.0

    @property
    def error(self) -> float:
        """Relative standard error of the median, were the measurements independent and normal.

        Half the distance between a normal distribution's quartiles is 0.674 standard deviations, and the median's
        standard error sqrt(pi / 2) = 1.253 of the mean's.
        """
        return 1.253 / 0.674 * self.spread / self.n**0.5

    def scaled(self, factor: float) -> Measured:
        return Measured(self.median * factor, self.q1 * factor, self.q3 * factor, self.n)

    def __str__(self) -> str:
        if self.n < 2:
            return f"{self.median:.3g}"
        percent = 100 * self.spread
        return f"{self.median:.3g} ± {percent:.0f} %" if percent >= 9.5 else f"{self.median:.3g} ± {percent:.1g} %"


def rounds(programs: dict[str, Callable[[int], dict[str, float]]], options) -> dict[str, dict[str, list[float]]]:
    """Run every program once a round, so that all see the same machine; the first `options.warmup` do not count.

    A program takes the number of the round and returns seconds by name; the result has all rounds' by program and name.
    """
    found: dict[str, dict[str, list[float]]] = {who: {} for who in programs}
    for number in range(options.warmup + options.rounds):
        for who, run in programs.items():
            for name, seconds in run(number).items():
                if number >= options.warmup:
                    found[who].setdefault(name, []).append(seconds)
    return found


def fit_line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Offset and slope of the line through points whose errors are relative: least squares of (fit - y) / y.

    Timings scatter in proportion to what they measure, so that the long ones must not drown the short ones, which alone
    know the offset. ValueError for less than two different x.
    """
    w = [1 / value**2 for value in y]
    total = sum(w)
    mean_x = sum(wi * xi for wi, xi in zip(w, x, strict=True)) / total
    mean_y = sum(wi * yi for wi, yi in zip(w, y, strict=True)) / total
    squares = sum(wi * (xi - mean_x) ** 2 for wi, xi in zip(w, x, strict=True))
    if not squares > 0:
        raise ValueError(f"fit_line: two different values are needed, got {list(x)}")
    slope = sum(wi * (xi - mean_x) * (yi - mean_y) for wi, xi, yi in zip(w, x, y, strict=True)) / squares
    return mean_y - slope * mean_x, slope
