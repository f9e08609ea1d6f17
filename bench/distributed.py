"""One image and gradient by several processes: speed, what they send each other, and a model of more of them.

Processes with one thread each (--threads) share the samples of a step; rounds alternate between their numbers, the rest
waiting. Where other programs keep the machine busy, processor time says more than time: that of the slowest process of
a step, without its waiting. Beside it stands the speed of processes that share nothing: each renders its part of the
samples by itself while the others do, so that what they lose is the machine's, whose caches, memory and clock rate they
share. The model takes a step apart: what every process does by itself (a constant), samples, which are shared, and one
sum of all bytes, in a ring of 2 (n - 1) messages (Thakur, Rabenseifner and Gropp, "Optimization of Collective
Communication Operations in MPICH", 2005, section 4.4).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from typing import Any

from .arguments import counts_argument, positive
from .measured import Measured, fit_line
from .ours import chosen
from .report import ROOT, Result, Table
from .rows import ROWS, Row

NETWORK = {"ethernet, 10 Gbit/s": (50e-6, 1.1e9), "InfiniBand, 100 Gbit/s": (5e-6, 11e9)}  # seconds, bytes a second


def add_arguments(parser: argparse.ArgumentParser) -> None:
    counts_argument(parser, "--processes", [1, 2], "numbers of processes")
    counts_argument(parser, "--machines", [1, 8, 64], "numbers of machines, of the model")
    parser.add_argument("--cores", type=positive, default=16, help="threads of a machine, of the model (default 16)")
    parser.add_argument("--model-spp", type=positive, default=1024, help="samples a pixel, of the model (default 1024)")
    parser.set_defaults(threads=1, spp=64)


def measure(row: Row, options: argparse.Namespace) -> dict[str, Any]:
    """What `distributed_program` finds for one scene, run by torchrun."""
    most = max(options.processes)
    settings = {
        "row": ROWS.index(row),
        "resolution": options.resolution,
        "spp": options.spp,
        "threads": options.threads,
        "rounds": options.rounds,
        "warmup": options.warmup,
        "processes": options.processes,
        "renderer": dict(options.renderer),
    }
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(most)]
    command = [*launch, "-m", "bench.distributed_program", json.dumps(settings)]
    environment = {**os.environ, "OMP_NUM_THREADS": str(options.threads)}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    if done.returncode:
        raise SystemExit(f"the processes ended with status {done.returncode}:\n{done.stderr.strip()[-4000:]}")
    return json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))


def speed_rows(row: Row, found: dict[str, Any], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row of the table for each number of processes."""
    steps = {int(n): step for n, step in found["steps"].items()}
    first = min(steps)
    rows = []
    for n, step in steps.items():

        def speed(name: str, of: str, step: dict[str, Any] = step) -> float:
            return Measured.of(steps[first][of]).median / Measured.of(step[name]).median

        rows.append(
            {
                "scene": row.name,
                "processes": n,
                "step s": Measured.of(step["time"]),
                "processor time of the slowest s": Measured.of(step["processor time"]),
                f"speed / {first}, by time": speed("time", "time"),
                f"speed / {first}, by processor time": speed("processor time", "processor time"),
                "sharing nothing, by time": speed("time apart", "time"),
                "sharing nothing, by processor time": speed("processor time apart", "processor time"),
                "bytes a process sends a step": step["bytes"],
                "collective operations": step["collectives"],
            }
        )
    return rows


def model_rows(row: Row, found: dict[str, Any], options: argparse.Namespace) -> list[dict[str, Any]]:
    """Seconds of a step on several machines, of what was measured here and of what networks do."""
    fixed, slope = fit_line(*zip(*found["samples"], strict=True))
    sent = found["steps"][str(max(options.processes))]["bytes"]
    rows = []
    for name, (latency, bandwidth) in NETWORK.items():
        alone = None
        for n in options.machines:
            computing = max(0.0, fixed) + slope * options.model_spp / options.cores / n
            sending = 2 * (n - 1) * (latency + sent / n / bandwidth)
            alone = alone or computing + sending
            rows.append(
                {
                    "scene": row.name,
                    "network": name,
                    "machines": n,
                    "samples s": slope * options.model_spp / options.cores / n,
                    "by each alone s": max(0.0, fixed),
                    "sums s": sending,
                    "step s": computing + sending,
                    f"speed / {options.machines[0]}": alone / (computing + sending),
                }
            )
    return rows


def run(options: argparse.Namespace) -> Result:
    if len(options.processes) < 2:
        raise SystemExit("--processes: two numbers or more are compared")
    found = {row.name: measure(row, options) for row in chosen(options)}
    by_name = {row.name: row for row in ROWS}
    speed = [line for name, each in found.items() for line in speed_rows(by_name[name], each, options)]
    model = [line for name, each in found.items() for line in model_rows(by_name[name], each, options)]
    sums = [
        {"processes": max(options.processes), "bytes": size, "sum ms": Measured.of(1e3 * s for s in seconds)}
        for size, seconds in next(iter(found.values()))["sums"]
    ]
    pixels = f"{options.resolution}x{options.resolution}"
    titles = (
        f"A step, image and gradient, {pixels}, {options.spp} spp, {options.threads} threads a process",
        "Sums over the processes of this machine",
        f"A model: {pixels}, {options.model_spp} spp, {options.cores} threads a machine",
    )
    notes = [
        f"{name}: {1e6 * latency:g} us a message, {bandwidth / 1e9:g} GB/s (assumed)"
        for name, (latency, bandwidth) in NETWORK.items()
    ]
    tables = [
        Table(titles[0], ["scene", "processes"], speed, part="speed"),
        Table(titles[1], ["processes", "bytes"], sums, part="sums"),
        Table(titles[2], ["scene", "network", "machines"], model, notes, part="model"),
    ]
    return Result(tables)
