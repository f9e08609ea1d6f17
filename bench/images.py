"""Time of images of the five scenes, and of them with gradients, in rounds in which every program runs once.

On a card with TORCHRENDER_BACKEND=cuda and, for Mitsuba beside it, --variant cuda_ad_rgb.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import torch

from torchrender import backends

from .arguments import peer_argument
from .measured import Measured, rounds
from .ours import Ours, chosen
from .peers import Peer, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer

Program = Callable[[int], dict[str, float]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--gradients", action="store_true", help="also forward and backward passes")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's (default %(default)s)")
    peer_argument(parser)


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of a row and ratios of them."""
    ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))
    programs = {"": _timed(ours.forward, ours.step, options.gradients)}
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp)
        forward, step = (lambda seed, peer=peer, what=what: peer.ask(what, seed=seed) for what in ("forward", "step"))
        programs[peer.title] = _timed(forward, step, options.gradients)
    found = rounds(programs, options)
    seconds: dict[str, Any] = {}
    ratios: dict[str, float] = {}
    for what in found[""]:
        measured = {who: Measured.of(times[what]) for who, times in found.items()}
        seconds |= {f"{who} {what} s".strip(): value for who, value in measured.items()}
        ratios |= {f"{p.title} / ours, {what}": measured[p.title].median / measured[""].median for p in peers}
    return {"scene": row.name, **seconds, **ratios}


def _timed(forward: Program, step: Program, gradients: bool) -> Program:
    """Seconds of an image and, if wanted, of a forward and a backward pass."""

    def run(seed: int) -> dict[str, float]:
        return {"image": forward(seed)["forward"], **({"sum": sum(step(seed).values())} if gradients else {})}

    return run


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    environment = {"MITSUBA_VARIANT": options.variant}
    with Peers(options.peer, options.threads, options.renderer, environment) as peers:
        table = [measure_row(row, peers, options) for row in chosen(options)]
        versions = {peer.key: peer.version for peer in peers}
    title = (
        f"{options.resolution}x{options.resolution}, {options.spp} spp, depth 5, backend {backends.device()}, "
        f"Mitsuba's variant {options.variant}, medians of {options.rounds} alternating rounds"
    )
    plot = {"kind": "bars", "columns": [name for name in table[0] if name.endswith(" s")], "y": "s"}
    return Result([Table(title, ["scene"], table, [], plot)], versions)
