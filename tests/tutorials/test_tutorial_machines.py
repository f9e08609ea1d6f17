"""The tutorial on many machines: two processes, of which one is killed, find what one process finds."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from killed_tutorials import checkpoint_in

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "tutorials"
SMALL = {"texture_size": 16, "resolution": 40, "view_count": 4, "spp": 4, "iterations": 30, "target_spp": 32}

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds processes as Linux lists them")

PROGRAM = """
import json, os, pathlib, sys
import many_machines
folder, settings = pathlib.Path(sys.argv[1]), json.loads(sys.argv[2])
(folder / f"process_{os.environ['RANK']}_{os.environ['TORCHELASTIC_RESTART_COUNT']}").write_text(str(os.getpid()))
result = many_machines.run(folder, save_every=2, **settings)
if os.environ["RANK"] == "0":
    (folder / "result.json").write_text(json.dumps(result))
"""


@pytest.fixture
def tutorial(tutorial):
    return tutorial("many_machines")


def start(folder: Path, processes: int) -> subprocess.Popen[str]:
    """The tutorial by torchrun."""
    folder.mkdir()
    program = folder.with_suffix(".py")
    program.write_text(PROGRAM)
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    command = [*launch, "--max-restarts", "1", str(program), str(folder), json.dumps(SMALL)]
    path = os.pathsep.join([str(TUTORIALS), str(ROOT)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "TORCH_DISABLE_SHARE_RDZV_TCP_STORE": "1"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_a_killed_process_changes_nothing(tutorial, tmp_path, capsys):
    alone = tutorial.run(tmp_path / "alone", **SMALL)
    assert alone["end"] > alone["start"] + 2

    folder = tmp_path / "two"
    running = start(folder, 2)
    deadline = time.monotonic() + 240
    while not (folder / "checkpoint.pt").exists() and time.monotonic() < deadline and running.poll() is None:
        time.sleep(0.005)
    os.kill(int((folder / "process_1_0").read_text()), signal.SIGKILL)  # not the one that writes
    printed = running.communicate(timeout=240)[0]
    assert running.returncode == 0, printed[-4000:]
    assert (folder / "process_1_1").exists()  # both were begun again
    assert "going on from iteration" in printed

    found = json.loads((folder / "result.json").read_text())
    assert found["processes"] == 2 and found["end"] == pytest.approx(alone["end"], rel=1e-3)
    one, two = checkpoint_in(tmp_path / "alone"), checkpoint_in(folder)
    torch.testing.assert_close(two["curves"]["loss"], one["curves"]["loss"], rtol=1e-3, atol=0)
    assert len(two["curves"]["loss"]) == SMALL["iterations"]
    torch.testing.assert_close(two["texture"], one["texture"], rtol=0, atol=5e-3)  # Adam's steps of rounded gradients
    for name in ("result.png", "texture_result.png", "loss.png"):
        assert (folder / name).stat().st_size > 100, name


def test_views_have_to_be_shared_out(tutorial, tmp_path, monkeypatch):
    monkeypatch.setattr(tutorial, "processes", lambda: contextlib.nullcontext((0, 3)))
    with pytest.raises(ValueError, match="--views: expected a multiple of the 3 processes, got 4"):
        tutorial.run(tmp_path, **SMALL)
