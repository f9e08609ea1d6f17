"""Checkpoints of long optimisations: a run that was ended, even killed, goes on where it was and finds the same."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import torch


class Checkpoint:
    """A file with everything that the next iteration depends on.

    Args:
        path: the file, which need not exist.
        settings: numbers that decide what the run finds; a checkpoint of other settings is refused.
        restart: ignore a file that is there.
    """

    def __init__(self, path: Path, settings: dict[str, Any], restart: bool = False) -> None:
        self.path, self.settings = path, settings
        if restart:
            path.unlink(missing_ok=True)

    def load(self) -> dict[str, Any] | None:
        """What was saved last, or None without a file. ValueError names the settings that are different there."""
        if not self.path.exists():
            return None
        # only tensors, numbers and containers of them: a checkpoint cannot run code
        stored = torch.load(self.path, weights_only=True)
        theirs = stored.pop("settings")
        names = sorted(theirs.keys() | self.settings.keys())
        other = [name for name in names if theirs.get(name) != self.settings.get(name)]
        if other:
            told = ", ".join(f"{name} {theirs.get(name)} (now {self.settings.get(name)})" for name in other)
            raise ValueError(f"{self.path} is a checkpoint of a run with {told}; --restart begins anew")
        return stored

    def restore(
        self,
        state: dict[str, Any],
        iterations: int,
        optimiser: torch.optim.Optimizer,
        generator: torch.Generator | None = None,
    ) -> tuple[dict[str, list[float]], int]:
        """Give the optimiser and all chance back what they had; returns the curves and the iteration that is next."""
        optimiser.load_state_dict(state["optimiser"])
        if generator is not None:
            generator.set_state(state["random"])
        print(f"going on from iteration {state['iteration']} of {iterations} ({self.path})")
        return state["curves"], state["iteration"]

    def save(self, **state: Any) -> None:
        """Write tensors, numbers and state dicts.

        The file is written beside the old one and takes its place when it is complete, so that a process that is killed
        while it writes leaves the old one behind.
        """
        partial = self.path.with_suffix(".partial")
        torch.save({"settings": self.settings, **state}, partial)
        os.replace(partial, self.path)
