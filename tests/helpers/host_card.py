"""A card that is the host (host_card.cpp): kernels are compiled for a scene and launched as on cards, and run here.

``TORCHRENDER_HOST_CARD=FOLDER python -m pytest tests/api/test_emulated_sights.py`` has it in the place of the emulated
device. The folder gets the libraries and the kernels, which later runs find there: half a second of a processor each,
some hundred for a test of edges.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

VARIABLE = "TORCHRENDER_HOST_CARD"
SOURCE = Path(__file__).with_suffix(".cpp")
DRIVER, COMPILER = "libcuda.so.1", "libnvrtc.so.12"


def build(folder: Path) -> None:
    """Make its driver and its compiler, which are one library. RuntimeError where the host has no compiler."""
    compiler = shutil.which("c++")
    if compiler is None:
        raise RuntimeError("there is no c++, which makes a card of the host")
    folder.mkdir(parents=True, exist_ok=True)
    for name in (DRIVER, COMPILER):  # by which it is found where it was loaded before
        made = folder / f"{name}.{os.getpid()}"
        command = [compiler, "-std=c++17", "-O1", "-shared", "-fPIC", f"-Wl,-soname,{name}", "-o", made]
        subprocess.run([*command, SOURCE, "-ldl"], check=True, timeout=120)
        made.replace(folder / name)


def use(folder: Path) -> str:
    """This process has that card, once and for all; its name."""
    ctypes.CDLL(str(folder / DRIVER))  # which is found by its name from now on
    os.environ[VARIABLE] = str(folder)
    os.environ["TORCHRENDER_NVRTC"] = str(folder / COMPILER)
    os.environ["TORCHRENDER_CACHE"] = str(folder / "cache")
    return "cuda:0"
