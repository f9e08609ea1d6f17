"""What a call costs besides rendering: packing, checks, dispatch, autograd, and looking for what changed.

An image of one pixel with one sample, so that hardly anything else is left; the core's own rendering time, which it
measures itself, is taken off. The backward pass also allocates the gradients.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import torch

from .ours import Ours
from .rows import ROWS

COLUMNS = ["scene", "forward ms", "forward + backward ms", "with a changed parameter ms"]


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


def overhead_row(index: int, options: argparse.Namespace) -> dict:
    ours = Ours(ROWS[index], 1, 1)
    result: dict = {"scene": ROWS[index].name}
    for changing in (False, True):
        # Calls of a millisecond: many of them take no time.
        runs = [overhead(ours, changing) for _ in range(20 * (options.warmup + options.rounds))][20 * options.warmup :]
        both = median(sum(run) for run in runs)
        if changing:
            result["with a changed parameter ms"] = both
        else:
            result["forward ms"] = median(run[0] for run in runs)
            result["forward + backward ms"] = both
    return result


def run_overhead(options: argparse.Namespace) -> dict:
    torch.set_num_threads(options.threads)
    rows = [overhead_row(index, options) for index, row in enumerate(ROWS) if options.only in row.name]
    title = f"A call besides rendering: 1x1, 1 spp, {options.threads} threads, median of {20 * options.rounds} calls"
    return {"title": title, "columns": COLUMNS, "rows": rows}
