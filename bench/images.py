"""Time of images without derivatives of the five scenes, in rounds in which every program runs once.

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's (default %(default)s)")
    peer_argument(parser)


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of a row and ratios of them."""
    ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))
    programs: dict[str, Callable[[int], dict[str, float]]] = {"": ours.forward}
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp)
        programs[peer.title] = lambda seed, peer=peer: peer.ask("forward", seed=seed)
    found = {who: Measured.of(times["forward"]) for who, times in rounds(programs, options).items()}
    seconds: dict[str, Any] = {f"{who} image s".strip(): measured for who, measured in found.items()}
    ratios = {f"{peer.title} / ours": found[peer.title].median / found[""].median for peer in peers}
    return {"scene": row.name, **seconds, **ratios}


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
    plot = {"kind": "bars", "columns": [name for name in table[0] if name.endswith(" s")], "y": "an image, s"}
    return Result([Table(title, ["scene"], table, [], plot)], versions)
