"""Tables from values at other wavelengths."""

from __future__ import annotations

import numpy as np
import torch

from ..errors import describe
from . import checks
from .observer import NANOMETRES


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
        integral: the first and the last entry are means over their nanometre, too, with the 0 outside, so that bands
            and light keep their integrals.

    Returns:
        (..., 471), of the dtype of `values`.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    values = checks.numbers("values", values, 2)
    at = checks.numbers("wavelengths", wavelengths, 2).detach().double().cpu()
    if at.ndim != 1 or not bool(torch.isfinite(at).all()) or not bool((at.diff() > 0).all()):
        raise ValueError(f"wavelengths: expected shape (N,), increasing and finite, got {describe(wavelengths)}")
    if values.shape[-1] != len(at):
        raise ValueError(f"values: expected shape (..., {len(at)}), one a wavelength, got {tuple(values.shape)}")
    known = at.numpy()
    if integral or _fine(known).any():
        return _means(known, values.double(), integral).to(values.dtype)
    return _points(known, values.double()).to(values.dtype)


def _points(at: np.ndarray, values: torch.Tensor) -> torch.Tensor:
    place, share, inside = (torch.from_numpy(a).to(values.device) for a in _places(at, NANOMETRES))
    low, high = values[..., place], values[..., place + 1]
    return torch.where(inside, low + share * (high - low), 0.0)


def _means(at: np.ndarray, values: torch.Tensor, ends: bool) -> torch.Tensor:
    """The means where values are less than 1 nm apart, and perhaps at both ends, by differences of the integral up to the cells' borders."""
    # the first and last cell are halves, as the weights of the observer have them
    edges = np.clip(np.concatenate([NANOMETRES - 0.5, NANOMETRES[-1:] + 0.5]), NANOMETRES[0], NANOMETRES[-1])
    steps = torch.from_numpy(np.diff(at)).to(values.device)
    areas = torch.cumsum(steps * (values[..., 1:] + values[..., :-1]) / 2, -1)
    areas = torch.cat([torch.zeros_like(values[..., :1]), areas], -1)
    place, share, _ = (torch.from_numpy(a).to(values.device) for a in _places(at, np.clip(edges, at[0], at[-1])))
    low, high = values[..., place], values[..., place + 1]
    integral = areas[..., place] + steps[place] * share * (low + share / 2 * (high - low))
    means = integral.diff(dim=-1) / torch.from_numpy(np.diff(edges)).to(values.device)
    # a cell is fine where such an interval reaches into it
    near = np.nonzero(_fine(at))[0]
    marks = np.zeros(len(edges), np.int64)
    np.add.at(marks, np.clip(np.searchsorted(edges, at[near], "right") - 1, 0, len(edges) - 1), 1)
    np.add.at(marks, np.clip(np.searchsorted(edges, at[near + 1], "left"), 0, len(edges) - 1), -1)
    fine = np.cumsum(marks)[:-1] > 0
    for end in (at[0], at[-1]) if ends else ():
        fine |= (edges[:-1] < end) & (end < edges[1:]) & (edges[0] < end) & (end < edges[-1])
    return torch.where(torch.from_numpy(fine).to(values.device), means, _points(at, values))


def _fine(at: np.ndarray) -> np.ndarray:
    return np.diff(at) < 1 - 1e-6


def _places(at: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each point the interval, how far it is through it, and whether it is inside of any."""
    place = np.clip(np.searchsorted(at, points, "right") - 1, 0, len(at) - 2)
    share = (points - at[place]) / (at[place + 1] - at[place])
    return place, share, (points >= at[0]) & (points <= at[-1])
