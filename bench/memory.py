"""Peak memory of forward and backward passes, beyond the gradients and one gradient buffer a thread."""

from __future__ import annotations

import argparse
from typing import Any

from .arguments import counts_argument, peer_argument
from .fresh import measure
from .measured import Measured
from .ours import chosen
from .peers import KNOWN, Peer
from .report import Result, Table
from .rows import ALL_ROWS, Row
from .scene_arrays import load_peer

STEPS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    counts_argument(parser, "--samples", [1, 16, 128], "samples a pixel, in place of --spp")
    peer_argument(parser)
    parser.set_defaults(rounds=3, warmup=0)


def our_memory(row: Row, spp: int, options: argparse.Namespace, **more: Any) -> dict[str, float]:
    """MiB in a fresh process, see `fresh.peak_memory`; `more` are further settings of `Ours`."""
    settings = {"row": ALL_ROWS.index(row), "threads": options.threads, "resolution": options.resolution}
    return measure("memory", spp=spp, steps=STEPS, renderer={**dict(options.renderer), **more}, **settings)


def peer_memory(
    asked: tuple[str, str], row: Row, spp: int, options: argparse.Namespace, versions: dict, **loading: Any
) -> float:
    """MiB that the steps of a peer add, at their peak, to its process with the scene loaded."""
    peer = Peer(*asked, options.threads, settings=dict(options.renderer))
    try:
        versions[peer.key] = peer.version
        load_peer(peer, row, options.resolution, spp, **loading)
        before = peer.ask("settle")["memory"]
        for seed in range(STEPS):
            peer.ask("step", seed=seed)
        return max(0.0, peer.ask("memory")["peak"] - before)
    finally:
        peer.close()


def measure_row(row: Row, spp: int, options: argparse.Namespace, versions: dict) -> dict[str, Any]:
    """Memory of all programs for one scene; the versions of peers are added to `versions`."""
    runs = [our_memory(row, spp, options) for _ in range(options.rounds)]
    gradients = runs[0]["gradients"]
    buffers = gradients * (1 + options.threads)
    result = {
        "scene": row.name,
        "spp": spp,
        "peak above the loaded scene MiB": Measured.of(run["peak"] for run in runs),
        "of that, the scene in the core MiB": Measured.of(run["scene"] for run in runs),
        "gradients and a buffer a thread MiB": buffers,
        "beyond these MiB": Measured.of(max(0.0, run["peak"] - buffers) for run in runs),
        "beyond these and the scene MiB": Measured.of(max(0.0, run["peak"] - run["scene"] - buffers) for run in runs),
    }
    for asked in options.peer:
        peaks = [peer_memory(asked, row, spp, options, versions) for _ in range(options.rounds)]
        result[f"{KNOWN[asked[0]].title} peak above the loaded scene MiB"] = Measured.of(peaks)
    return result


def run(options: argparse.Namespace) -> Result:
    versions: dict[str, str] = {}
    rows = [measure_row(row, spp, options, versions) for row in chosen(options) for spp in options.samples]
    title = (
        f"Peak memory of {STEPS} steps in fresh processes, MiB, {options.resolution}x{options.resolution}, "
        f"{options.threads} threads, medians of {options.rounds} processes"
    )
    notes = ["The scene is loaded before; the image, its copies in autograd and the acceleration structure count."]
    plot = {"kind": "lines", "x": "spp", "columns": ["beyond these MiB"], "by": ["scene"], "y": "MiB"}
    return Result([Table(title, ["scene", "spp"], rows, notes, plot)], versions)
