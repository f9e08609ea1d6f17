"""Where rays are traced and images rendered: on the CPU, on a card or on the emulated device; what there is of CUDA.

The emulated device is the host that behaves like a card, for tests: it has memory of its own, which is guarded, works
later than it is asked to, and shuffles what runs at once. Environment variables: ``TORCHRENDER_BACKEND`` is ``cpu``,
``cuda``, ``cuda:NUMBER`` or ``emulated``, read when it is first needed (without it a card computes the scenes that lie
on it, the CPU all others); ``TORCHRENDER_NVRTC`` is the path of CUDA's compiler; ``TORCHRENDER_KERNELS`` names folders
with kernels that were compiled before (cuda/compile.py), with ``:`` between them. Nothing of CUDA is loaded unless a
card is to compute, but by `report`.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from .library import Library

CHOICES = ("cpu", "emulated")  # and cards
IMAGES = ("render", "render_vjp", "render_jvp", "render_aov", "aov_vjp", "aov_jvp", "find_outlines", "boundary")
FUNCTIONS = ("ray_intersect", "ray_occluded", *IMAGES)
"""What other devices have; of `IMAGES`, which are pictures and their derivatives, a part, see render_devices.py."""

_WHAT = "ray queries, images and their derivatives (tr.ray_intersect, tr.ray_occluded, tr.render)"

PACKS = Path(__file__).resolve().parent / "_packs"
"""Kernels of common scenes, where the package was installed with them (``TORCHRENDER_CUDA``, ``make cuda``)."""

_NO_NVRTC = "there is no NVRTC: pip install nvidia-cuda-nvrtc-cu12, or set TORCHRENDER_NVRTC"

_chosen: str | None = None
_with_compiler: set[str] = set()  # cores that know one
_with_memory: set[str] = set()  # ... that have PyTorch's


def device(home: torch.device | None = None) -> str:
    """What computes: ``"cpu"``, ``"emulated"``, ``"cuda:0"``.

    That is what ``TORCHRENDER_BACKEND`` has chosen for this process; else, of a scene that lies on a card (`home`),
    this card; else the CPU.
    """
    global _chosen
    if _chosen is None:
        given = os.environ.get("TORCHRENDER_BACKEND", "").strip()
        given = "cuda:0" if given == "cuda" else given
        if given and given not in CHOICES and not re.fullmatch(r"cuda:\d{1,3}", given):
            raise ValueError(f"TORCHRENDER_BACKEND: expected cpu, emulated, cuda or cuda:NUMBER, got {given!r}")
        _chosen = given
    return _chosen or (str(home) if home is not None and home.type == "cuda" else "cpu")


EMULATED: dict[str, Callable[[torch.Tensor], int]] = {}
"""Types of PyTorch's devices whose memory the emulated device has, in tests, with the addresses of their tensors."""


def address(tensor: torch.Tensor) -> int:
    """Where its numbers begin, in the memory in which it lies."""
    emulated = EMULATED.get(tensor.device.type)
    return tensor.data_ptr() if emulated is None else emulated(tensor)


def holds(computing: str, place: torch.device) -> bool:
    """Whether tensors that lie there are in the memory of what computes, see `device`; of the CPU that is not asked."""
    return computing == str(place) or (computing == "emulated" and place.type in EMULATED)


@contextlib.contextmanager
def chosen(name: str) -> Iterator[None]:
    """Another device for a while: one of `CHOICES` or a card.

    Or ``tree``, where the CPU walks the tree of devices; or ``sm_90``, where nothing runs, but kernels are compiled for
    cards of this capability, or ``compute_80``, into PTX for these and later ones.
    """
    global _chosen
    before, _chosen = _chosen, name
    try:
        yield
    finally:
        _chosen = before


def kernels() -> Path:
    """The folder of the sources that kernels are compiled from: of the package, or of the repository that it is in."""
    package = Path(__file__).resolve().parent
    installed = package / "_kernels"
    return installed if installed.is_dir() else package.parent / "csrc"


