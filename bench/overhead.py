"""What a call costs besides rendering: packing, checks, dispatch, autograd, and looking for what changed.

An image of one pixel with one sample, so that hardly anything else is left; the core's own rendering time, which it
measures itself, is taken off. The backward pass also allocates the gradients.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import torch

from .measured import Measured
from .ours import Ours, chosen
from .report import Result, Table
from .rows import Row

CALLS = 20  # of a round: they take a millisecond


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Nothing besides the common options; resolution and spp are 1."""


def overhead(ours: Ours, changing: bool) -> tuple[float, float]:
    """Milliseconds of one forward and one backward pass without the core's rendering."""
    if changing:
        with torch.no_grad():
            for parameter in ours.parameters:
                parameter.mul_(1)
    start = time.perf_counter()
    image = ours.renderer(seed=1)
    middle = time.perf_counter()
    loss = image.sum()
    begin = time.perf_counter()
    torch.autograd.grad(loss, ours.parameters)
    end = time.perf_counter()
    rendering = [ours.scene.statistics[kind]["seconds"] for kind in ("render", "vjp")]
    return 1e3 * (middle - start - rendering[0]), 1e3 * (end - begin - rendering[1])


def overhead_row(row: Row, options: argparse.Namespace) -> dict[str, Any]:
    ours = Ours.of_row(row, 1, 1, **dict(options.renderer))
    result: dict[str, Any] = {"scene": row.name}
    for changing in (False, True):
        runs = [overhead(ours, changing) for _ in range(CALLS * (options.warmup + options.rounds))]
        runs = runs[CALLS * options.warmup :]
        both = Measured.of(forward + backward for forward, backward in runs)
        if changing:
            result["with a changed parameter ms"] = both
        else:
            result["forward ms"] = Measured.of(forward for forward, _ in runs)
            result["forward + backward ms"] = both
    return result


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    rows = [overhead_row(row, options) for row in chosen(options)]
    title = (
        f"A call besides rendering: 1x1, 1 spp, {options.threads} threads, medians of {CALLS * options.rounds} calls"
    )
    columns = ["forward ms", "forward + backward ms", "with a changed parameter ms"]
    return Result([Table(title, ["scene"], rows, [], {"kind": "bars", "columns": columns, "y": "ms"})])
