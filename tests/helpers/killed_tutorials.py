"""Tutorials that are killed and started again, and the checkpoints that they leave."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import fresh_python
import pytest
import torch
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "tutorials"


def checkpoint_in(folder: Path) -> dict:
    return torch.load(folder / "checkpoint.pt", weights_only=True)


def same_checkpoints(first: Path, second: Path) -> dict:
    """Checks that two runs have left the same, all of it and bit for bit, and returns it."""
    one, two = checkpoint_in(first), checkpoint_in(second)
    torch.testing.assert_close(two, one, rtol=0, atol=0)
    return one


@contextlib.contextmanager
def without_diagrams() -> Iterator[None]:
    """Empty files, for runs whose diagrams nobody looks at: to draw them takes longer than to solve small problems."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda _, path, **__: Path(path).touch())
        yield


def runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def killed_after_a_checkpoint(name: str, folder: Path, settings: dict) -> None:
    """Run a tutorial in a process of its own, without diagrams, and kill that when it has left a checkpoint."""
    code = (
        f"import sys; sys.path[:0] = [{str(TUTORIALS)!r}, {str(ROOT)!r}, {os.path.dirname(__file__)!r}]\n"
        f"import json, pathlib, torch, {name}; from killed_tutorials import without_diagrams\n"
        f"torch.set_num_threads({torch.get_num_threads()})\n"
        f"with without_diagrams(): {name}.run(pathlib.Path({str(folder)!r}), **json.loads({json.dumps(settings)!r}))"
    )

    def kill(process: int) -> None:
        deadline = time.monotonic() + 120
        while not (folder / "checkpoint.pt").exists() and time.monotonic() < deadline and runs(process):
            time.sleep(0.005)
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)

    done = fresh_python.run(code, timeout=150, meanwhile=kill)
    assert done.returncode == -signal.SIGKILL, done.stderr


def goes_on_after_a_kill(
    tutorial: ModuleType,
    whole: Path,
    result: dict[str, float],
    settings: dict,
    capsys: pytest.CaptureFixture[str],
    *,
    save_every: int,
    total: int,
) -> Path:
    """Checks that a run that is killed after its first checkpoints goes on from there and finds the same as one that
    was left alone.

    Args:
        tutorial: the module.
        whole, result, settings: of the run that was left alone: its folder, what it returned, and its settings.
        capsys: what the second run prints is read from there.
        save_every: iterations after which the killed run writes checkpoints; where meshes move, the other one, too.
        total: iterations of a whole run.

    Returns:
        the folder of the killed run, beside the other one.
    """
    parts, settings = whole.with_name("parts"), {**settings, "save_every": save_every}
    killed_after_a_checkpoint(tutorial.__name__, parts, settings)
    at = checkpoint_in(parts)["iteration"]
    assert save_every <= at < total
    with without_diagrams():
        found = tutorial.run(parts, **settings)
    assert found == result
    assert f"going on from iteration {at} of {total} " in capsys.readouterr().out
    assert same_checkpoints(whole, parts)["iteration"] == total
    return parts
