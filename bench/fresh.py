"""Measurements that need a process of their own: this module is what runs there, and prints one line of JSON.

python -m bench.fresh coldstart '{"row": 0, "threads": 2, "resolution": 256, "spp": 16, "renderer": {}}'
python -m bench.fresh memory    '{..., "steps": 3}'
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from .serving import memory, settled_memory

ROOT = Path(__file__).resolve().parent.parent


def measure(what: str, **settings: Any) -> dict[str, float]:
    """Run `what` in a fresh process; ends the program with what it printed if it fails."""
    command = [sys.executable, "-m", "bench.fresh", what, json.dumps(settings)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if result.returncode:
        raise SystemExit(f"the measuring process ended with status {result.returncode}:\n{result.stderr.strip()}")
    return json.loads(result.stdout.splitlines()[-1])


def coldstart(row: int, threads: int, resolution: int, spp: int, renderer: dict[str, Any]) -> dict[str, float]:
    """Seconds until torchrender is imported, the scene loaded, the first gradient there; torch is imported before."""
    import torch

    torch.set_num_threads(threads)
    # A first backward pass starts torch's own autograd machinery.
    torch.ones(3, requires_grad=True).square().sum().backward()
    start = time.perf_counter()
    import torchrender  # noqa: F401

    imported = time.perf_counter()
    from .ours import Ours
    from .rows import ROWS

    ours = Ours.of_row(ROWS[row], resolution, spp, **renderer)
    loaded = time.perf_counter()
    ours.step(0)
    done = time.perf_counter()
    return {"import": imported - start, "load": loaded - imported, "first step": done - loaded, "total": done - start}


def peak_memory(
    row: int, threads: int, resolution: int, spp: int, renderer: dict[str, Any], steps: int
) -> dict[str, float]:
    """MiB that forward and backward passes add, at their peak, to a process that has loaded the scene.

    ``scene``: what the core keeps of the scene (acceleration structure, tables), seen after one pixel without
    derivatives. ``peak``: all that is added, the scene's share included. ``gradients``: the gradients' own size.
    """
    import torch

    from .ours import Ours
    from .rows import ALL_ROWS

    torch.set_num_threads(threads)
    torch.ones(3, requires_grad=True).square().sum().backward()
    ours = Ours.of_row(ALL_ROWS[row], resolution, spp, **renderer)
    before = settled_memory()
    with torch.no_grad():
        ours.renderer(seed=0, spp=1, crop=(0, 0, 1, 1))
    scene = max(0.0, settled_memory() - before)
    for seed in range(steps):
        ours.step(seed)
    gradients = sum(p.numel() * p.element_size() for p in ours.parameters) / 2**20
    return {"scene": scene, "peak": max(0.0, memory("VmHWM") - before), "gradients": gradients}


def media_memory(
    size: int, threads: int, resolution: int, spp: int, renderer: dict[str, Any], steps: int
) -> dict[str, float]:
    """MiB that steps add, at their peak, to a process that has loaded the cloud; and the size of its gradient."""
    from argparse import Namespace

    import torch

    from .media import CLOUD, Loaded

    torch.set_num_threads(threads)
    torch.ones(3, requires_grad=True).square().sum().backward()
    with Loaded(CLOUD, size) as loaded:
        ours = loaded.ours(Namespace(resolution=resolution, renderer=list(renderer.items())), spp)
    before = settled_memory()
    for seed in range(steps):
        ours.step(seed)
    gradients = sum(p.numel() * p.element_size() for p in ours.parameters) / 2**20
    return {"peak": max(0.0, memory("VmHWM") - before), "gradients": gradients}


def caustics_memory(
    size: int, threads: int, resolution: int, spp: int, renderer: dict[str, Any], steps: int
) -> dict[str, float]:
    """Peak of the process in MiB, and what of it iterations of the caustics add to the loaded scene."""
    import torch

    from .caustics import Plate

    torch.set_num_threads(threads)
    plate = Plate(size, resolution, spp, **renderer)
    before = settled_memory()
    for seed in range(steps):
        plate.iteration(seed)
    peak = memory("VmHWM")
    return {"peak": peak, "added": max(0.0, peak - before)}


def bent_rays(**settings: Any) -> dict[str, float]:
    """Seconds and memory of rays through a gradient index, and their adjoint."""
    from .gradient_index import fresh

    return fresh(**settings)


def main() -> None:
    what, settings = sys.argv[1], json.loads(sys.argv[2])
    kinds = {"coldstart": coldstart, "memory": peak_memory, "media_memory": media_memory}
    kinds |= {"caustics_memory": caustics_memory, "bent_rays": bent_rays}
    print(json.dumps(kinds[what](**settings)))


if __name__ == "__main__":
    main()
