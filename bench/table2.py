"""Forward and backward time of the five scenes, in rounds in which every program runs once."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import torch

from torchrender.scene.film import FILTERS

from .arguments import peer_argument
from .embree_alone import Pair
from .measured import Measured, rounds
from .ours import Ours, chosen
from .peers import KNOWN, Peer, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument(
        "--filter", choices=FILTERS, default="box", help="the scenes' reconstruction filter (default %(default)s)"
    )


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Seconds of a row, ratios of them, and what is noted about its rays."""

    ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))
    alone = Pair(ours, options.threads)

    def run_ours(seed: int) -> dict[str, float]:
        ours.forward(seed)  # what ran before has emptied the caches
        return {"image": ours.forward(seed)["forward"], **ours.step(seed)}

    programs = {"": run_ours, "Embree": alone.round}
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp)

        def run(seed: int, peer: Peer = peer) -> dict[str, float]:
            peer.ask("forward", seed=seed)
            return {"image": peer.ask("forward", seed=seed)["forward"], **peer.ask("step", seed=seed)}

        programs[peer.title] = run
    found = rounds(programs, options)
    seconds: dict[str, Any] = {"scene": row.name}
    medians: dict[str, dict[str, float]] = {}
    for who, times in found.items():
        if who != "Embree":
            times["sum"] = [a + b for a, b in zip(times["forward"], times["backward"], strict=True)]
        measured = {name: Measured.of(values) for name, values in times.items()}
        medians[who] = {name: value.median for name, value in measured.items()}
        if who == "Embree":
            seconds["Embree alone, image s"] = measured["forward"]
            seconds["Embree alone, sum s"] = measured["sum"]
            continue
        for name, column in (("image", "image alone s"), ("forward", "forward s"), ("backward", "backward s")):
            seconds[f"{who} {column}".strip()] = measured[name]
        seconds[f"{who} sum s".strip()] = measured["sum"]
    ratios: dict[str, Any] = {"scene": row.name}
    for peer in peers:
        ratios[f"{peer.title} sum / ours"] = medians[peer.title]["sum"] / medians[""]["sum"]
        ratios[f"{peer.title} image / ours"] = medians[peer.title]["image"] / medians[""]["image"]
    ratios["our image / Embree alone"] = medians[""]["image"] / medians["Embree"]["forward"]
    ratios["our sum / Embree alone"] = medians[""]["sum"] / medians["Embree"]["sum"]
    for name, kind in (("image", "render"), ("derivative", "vjp")):
        ratios[f"lanes in use, {name}"] = ours.scene.statistics[kind]["lanes"]
    return seconds, ratios, f"Rays a query of Embree alone, {row.name}: {alone.described()}"


def run(options: argparse.Namespace) -> Result:
    for name, _ in options.peer:
        if KNOWN[name].reads_arrays and options.filter != "box":
            raise SystemExit(f"--filter: {KNOWN[name].title} has box filters alone, got {options.filter}")
    rows = [replace(row, arguments={**row.arguments, "rfilter": options.filter}) for row in chosen(options)]
    torch.set_num_threads(options.threads)
    with Peers(options.peer, options.threads, options.renderer) as peers:
        measured = [measure_row(row, peers, options) for row in rows]
        versions = {peer.key: peer.version for peer in peers}
        who = [""] + [f"{peer.title} " for peer in peers]
    title = (
        f"{options.resolution}x{options.resolution}, {options.spp} spp, depth 5, {options.filter} filter, "
        f"{options.threads} threads, medians of {options.rounds} alternating rounds"
    )
    notes = [
        "Image alone: without derivatives (torch.no_grad). Sum: forward and backward.",
        *(note for _, _, note in measured),
    ]
    columns = [f"{name}sum s" for name in who] + ["Embree alone, sum s"]
    plot = {"kind": "bars", "columns": columns, "y": "forward and backward, s"}
    return Result(
        [
            Table(title, ["scene"], [seconds for seconds, _, _ in measured], notes, plot),
            Table(
                "Ratios of these medians, and the share of packet lanes that shading uses",
                ["scene"],
                [ratios for _, ratios, _ in measured],
            ),
        ],
        versions,
    )
