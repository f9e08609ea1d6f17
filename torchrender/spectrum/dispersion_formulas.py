"""The nine formulas of the refractiveindex.info database, indices by wavelengths in micrometres.

As its "Dispersion formulas" has them; coefficients are numbered from 1 there, and missing ones are 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

_Formula = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _pairs(c: np.ndarray, first: int) -> Iterator[tuple[float, float]]:
    return zip(c[first:-1:2], c[first + 1 :: 2])


def _resonances(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Sellmeier, by wavelengths of resonances."""
    return np.sqrt(1 + c[0] + sum(b * w**2 / (w**2 - at**2) for b, at in _pairs(c, 1)))


def _squared_resonances(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Sellmeier, by their squares."""
    return np.sqrt(1 + c[0] + sum(b * w**2 / (w**2 - at) for b, at in _pairs(c, 1)))


def _polynomial(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.sqrt(c[0] + sum(b * w**power for b, power in _pairs(c, 1)))


def _mixed(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    c = _padded(c, 9)
    square = c[0] + sum(c[i] * w ** c[i + 1] / (w**2 - c[i + 2] ** c[i + 3]) for i in (1, 5) if c[i])
    return np.sqrt(square + sum(b * w**power for b, power in _pairs(c, 9)))


def _cauchy(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    return c[0] + sum(b * w**power for b, power in _pairs(c, 1))


def _gas(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    return 1 + c[0] + sum(b / (at - w**-2) for b, at in _pairs(c, 1))


def _herzberger(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    c, s = _padded(c, 6), 1 / (w**2 - 0.028)
    return c[0] + c[1] * s + c[2] * s**2 + c[3] * w**2 + c[4] * w**4 + c[5] * w**6


def _retro(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    c = _padded(c, 4)
    ratio = c[0] + c[1] * w**2 / (w**2 - c[2]) + c[3] * w**2  # (n^2 - 1) / (n^2 + 2)
    return np.sqrt((1 + 2 * ratio) / (1 - ratio))


def _exotic(c: np.ndarray, w: np.ndarray) -> np.ndarray:
    c = _padded(c, 6)
    return np.sqrt(c[0] + c[1] / (w**2 - c[2]) + c[3] * (w - c[4]) / ((w - c[4]) ** 2 + c[5]))


def _padded(c: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([c, np.zeros(max(0, count - len(c)))])


# number -> formula, and the greatest number of coefficients
FORMULAS: dict[int, tuple[_Formula, int]] = {
    1: (_resonances, 17),
    2: (_squared_resonances, 17),
    3: (_polynomial, 17),
    4: (_mixed, 17),
    5: (_cauchy, 11),
    6: (_gas, 11),
    7: (_herzberger, 6),
    8: (_retro, 4),
    9: (_exotic, 6),
}
