"""Peak memory of forward and backward passes, beyond the gradients and one gradient buffer a thread."""

from __future__ import annotations

import argparse
from typing import Any

from .arguments import counts_argument
from .fresh import measure
from .measured import Measured
from .ours import chosen
from .report import Result, Table
from .rows import ROWS, Row

STEPS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    counts_argument(parser, "--samples", [1, 16, 128], "samples a pixel")
    parser.set_defaults(rounds=3, warmup=0)


def measure_row(row: Row, spp: int, options: argparse.Namespace) -> dict[str, Any]:
    settings = {"row": ROWS.index(row), "threads": options.threads, "resolution": options.resolution}
    runs = [measure("memory", spp=spp, steps=STEPS, **settings) for _ in range(options.rounds)]
    gradients = runs[0]["gradients"]
    buffers = gradients * (1 + options.threads)
    return {
        "scene": row.name,
        "spp": spp,
        "peak above the loaded scene MiB": Measured.of(run["peak"] for run in runs),
        "of that, the scene in the core MiB": Measured.of(run["scene"] for run in runs),
        "gradients and a buffer a thread": buffers,
        "beyond these MiB": Measured.of(max(0.0, run["peak"] - buffers) for run in runs),
        "beyond these and the scene MiB": Measured.of(max(0.0, run["peak"] - run["scene"] - buffers) for run in runs),
    }


def run(options: argparse.Namespace) -> Result:
    rows = [measure_row(row, spp, options) for row in chosen(options) for spp in options.samples]
    title = (
        f"Peak memory of {STEPS} steps in fresh processes, MiB, {options.resolution}x{options.resolution}, "
        f"{options.threads} threads, medians of {options.rounds} processes"
    )
    notes = ["The scene is loaded before; the image, its copies in autograd and the acceleration structure count."]
    plot = {"kind": "lines", "x": "spp", "columns": ["beyond these MiB"], "by": "scene", "y": "MiB"}
    return Result([Table(title, ["scene", "spp"], rows, notes, plot)])
