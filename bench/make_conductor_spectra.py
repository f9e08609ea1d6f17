"""Read the indices of refraction of metals back from Mitsuba 3.9.1, for `torchrender/scene/conductors.npz`.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_conductor_spectra.py

What is installed is made of the tables that Mitsuba has as files, held where they end and made whole where they have
holes. `tests/data/conductor_spectra.npz`, which the tests compare it with, has what Mitsuba's `conductor` says at each
wavelength, nothing where nothing was measured.
"""

from __future__ import annotations

import ast
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
MODULE = ROOT / "torchrender" / "scene" / "conductors.py"
FILES = Path(mi.__file__).parent / "data" / "ior"
WAVELENGTHS = np.arange(360.0, 831.0, 5.0)
PARTS = ("eta", "k")


def names() -> list[str]:
    """Those of `conductors.CONDUCTORS`, whose package needs PyTorch, which Mitsuba's environment need not have."""
    for statement in ast.parse(MODULE.read_text()).body:
        if isinstance(statement, ast.Assign) and getattr(statement.targets[0], "id", "") == "CONDUCTORS":
            return list(ast.literal_eval(statement.value))
    raise ValueError(f"{MODULE}: no CONDUCTORS")


def whole(name: str, part: str) -> np.ndarray:
    """The values at WAVELENGTHS: straight lines, also where an index of 0 says that there was none; the ends held."""
    table = np.loadtxt(FILES / f"{name}.{part}.spd")
    known = table[table[:, 1] > 0] if part == "eta" else table  # k is 0 in what is transparent
    return np.interp(WAVELENGTHS, *known.T)


def limits(name: str) -> np.ndarray:
    """The first and last wavelength of the table, within WAVELENGTHS."""
    table = np.loadtxt(FILES / f"{name}.eta.spd")
    return table[[0, -1], 0].clip(WAVELENGTHS[0], WAVELENGTHS[-1])


def evaluated(name: str) -> list[np.ndarray]:
    """eta and k at WAVELENGTHS as Mitsuba's `conductor` has them.

    Mitsuba refuses tables of zeros, and with them a conductor whose k is one: its eta is then read alone.
    """
    files = {part: FILES / f"{name}.{part}.spd" for part in PARTS}
    if np.loadtxt(files["k"])[:, 1].any():
        described = {"type": "conductor", "material": name}
    else:
        described = {"type": "conductor", "eta": {"type": "spectrum", "filename": str(files["eta"])}, "k": 1.0}
    params = mi.traverse(mi.load_dict(described))
    it = mi.SurfaceInteraction3f()
    found = []
    for part in PARTS:
        if f"{part}.wavelengths" not in params:
            found.append(np.zeros(len(WAVELENGTHS)))
            continue
        numbers = {what: ",".join(map(repr, params[f"{part}.{what}"])) for what in ("wavelengths", "values")}
        spectrum = mi.load_dict({"type": "irregular", **numbers})
        values = []
        for wavelength in WAVELENGTHS:
            it.wavelengths = mi.Spectrum(wavelength)
            values.append(spectrum.eval(it)[0])
        found.append(np.array(values))
    return found


def main() -> None:
    mi.set_variant("scalar_spectral")
    listed = names()
    made = {part: np.stack([whole(name, part) for name in listed]) for part in PARTS}
    made["range"] = np.stack([limits(name) for name in listed])
    write(MODULE.with_suffix(".npz"), listed, made)
    read = np.stack([evaluated(name) for name in listed], 1)
    write(ROOT / "tests" / "data" / "conductor_spectra.npz", listed, dict(zip(PARTS, read, strict=True)))


def write(path: Path, listed: list[str], tables: dict[str, np.ndarray]) -> None:
    np.savez_compressed(path, names=np.array(listed), **{key: t.astype(np.float32) for key, t in tables.items()})


if __name__ == "__main__":
    main()
