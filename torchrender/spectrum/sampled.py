"""Tables from values at other wavelengths."""

from __future__ import annotations

import numpy as np
import torch

from ..errors import describe
from ..functions import unwrapped
from . import checks
from .observer import NANOMETRES

CLOSE = 8.0  # nm: of a peak as wide, integrals of values at whole nanometres deviate by less than 1 %


def regular(values: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """The table of values at equally spaced wavelengths, as `irregular` has it.

    Args:
        values: (..., N), N >= 2.
        low, high: the wavelengths in nm of the first and last.

    Returns:
        (..., 471).

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    values = checks.numbers("values", values, 2)
    if not 0 < float(low) < float(high) < float("inf"):
        raise ValueError(f"low, high: expected increasing positive wavelengths in nm, got {low!r} and {high!r}")
    return irregular(torch.linspace(low, high, values.shape[-1], dtype=torch.float64), values)


def irregular(wavelengths: torch.Tensor, values: torch.Tensor, *, integral: bool = False) -> torch.Tensor:
    """The table of values at any wavelengths, linear in between and 0 outside; differentiable in the values.

    Where neighbours are less than 1 nm apart, entries are means over their nanometre, so that narrow lines keep their
    energy; elsewhere they are the values at their wavelength.

    Args:
        wavelengths: (N,) in nm, increasing, N >= 2; no derivative.
        values: (..., N) at these.
        integral: bands and light keep their integrals: so do both ends, with the 0 outside, and wavelengths between
            whole nanometres that are less than 8 nm from a neighbour.

    Returns:
        (..., 471), of the dtype of `values`.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    values = checks.numbers("values", values, 2)
    at = unwrapped(checks.numbers("wavelengths", wavelengths, 2))
    with torch._C._DisableFuncTorch():
        known = at.cpu().numpy().astype(np.float64)
    if known.ndim != 1 or not np.isfinite(known).all() or not (np.diff(known) > 0).all():
        raise ValueError(f"wavelengths: expected shape (N,), increasing and finite, got {describe(wavelengths)}")
    if values.shape[-1] != len(known):
        raise ValueError(f"values: expected shape (..., {len(known)}), one a wavelength, got {tuple(values.shape)}")
    if integral or _fine(known).any():
        return _means(known, values.double(), integral).to(values.dtype)
    return _points(known, values.double()).to(values.dtype)


def _points(at: np.ndarray, values: torch.Tensor) -> torch.Tensor:
    place, share, inside = (torch.from_numpy(a).to(values.device) for a in _places(at, NANOMETRES))
    low, high = values[..., place], values[..., place + 1]
    return torch.where(inside, low + share * (high - low), 0.0)


def _means(at: np.ndarray, values: torch.Tensor, integral: bool) -> torch.Tensor:
    """The sum of what the nanometres on both sides of an entry give it.

    That is half of the value, or the integral over the nearer half where values are close to each other, so that a
    nanometre gives its integral in either way.
    """
    count = len(NANOMETRES) - 1
    halves = np.linspace(NANOMETRES[0], NANOMETRES[-1], 2 * count + 1)
    steps = torch.from_numpy(np.diff(at)).to(values.device)
    areas = torch.cumsum(steps * (values[..., 1:] + values[..., :-1]) / 2, -1)
    areas = torch.cat([torch.zeros_like(values[..., :1]), areas], -1)
    place, share, _ = (torch.from_numpy(a).to(values.device) for a in _places(at, np.clip(halves, at[0], at[-1])))
    low, high = values[..., place], values[..., place + 1]
    given = (areas[..., place] + steps[place] * share * (low + share / 2 * (high - low))).diff(dim=-1)
    points = _points(at, values)
    marks = np.zeros(count + 1, np.int64)
    near = np.nonzero(_fine(at))[0]
    first, last = at[near], at[near + 1]
    whole = np.ones(count, bool)
    if integral:
        close = np.diff(at) < CLOSE
        single = at[np.r_[True, close] | np.r_[close, True]]  # and both ends
        first, last = np.concatenate([first, single]), np.concatenate([last, single])
        whole = (NANOMETRES[:-1] >= at[0]) & (NANOMETRES[1:] <= at[-1])
    np.add.at(marks, np.clip(np.floor(first) - NANOMETRES[0], 0, count).astype(int), 1)
    np.add.at(marks, np.clip(np.ceil(last) - NANOMETRES[0], 0, count).astype(int), -1)
    fine = torch.from_numpy(np.cumsum(marks)[:-1] > 0).to(values.device)
    weight = torch.from_numpy(whole / 2).to(values)
    after = torch.where(fine, given[..., 0::2], weight * points[..., :-1])
    before = torch.where(fine, given[..., 1::2], weight * points[..., 1:])
    # the first and last entry have half a nanometre, as the weights of the observer have them
    inner = before[..., :-1] + after[..., 1:]
    return torch.cat([2 * after[..., :1], inner, 2 * before[..., -1:]], -1)


def _fine(at: np.ndarray) -> np.ndarray:
    return np.diff(at) < 1 - 1e-6


def _places(at: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each point the interval, how far it is through it, and whether it is inside of any."""
    place = np.clip(np.searchsorted(at, points, "right") - 1, 0, len(at) - 2)
    share = (points - at[place]) / (at[place + 1] - at[place])
    return place, share, (points >= at[0]) & (points <= at[-1])
