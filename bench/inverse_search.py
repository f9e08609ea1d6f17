"""The setting with which a program is soonest at the target: one number of it after the other, by factors of two."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any

from .inverse_race import Run
from .peers import PeerError

# In this order; the rate once more at the end, for others change what is best there.
NUMBERS = ("rate", "samples", "block", "spp", "spp_grad", "spp_seen", "spp_shadows", "views", "smoothness", "grown")
NUMBERS += ("damping", "signs", "probes", "halving", "rate")
REAL = ("rate", "smoothness", "damping", "signs")  # those that need not be whole
# Those that programs have besides "independent".
SAMPLERS = {"torchrender": ("stratified", "sobol"), "mitsuba": ("stratified", "multijitter", "ldsampler")}
# ... and other settings that are tried, by the name of the program.
OTHERS: dict[str, list[dict[str, Any]]] = {"torchrender": [{"renderer": {"adaptive_grad": True}}]}

Setting = dict[str, Any]


@dataclass(frozen=True)
class Trial:
    """A setting, whether all of its runs came to the target, and where they were then or when their time was up.

    Numbers are means of the runs.
    """

    setting: Setting
    reached: bool
    iterations: float
    seconds: float
    cost: float  # by which settings are compared: seconds, or those of the processor
    error: float


def scaled(setting: Setting, name: str, factor: float) -> Setting | None:
    """The setting with one number multiplied, or both numbers of samples; None where there is no such."""
    names = ("spp", "spp_grad") if name == "samples" else (name,)
    if not all(setting.get(each) for each in names):
        return None
    found = dict(setting)
    for each in names:
        value = setting[each] * factor
        if each not in REAL:
            if value < 1 or value != int(value):
                return None
            value = int(value)
        found[each] = value
    return found


class Search:
    """Trials of one program at one problem.

    Args:
        run_of: makes a run with a setting and a seed.
        target: the error to be reached.
        cap: seconds of the first trial; later ones end where they cannot be the best any more.
        by_cpu: compare seconds of the processor: where other work runs on the machine.
        runs: of each setting, with seeds of their own: of many settings the best one with a single seed is a lucky one.
    """

    def __init__(
        self, run_of: Callable[[Setting, int], Run], target: float, cap: float, by_cpu: bool = False, runs: int = 1
    ) -> None:
        self.run_of, self.target, self.cap, self.by_cpu, self.runs = run_of, target, cap, by_cpu, runs
        self.trials: list[Trial] = []
        self.best: Trial | None = None

    def attempt(self, setting: Setting) -> bool:
        """Whether a setting is better than all before."""
        if any(trial.setting == setting for trial in self.trials):
            return False
        ends, spent, reached = [], 0.0, True
        for seed in range(self.runs):
            run = self.run_of(setting, seed)
            try:
                run.begin()
                while not run.over(self.target, self.cap) and not self._beaten(spent + self._cost(run)):
                    run.check(self.target, self.cap)
            except PeerError as error:  # a sampler that does not take such a number of samples, values without bounds
                print(f"{setting}: {error}", file=sys.stderr, flush=True)
                return False
            ends.append(run.last)
            spent, reached = spent + self._cost(run), run.reached(self.target)
            if not reached:
                break
        numbers = [mean([getattr(end, name) for end in ends]) for name in ("iterations", "seconds")]
        trial = Trial(setting, reached, *numbers, spent / len(ends), mean([end.error for end in ends]))
        self.trials.append(trial)
        print(f"{run.peer.title}: {trial}", file=sys.stderr, flush=True)
        better = self.best is None or self._key(trial) < self._key(self.best)
        if better:
            self.best = trial
        return better

    def _cost(self, run: Run) -> float:
        return run.last.cpu if self.by_cpu else run.last.seconds

    def _beaten(self, spent: float) -> bool:
        """Whether a setting whose runs have cost so much so far cannot be the best any more."""
        return self.best is not None and self.best.reached and spent >= self.runs * self.best.cost

    @staticmethod
    def _key(trial: Trial) -> tuple[bool, float]:
        return (False, trial.cost) if trial.reached else (True, trial.error)

    def search(
        self, start: Setting, program: str, more: Sequence[Setting] = (), numbers: tuple[str, ...] = NUMBERS
    ) -> Setting:
        """The best setting from `start` on; `more` are tried besides what the program's name says."""
        self.attempt(start)
        if self.best is None:
            raise PeerError(f"{program}: no start with {start}")
        for name in numbers:
            self._along(name)
        for other in (*self._others(program), *more):
            self.attempt({**self.best.setting, **other})
        return self.best.setting

    def _along(self, name: str) -> None:
        for factor in (2.0, 0.5):
            went = False
            while (setting := scaled(self.best.setting, name, factor)) and self.attempt(setting):
                went = True
            if went:
                return

    @staticmethod
    def _others(program: str) -> Iterator[Setting]:
        yield from ({"sampler": sampler} for sampler in SAMPLERS.get(program, ()))
        yield from OTHERS.get(program, [])
