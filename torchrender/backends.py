"""Which compiled cores exist, which one runs, where Embree comes from, and where rays are traced.

The same C++ sources are compiled once per instruction set into libraries of their own, which compute in packets of
single precision; the best one that this processor supports is loaded when it is first needed. One more, ``scalar``,
computes a number at a time, in double precision too. Environment variables: ``TORCHRENDER_ISA`` forces one of
``scalar``, ``v2``, ``avx2``, ``avx512``; ``TORCHRENDER_EMBREE`` is the path of another Embree 4 library.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import importlib.util
import os
import platform
import sys
import threading
from pathlib import Path
from typing import Any

from . import openmp
from ._version import __version__
from .devices import device as device
from .devices import report
from .library import Library

PREFERENCE = ("avx512", "avx2", "v2", "scalar")
"""Instruction sets, best first."""

PACKETS = True
"""Whether single precision is computed in packets. False computes it a number at a time, too: slower, for tests."""

_lock = threading.RLock()
_core: Library | None = None
_embree: dict[str, Any] | None = None
_embree_path: str | None = None
_with_embree: set[str] = set()  # instruction sets whose cores have loaded it


def compiled() -> list[str]:
    """Instruction sets that this installation has a compiled core for, best first."""
    return [isa for isa in PREFERENCE if _path(isa).exists()]


def _path(isa: str) -> Path:
    return Path(__file__).parent / f"_core_{isa}.so"


@functools.cache
def library(isa: str) -> Library:
    """The compiled core of an instruction set; ImportError if it cannot be loaded."""
    try:
        return Library(_path(isa), isa)
    except OSError as error:
        raise ImportError(f"the compiled core cannot be loaded: {error}") from error


def _supported(present: list[str]) -> dict[str, bool]:
    """Which of the compiled instruction sets this processor has."""
    if "v2" in present:
        flags = library("v2").cpu_supports()
    else:
        import torch

        level = torch.backends.cpu.get_cpu_capability()
        flags = {"v2": True, "avx2": level in ("AVX2", "AVX512"), "avx512": level == "AVX512"}
    flags["scalar"] = True
    return {isa: bool(flags.get(isa, False)) for isa in present}


def status() -> dict[str, str]:
    """For each instruction set a word or two: ``"used"``, ``"available"``, or why it is not used.

    Loads the native core if that has not happened yet.
    """
    present = compiled()
    supported = _supported(present) if present else {}
    used = ""
    with contextlib.suppress(ImportError):
        used = core().isa
    report = {}
    for isa in PREFERENCE:
        if isa == used:
            forced = os.environ.get("TORCHRENDER_ISA") == isa
            report[isa] = "used" + (", forced by TORCHRENDER_ISA" if forced else "")
        elif isa not in present:
            report[isa] = "not compiled"
        elif not supported[isa]:
            report[isa] = "compiled, but this processor does not support it"
        else:
            report[isa] = f"available, but {used} is preferred"
    return report


def _choose() -> str:
    present = compiled()
    if not present:
        raise ImportError(
            "torchrender has no compiled core: build it with 'pip install .' (or 'make build') in its source folder"
        )
    forced = os.environ.get("TORCHRENDER_ISA", "").strip()
    supported = _supported(present)
    if forced:
        if forced not in PREFERENCE:
            raise ImportError(f"TORCHRENDER_ISA: expected one of {', '.join(PREFERENCE)}, got {forced!r}")
        if forced not in present:
            raise ImportError(f"TORCHRENDER_ISA={forced}: not compiled here; there are: {', '.join(present)}")
        if not supported[forced]:
            raise ImportError(f"TORCHRENDER_ISA={forced}: this processor does not support it")
        return forced
    for isa in present:
        if supported[isa]:
            return isa
    raise ImportError(f"none of the compiled cores ({', '.join(present)}) runs on this processor: rebuild torchrender")


def core(dtype: Any = None) -> Library:
    """The compiled core that computes in `dtype` (single precision if None), without Embree loaded.

    ImportError says in one sentence what is missing.
    """
    global _core
    if str(dtype) == "torch.float64" or not PACKETS:
        return _scalar()
    if _core is None:
        with _lock:
            if _core is None:
                _core = library(_choose())
    return _core


def _scalar() -> Library:
    if "scalar" not in compiled():
        raise ImportError(
            "torchrender has no compiled core for double precision: build it with 'pip install .' (or 'make build') in "
            "its source folder"
        )
    return library("scalar")


def scene_core(dtype: Any = None, home: Any = None) -> Library:
    """The compiled core that has scenes in `dtype`: other devices than the CPU compute a number at a time.

    `home`: see `torchrender.devices.device`.
    """
    return core(dtype) if device(home) == "cpu" else _scalar()


def ready(dtype: Any = None, home: Any = None) -> Library:
    """`scene_core` with Embree loaded and tested: what building a scene needs."""
    found = scene_core(dtype, home)
    if found.isa not in _with_embree:
        with _lock:
            if found.isa not in _with_embree:
                found.use_openmp(*openmp.addresses())
                _load_embree(found, find_embree() if _embree is None else _embree["path"])
    return found


def isa() -> str:
    """The instruction set in use."""
    return core().isa


def find_embree() -> str:
    """Path of the Embree 4 library that is used: the one given, else the one that the embreex wheel brings."""
    given = _embree_path or os.environ.get("TORCHRENDER_EMBREE", "").strip()
    if given:
        if not Path(given).exists():
            raise FileNotFoundError(f"Embree: no such file: {given}")
        return given
    spec = importlib.util.find_spec("embreex")
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("Embree is missing: install it with 'pip install embreex', or set TORCHRENDER_EMBREE")
    package = Path(next(iter(spec.submodule_search_locations)))
    names = {"win32": "embree4*.dll", "darwin": "libembree4*.dylib"}.get(sys.platform, "libembree4*.so*")
    for folder in (package.parent / "embreex.libs", package / ".dylibs", package.parent / "embreex.dylibs", package):
        found = sorted(glob.glob(str(folder / names)))
        if found:
            return found[0]
    raise ImportError(
        f"the embreex package in {package} brings no Embree 4 library: 'pip install --upgrade embreex>=4.4', "
        "or set TORCHRENDER_EMBREE to the path of one"
    )


def use_embree(path: str | os.PathLike[str]) -> None:
    """Use the Embree 4 library at `path`; has to come before the first scene is rendered."""
    global _embree_path
    path = os.fspath(path)
    if not Path(path).exists():
        raise FileNotFoundError(f"use_embree: no such file: {path}")
    with _lock:
        if _embree is not None:
            if os.path.realpath(_embree["path"]) == os.path.realpath(path):
                return
            raise RuntimeError(f"use_embree: {_embree['path']} is already loaded; call this before the first scene")
        _load_embree(core(), path)
        _embree_path = path


def _load_embree(library: Library, path: str) -> None:
    global _embree
    try:
        found = library.load_embree(path)
        _embree = _embree or found
        _with_embree.add(library.isa)
    except RuntimeError as error:
        raise ImportError(f"Embree at {path} cannot be used: {error}") from error


def embree() -> dict[str, Any]:
    """Version and path of the Embree library in use: ``{"version": "4.4.0", "path": ...}``."""
    ready()
    assert _embree is not None
    return dict(_embree)


def devices() -> dict[str, str]:
    """For ``"cpu"``, ``"emulated"`` and ``"cuda"`` a sentence: what runs there, what is missing and what helps.

    Looks for CUDA's driver and compiler, and starts neither.
    """
    return report(core())


def show_config() -> str:
    """Print, and return, what a bug report needs: versions, processor, threads, cores, Embree and devices."""
    import torch

    lines = [
        f"torchrender {__version__}",
        f"python      {platform.python_version()} on {platform.platform()}",
        f"torch       {torch.__version__}, {torch.get_num_threads()} threads",
        f"processor   {platform.machine()}, torch capability {torch.backends.cpu.get_cpu_capability()}",
    ]
    for name, state in status().items():
        lines.append(f"core {name:<7}{state}")
    try:
        info = core().info()
        lines.append("compiled    " + ", ".join(f"{k} {v}" for k, v in info.items()))
        found = embree()
        lines.append(f"embree      {found['version']} at {found['path']}")
        lines += [f"{name:<12}{state}" for name, state in devices().items()]
    except (ImportError, OSError, ValueError) as error:
        lines.append(f"problem     {error}")
    text = "\n".join(lines)
    print(text)
    return text
