"""From a fresh process to the first gradient, torch imported before; peers beside, with and without kept kernels.

A peer's time begins with importing it, as ours does. Mitsuba keeps the kernels that it has compiled under the home
folder: one column is of a home without any, the other of one that has those of this very scene.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from typing import Any

from .arguments import peer_argument
from .fresh import measure
from .measured import Measured, rounds
from .ours import chosen
from .peers import KNOWN, Peer
from .report import Result, Table
from .rows import ROWS, Row
from .scene_arrays import load_peer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.set_defaults(rounds=5, warmup=1)


def peer_start(chosen_peer: tuple[str, str], row: Row, home: str, options: argparse.Namespace) -> tuple[Peer, float]:
    """A peer that has made its first gradient, and the seconds from importing it until then."""
    peer = Peer(*chosen_peer, options.threads, {"HOME": home}, dict(options.renderer))
    try:
        start = time.perf_counter()
        load_peer(peer, row, options.resolution, options.spp)
        peer.ask("step", seed=0)
        return peer, peer.import_seconds + time.perf_counter() - start
    finally:
        peer.close()


def measure_row(row: Row, options: argparse.Namespace, versions: dict[str, str]) -> dict[str, Any]:
    """Seconds of every program; the versions of peers are added to `versions`."""
    settings = {"row": ROWS.index(row), "threads": options.threads}
    settings |= {"resolution": options.resolution, "spp": options.spp, "renderer": dict(options.renderer)}
    programs: dict[str, Any] = {"": lambda _: measure("coldstart", **settings)}
    for asked in options.peer:

        def start(_: int, asked: tuple[str, str] = asked) -> dict[str, float]:
            with tempfile.TemporaryDirectory() as home:
                peer, first = peer_start(asked, row, home, options)
                versions[peer.key] = peer.version
                if not KNOWN[peer.name].keeps_kernels:
                    return {"total": first}
                return {"total": first, "total, kernels kept": peer_start(asked, row, home, options)[1]}

        programs[KNOWN[asked[0]].title] = start
    found = rounds(programs, options)
    mine = {name: Measured.of(values) for name, values in found.pop("").items()}
    result: dict[str, Any] = {"scene": row.name, **{f"{name} s": value for name, value in mine.items()}}
    for title, times in found.items():
        for name, values in times.items():
            result[f"{title} {name} s"] = Measured.of(values)
            result[f"ours / {title} {name}"] = mine["total"].median / Measured.of(values).median
    return result


def run(options: argparse.Namespace) -> Result:
    versions: dict[str, str] = {}
    rows = [measure_row(row, options, versions) for row in chosen(options)]
    title = (
        f"From a fresh process to the first gradient, {options.resolution}x{options.resolution}, {options.spp} spp, "
        f"{options.threads} threads, medians of {options.rounds} alternating processes"
    )
    columns = [name for name in rows[0] if name.endswith("total s")]
    return Result([Table(title, ["scene"], rows, [], {"kind": "bars", "columns": columns, "y": "s"})], versions)
