"""Where rays are traced and images rendered: on the CPU or on the emulated device; and what this machine has of CUDA.

The emulated device is the host that behaves like a card, for tests: it has memory of its own, which is guarded, works
later than it is asked to, and shuffles what runs at once. Environment variables: ``TORCHRENDER_BACKEND`` is ``cpu``
(the default) or ``emulated``, read when it is first needed; ``TORCHRENDER_NVRTC`` is the path of CUDA's compiler.
Nothing of CUDA is loaded but by `report`.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from .library import Library

CHOICES = ("cpu", "emulated")
FUNCTIONS = ("ray_intersect", "ray_occluded", "render")
"""What the emulated device has; of `render` a part, see render_devices.py."""

_WHAT = "ray queries and images without derivatives (tr.ray_intersect, tr.ray_occluded, tr.render)"

_chosen: str | None = None


def device() -> str:
    """The device that ``TORCHRENDER_BACKEND`` has chosen for this process: ``"cpu"`` or ``"emulated"``."""
    global _chosen
    if _chosen is None:
        given = os.environ.get("TORCHRENDER_BACKEND", "").strip() or "cpu"
        if given not in CHOICES:
            cards = "; nothing runs on a card yet" if given.startswith("cuda") else ""
            raise ValueError(f"TORCHRENDER_BACKEND: expected {' or '.join(CHOICES)}, got {given!r}{cards}")
        _chosen = given
    return _chosen


def require_cpu(what: str) -> None:
    """RuntimeError if another device is chosen, which does not have this yet."""
    if device() != "cpu":
        raise RuntimeError(
            f"{what}: TORCHRENDER_BACKEND={device()} has {_WHAT} so far; with TORCHRENDER_BACKEND=cpu, or without it, "
            "everything is there"
        )


def refusal(place: torch.device) -> str:
    """The end of the sentence that refuses a tensor which does not lie on the CPU."""
    what = "nothing runs on a card yet, torchrender" if place.type == "cuda" else "torchrender"
    return f"{what} computes on the CPU: use .to('cpu')"


def report(core: Library) -> dict[str, str]:
    """What `torchrender.backends.devices` returns."""
    sentences = {
        "cpu": "used for everything",
        "emulated": f"a test of what will run on cards, has {_WHAT}; TORCHRENDER_BACKEND=emulated chooses it",
    }
    if device() == "emulated":
        sentences = {
            "cpu": "not used, by TORCHRENDER_BACKEND=emulated; without it everything runs here",
            "emulated": f"used by TORCHRENDER_BACKEND, has {_WHAT} so far",
        }
    cards = "nothing runs on a card yet (compiled and emulated, never run on a card)"
    return {**sentences, "cuda": f"{cards}; {_driver(core)}; {_nvrtc(core)}"}


def _driver(core: Library) -> str:
    try:
        return f"there is an NVIDIA driver for CUDA {core.cuda_driver()}"
    except RuntimeError as error:
        return str(error)


def _nvrtc(core: Library) -> str:
    """What there is of CUDA's compiler."""
    problem = ""
    for path in nvrtc_candidates():
        try:
            return f"there is NVRTC {core.nvrtc(path)} at {path}"
        except RuntimeError as error:
            if os.sep in path:  # it was meant, or is there
                problem = problem or str(error)
    return problem or "there is no NVRTC: pip install nvidia-cuda-nvrtc-cu12, or set TORCHRENDER_NVRTC"


def nvrtc_candidates() -> Iterator[str]:
    """Where NVRTC may be, best first: paths, then names under which the system may have it.

    ``TORCHRENDER_NVRTC`` alone where it is set; else that of this process (PyTorch loads one), those of NVIDIA's
    packages and of the toolkit, the newest first.
    """
    given = os.environ.get("TORCHRENDER_NVRTC", "").strip()
    if given:
        yield given
        return
    maps = Path("/proc/self/maps")
    yield from sorted(set(re.findall(r"/\S*/libnvrtc\.so\.\d+[.\d]*", maps.read_text() if maps.exists() else "")))
    spec = importlib.util.find_spec("nvidia")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or [])] if spec else []
    found = [path for folder in folders for path in sorted(folder.glob("*/lib/libnvrtc.so.*"))]
    found += sorted(Path("/usr/local").glob("cuda*/lib64/libnvrtc.so.*"))
    numbered = [path for path in found if path.suffix[1:].isdecimal() and path.stem == "libnvrtc.so"]
    yield from map(str, sorted(numbered, key=lambda path: -int(path.suffix[1:])))
    yield from ("libnvrtc.so.13", "libnvrtc.so.12")
