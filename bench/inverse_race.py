"""Programs at one inverse problem, step by step in turn, until each has reached the error or its time is up."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .inverse_loop import WARMUP
from .inverse_task import Task
from .peers import Peer, PeerError

HALVINGS = 10  # after which steps are too short to come any nearer
GROWTH = 0.1  # an error is looked at when so many more steps have been made, relative to all before
# Seconds of steps between two looks. A step after a look is slower: threads sleep, caches have the judge's data.
UNDISTURBED = 1.0


@dataclass(frozen=True)
class Point:
    """What was found after so many steps."""

    iterations: int
    seconds: float
    cpu: float  # seconds of the processor, of all threads
    error: float


@dataclass
class Run:
    """One program with a setting and a seed: the clock runs while it makes steps, not while they are judged."""

    peer: Peer
    task: Task
    setting: dict[str, Any]
    folder: Path
    seed: int = 0
    first: float = math.nan  # seconds of the first steps, which do not count
    points: list[Point] = field(default_factory=list)
    found: dict[str, np.ndarray] = field(default_factory=dict)
    failed: str = ""  # what its program said when it could not go on
    whole: dict[str, float] = field(default_factory=dict)  # "seconds", "cpu": of all steps in one go

    def begin(self) -> None:
        self.found = {u.name: u.start for u in self.task.unknowns}
        self.points = [Point(0, 0.0, 0.0, self.task.error(self.found))]
        self.first = self._restart()

    def _restart(self) -> float:
        return self.peer.ask("begin_inverse", setting=self.setting, seed=self.seed)["first"]

    def repeat(self) -> None:
        """As many steps from the start, without a look: their time is what a user waits."""
        self._restart()
        spent = self.peer.ask("advance_inverse", steps=[self.last.iterations], file=str(self._prefix))
        self.whole = {name: spent[name][0] for name in ("seconds", "cpu")}

    @property
    def seconds(self) -> float:
        return self.whole.get("seconds", self.last.seconds)

    @property
    def cpu(self) -> float:
        return self.whole.get("cpu", self.last.cpu)

    @property
    def _prefix(self) -> Path:
        """Of files with what was found."""
        return self.folder / f"found_{self.peer.key.replace(' ', '_')}_"

    @property
    def last(self) -> Point:
        return self.points[-1]

    def check(self, target: float, cap: float) -> None:
        """Some steps, and how good they are; what comes when the run is over is forgotten."""
        steps = self._next_steps()
        spent = self.peer.ask("advance_inverse", steps=steps, file=str(self._prefix))
        for number, (count, seconds, cpu) in enumerate(zip(steps, spent["seconds"], spent["cpu"], strict=True)):
            with np.load(f"{self._prefix}{number}.npz") as found:
                self.found = {name: found[name] for name in found.files}
            last = self.last
            point = (last.iterations + count, last.seconds + seconds, last.cpu + cpu, self.task.error(self.found))
            self.points.append(Point(*point))
            if self.over(target, cap):
                break

    def _next_steps(self) -> list[int]:
        """Numbers of steps, after each of which the error is looked at when all of them are made."""
        last = self.last
        # at first by the steps before, which may have been slower
        each = last.seconds / last.iterations if last.iterations else self.first / WARMUP
        steps: list[int] = []
        while not steps or sum(steps) * each < UNDISTURBED:
            steps.append(max(1, int((last.iterations + sum(steps)) * GROWTH)))
        return steps

    def reached(self, target: float) -> bool:
        return not self.failed and self.last.error <= target

    def outcome(self, target: float) -> str:
        """Whether the target was reached, in words."""
        if self.failed:
            return f"failed: {self.failed}"
        if self.reached(target):
            return "yes"
        return f"not reached in {self.last.seconds:.3g} s: error {100 * self.last.error:.3g} %"

    def over(self, target: float, cap: float) -> bool:
        """Whether the target is reached, or the time is up, or steps have become too short."""
        late = self.last.seconds >= cap or self.last.iterations >= HALVINGS * self.setting["halving"]
        return late or self.reached(target)


def race(runs: Sequence[Run], target: float, cap: float) -> None:
    """All runs to the target or to `cap` seconds; whoever has spent least is next, so that all see the same machine.

    Then those that have come to the target once more, in one go. A program that fails is out of the race, and its run
    says why.
    """
    for run in runs:
        attempt(run, run.begin)
    while left := [run for run in runs if not (run.failed or run.over(target, cap))]:
        run = min(left, key=lambda run: run.last.seconds)
        attempt(run, partial(run.check, target, cap))
    for run in runs:
        if run.reached(target) and run.last.iterations:
            with contextlib.suppress(PeerError):  # the time of the race stands
                run.repeat()


def attempt(run: Run, action: Callable[[], None]) -> None:
    try:
        action()
    except PeerError as error:
        run.failed = str(error)


def loaded(peer: Peer, folder: Path) -> float:
    """The peer has the task of a folder; how far its picture of the truth is from the given one."""
    difference = peer.ask("load_inverse", folder=str(folder))["difference"]
    peer.ask("settle")
    return difference
