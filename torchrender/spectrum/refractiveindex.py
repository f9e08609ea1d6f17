"""Complex indices of refraction from files of the refractiveindex.info database."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import torch

from .dispersion_formulas import FORMULAS
from .observer import NANOMETRES

_LARGEST = 1 << 24
_FIRST, _LAST = NANOMETRES[0] / 1000, NANOMETRES[-1] / 1000
_TABULATED = {"tabulated n": "n", "tabulated k": "k", "tabulated nk": "nk"}


def from_refractiveindex(path: str | os.PathLike[str]) -> tuple[torch.Tensor, torch.Tensor]:
    """The index of refraction and the extinction coefficient in a YAML file of the refractiveindex.info database.

    The database is free of copyright (CC0). Of its data are read: tabulated n, k and nk, and formulas 1 to 9. Between
    wavelengths tables are linear; beyond the range of the data there is the value at its end.

    Args:
        path: such as ``database/data/specs/schott/optical/N-BK7.yml``.

    Returns:
        n and k, tables (471,), float64; k is 0 where the file has none.

    Raises:
        TypeError, FileNotFoundError, IsADirectoryError: for the path.
        ValueError: naming the file, what was expected and what it has: it is no such file, has no n, or nothing
            between 360 and 830 nm.
    """
    from ..io._files import existing_file  # `tr.io` is imported when it is first used

    file = existing_file(path)
    if file.stat().st_size > _LARGEST:
        raise ValueError(
            f"{file}: expected a file of the refractiveindex.info database, got {file.stat().st_size} bytes"
        )
    parts: dict[str, np.ndarray] = {}
    for entry in _entries(file, file.read_bytes().decode("utf-8", "replace")):
        for name, table in _evaluated(file, entry).items():
            if name in parts:
                raise ValueError(f"{file}: expected one {name}, got two")
            parts[name] = table
    if "n" not in parts:
        raise ValueError(f"{file}: expected an index of refraction n, got {' and '.join(parts) or 'no data'} alone")
    k = parts.get("k", np.zeros_like(NANOMETRES))
    return torch.from_numpy(parts["n"]), torch.from_numpy(k)


def _entries(file: Path, text: str) -> list[dict[str, str]]:
    """The list below DATA, of values by key. That is all of YAML that these files use there."""
    lines = text.splitlines()
    start = next((i for i, line in enumerate(lines) if line.rstrip() == "DATA:"), None)
    if start is None:
        raise ValueError(f"{file}: expected a file of the refractiveindex.info database, with a line DATA:; got none")
    entries: list[dict[str, str]] = []
    key = ""
    for number, line in enumerate(lines[start + 1 :], start + 2):
        content = line.strip()
        if not content or content.startswith("#"):
            continue
        if not line.startswith((" ", "-")):
            break  # the next key of the file
        item = re.fullmatch(r"(- +)?([a-z_ ]+?) *: *(.*)", content)
        if item is None:
            if not entries or key != "data":
                raise ValueError(f"{file}, line {number}: expected a key and its value, got {content[:40]!r}")
            entries[-1][key] += content + "\n"
            continue
        if item[1]:
            entries.append({})
        elif not entries:
            raise ValueError(f"{file}, line {number}: expected '- type: ...' first, got {content[:40]!r}")
        key = item[2]
        entries[-1][key] = "" if item[3] in ("|", "|-", ">") else item[3].strip("'\"")
    return entries


def _evaluated(file: Path, entry: dict[str, str]) -> dict[str, np.ndarray]:
    """Tables by their names, n and k."""
    kind = " ".join(entry.get("type", "").split())
    if kind in _TABULATED:
        names = _TABULATED[kind]
        rows = [_numbers(file, line) for line in entry.get("data", "").splitlines()]
        if not rows or any(len(row) != 1 + len(names) for row in rows):
            raise ValueError(f"{file}: expected lines of a wavelength and {' and '.join(names)} in '{kind}'")
        data = np.array(sorted(rows, key=lambda row: row[0]))
        _check_range(file, data[0, 0], data[-1, 0])
        found = {name: np.interp(NANOMETRES / 1000, data[:, 0], data[:, 1 + i]) for i, name in enumerate(names)}
    elif re.fullmatch("formula [1-9]", kind):
        formula, most = FORMULAS[int(kind[-1])]
        coefficients = _numbers(file, entry.get("coefficients", ""))
        limits = _numbers(file, entry.get("wavelength_range", entry.get("range", "")))
        if not 1 <= len(coefficients) <= most or len(limits) != 2:
            got = f"{len(coefficients)} and {len(limits)}"
            raise ValueError(f"{file}: expected 1 to {most} coefficients and two limits for {kind}, got {got} numbers")
        _check_range(file, limits[0], limits[1])
        with np.errstate(all="ignore"):
            found = {
                "n": formula(np.array(coefficients), np.clip(NANOMETRES / 1000, limits[0], limits[1])) + 0 * NANOMETRES
            }
    else:
        expected = "formula 1 to 9, or tabulated n, k or nk"
        raise ValueError(f"{file}: expected data of type {expected}, got {kind!r}")
    for name, table in found.items():
        if not np.isfinite(table).all() or (table < 0).any():
            raise ValueError(f"{file}: expected {name} finite and not negative from 360 to 830 nm in '{kind}'")
    return found


def _numbers(file: Path, text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        raise ValueError(f"{file}: expected numbers, got {text[:40]!r}") from None


def _check_range(file: Path, low: float, high: float) -> None:
    if not (low <= high and low <= _LAST and high >= _FIRST):
        raise ValueError(f"{file}: expected data between 0.36 and 0.83 micrometres, got {low:g} to {high:g}")
