"""Ctrl-C during a rendering: nothing comes back, or a picture of the samples that are done."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

from .errors import InterruptionWarning, depth_outside, describe

MODES = ("raise", "return")
PART = 1 << 20
"""Paths that a part of a pass has at least: a tenth of a second of work, or some seconds in difficult scenes."""


@dataclass
class Interruption:
    """What one call of `render` does when it is interrupted, and how many of its samples it has then.

    Attributes:
        returns: whether what is done comes back.
        happened: Ctrl-C was pressed; what is left then does the least that gives a picture.
        done, wanted: samples of a pixel, of all views that were begun together.
    """

    returns: bool
    happened: bool = False
    done: int = 0
    wanted: int = 0

    def count(self, done: int, wanted: int) -> None:
        """Count the samples of one more view."""
        self.done += done
        self.wanted += wanted

    def warn(self) -> None:
        """Say what the picture has of its samples, if it was interrupted."""
        if not self.happened:
            return
        share = f"{self.done} of {self.wanted} samples a pixel ({self.done / self.wanted:.3%})"
        warnings.warn(
            f"the rendering was interrupted: the picture has {share}", InterruptionWarning, stacklevel=depth_outside()
        )


def interruption_of(mode: Any) -> Interruption:
    """For the argument `on_interrupt` of `render`; itself, if views share one."""
    if isinstance(mode, Interruption):
        return mode
    if mode not in MODES:
        raise ValueError(f"render: on_interrupt: expected 'raise' or 'return', got {describe(mode)}")
    return Interruption(mode == "return")


def part_ends(spp: int, pixels: int) -> list[int]:
    """Numbers of samples a pixel after which a pass of `spp` samples has a picture, the last being `spp`.

    A part has `PART` paths or an eighth of the samples before it, so that little is lost, and little time is spent on
    beginning anew. It depends on nothing but numbers of samples and pixels: the same seed gives the same image.
    """
    least = max(1, PART // max(1, pixels))
    ends = [0]
    while ends[-1] < spp:
        size = max(least, ends[-1] // 8)
        size -= size % 64 if size > 64 else 0  # the core sums up 64 samples of a pixel at a time
        ends.append(min(spp, ends[-1] + size))
    return ends[1:]
