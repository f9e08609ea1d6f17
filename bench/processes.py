"""Measurements that need a fresh process: start-up time and peak memory."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from .mitsuba_peer import connect
from .rows import ROWS

ROOT = Path(__file__).resolve().parent.parent


def ours(index: int, threads: int, resolution: int, spp: int, steps: int) -> dict:
    """torchrender on row `index` in a fresh process: seconds to import, load, first gradient; MiB above torch."""
    command = [sys.executable, "-m", "bench.child", *map(str, (index, threads, resolution, spp, steps))]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"the measuring process failed:\n{result.stderr}")
    return json.loads(result.stdout.splitlines()[-1])


def mitsuba(index: int, threads: int, resolution: int, spp: int, steps: int, python: str) -> dict | None:
    """The same for Mitsuba, whose disk cache of compiled kernels starts empty (it lives under the home folder)."""
    row = ROWS[index]
    with tempfile.TemporaryDirectory() as home:
        start = time.perf_counter()
        peer = connect(python, threads, {"HOME": home})
        if peer is None:
            return None
        try:
            imported = time.perf_counter()
            peer.ask(
                "load",
                path=row.path,
                arguments=row.arguments,
                parameters=list(row.parameters),
                resolution=resolution,
                spp=spp,
            )
            loaded = time.perf_counter()
            peer.ask("step", seed=0)
            done = time.perf_counter()
            for seed in range(1, steps):
                peer.ask("step", seed=seed)
            memory = peer.ask("memory")
        finally:
            peer.close()
    result = {"import": imported - start, "load": loaded - imported, "first_gradient": done - loaded}
    return {**result, "memory": memory["peak"] - memory["start"]}