def use_compiler(core: Library) -> None:
    """Name the compiler of kernels to a core that is to use a card. RuntimeError if there is none, and no kernels."""
    if core.isa not in _with_compiler:
        packs = compiled_before()
        _name_compiler(core, "", packs, needed=not packs)
        _with_compiler.add(core.isa)


def share_memory(core: Library) -> None:
    """A scene lies on a card: what else it takes there is PyTorch's memory, too."""
    if core.isa not in _with_memory:
        from .cuda.memory import use_memory  # when it is needed

        use_memory(core)
        _with_memory.add(core.isa)


def raise_error_of_memory() -> None:
    """What PyTorch's memory of cards has ended a call of the core for; nothing if it was something else."""
    if _with_memory:
        from .cuda.memory import errors

        if errors:
            raise errors.pop()


@contextlib.contextmanager
def compiling_into(core: Library, folder: Path) -> Iterator[None]:
    """Kernels are compiled into this folder for a while. RuntimeError if there is no compiler."""
    _name_compiler(core, str(folder), [], needed=True)
    _with_compiler.add(core.isa)
    try:
        yield
    finally:
        _with_compiler.discard(core.isa)


def compiled_before() -> list[str]:
    """Folders of kernels that were compiled before: those of ``TORCHRENDER_KERNELS``, and what the package has.

    ValueError if one is missing.
    """
    folders = [folder for folder in os.environ.get("TORCHRENDER_KERNELS", "").split(os.pathsep) if folder]
    for folder in folders:
        if not Path(folder).is_dir():
            raise ValueError(f"TORCHRENDER_KERNELS: there is no folder {folder}")
    return [*folders, *([str(PACKS)] if PACKS.is_dir() else [])]


def _name_compiler(core: Library, into: str, packs: list[str], needed: bool) -> None:
    problem = ""
    for path in nvrtc_candidates():
        try:
            return core.use_cuda_compiler(path, str(kernels()), into, packs)
        except RuntimeError as error:
            if os.sep in path:
                problem = problem or str(error)
    if needed:
        raise RuntimeError(problem or _NO_NVRTC)
    core.use_cuda_compiler("", str(kernels()), into, packs)


def named(computing: str) -> str:
    """Another device than the CPU, and what has chosen it, for messages."""
    return f"TORCHRENDER_BACKEND={computing}" if _chosen else f"a scene on {computing}"


def everything_on_the_cpu() -> str:
    """What helps where a device does not have something."""
    return f"with TORCHRENDER_BACKEND=cpu{', or without it,' if _chosen else ''} everything is there"


def require_cpu(what: str, computing: str) -> None:
    """RuntimeError if another device is to compute, which does not have this yet."""
    if computing != "cpu":
        raise RuntimeError(f"{what}: {named(computing)} has {_WHAT} so far; {everything_on_the_cpu()}")


def report(core: Library) -> dict[str, str]:
    """What `torchrender.backends.devices` returns."""
    used = device()
    name = used.partition(":")[0]
    sentences = {
        "cpu": "used for everything",
        "emulated": f"a test of what runs on cards, has {_WHAT}; TORCHRENDER_BACKEND=emulated chooses it",
        "cuda": f"has {_WHAT}; scene.to('cuda') or TORCHRENDER_BACKEND=cuda chooses it",
    }
    if used != "cpu":
        sentences["cpu"] = f"not used, by TORCHRENDER_BACKEND={used}; without it everything runs here"
        sentences[name] = f"used by TORCHRENDER_BACKEND, has {_WHAT} so far"
    return {**sentences, "cuda": f"{sentences['cuda']}; {_driver(core)}; {_nvrtc(core)}"}


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
    problem = problem or _NO_NVRTC
    return f"{problem}; without it there are the kernels in {PACKS} alone" if PACKS.is_dir() else problem


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
