"""``write_spectrum``: tabulated spectra to files."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import torch

from ._files import writable_file


def write_spectrum(
    path: str | os.PathLike[str],
    wavelengths: torch.Tensor | np.ndarray | Sequence[float],
    values: torch.Tensor | np.ndarray | Sequence[float],
) -> None:
    """Write a spectrum as text, a wavelength and a value a line, as ``{"type": "spectrum", "filename": ...}`` reads it.

    Args:
        path: ends in ``.spd``; its folder exists.
        wavelengths: (N,) in nm, increasing, N >= 2.
        values: (N,) at these.

    Raises:
        FileNotFoundError: if there is no such folder.
        TypeError, ValueError: if an argument is not one of those above.
    """
    path = writable_file(path)
    if path.suffix.lower() != ".spd":
        raise ValueError(f"{path}: unknown format of spectra {path.suffix!r}; expected .spd")
    at, numbers = _row("wavelengths", wavelengths), _row("values", values)
    if len(at) < 2 or not (np.diff(at) > 0).all():
        raise ValueError(f"wavelengths: expected two or more, increasing, got {len(at)}")
    if len(numbers) != len(at):
        raise ValueError(f"values: expected {len(at)} numbers, one a wavelength, got {len(numbers)}")
    path.write_text("".join(f"{w!r} {v!r}\n" for w, v in zip(at.tolist(), numbers.tolist())), encoding="ascii")


def _row(name: str, given: torch.Tensor | np.ndarray | Sequence[float]) -> np.ndarray:
    given = given.detach().cpu().numpy() if isinstance(given, torch.Tensor) else given
    try:
        row = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected numbers of shape (N,), got {type(given).__name__}") from None
    if row.ndim != 1 or not np.isfinite(row).all():
        raise ValueError(f"{name}: expected finite numbers of shape (N,), got shape {row.shape}")
    return row
