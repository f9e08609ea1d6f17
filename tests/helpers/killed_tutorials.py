"""Tutorials in processes of their own that are killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import torch

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "tutorials"


def killed_after_a_checkpoint(name: str, folder: Path, settings: dict) -> None:
    """Run a tutorial in a process of its own and kill that when it has left a checkpoint."""
    code = (
        f"import json, pathlib, torch, {name}; torch.set_num_threads({torch.get_num_threads()})\n"
        f"{name}.run(pathlib.Path({str(folder)!r}), **json.loads({json.dumps(settings)!r}))"
    )
    path = os.pathsep.join([str(TUTORIALS), str(ROOT)])
    process = subprocess.Popen(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120
    while not (folder / "checkpoint.pt").exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    error = process.communicate()[1]
    assert process.returncode == -signal.SIGKILL, error
