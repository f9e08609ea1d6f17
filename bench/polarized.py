"""Polarised light beside intensity: images and gradients of the scenes of `table2`, their time and their memory.

Nothing polarises in those, so that their Stokes vectors are their images; a scene whose surfaces polarise is added.

Polarised images are those of the variants ``rgb_polarized`` and ``mono_polarized``, whose Stokes vectors are rendered
whole; the loss is of their intensity. With ``--peer mitsuba=PYTHON`` those of ``llvm_ad_mono_polarized`` stand beside
those of ``mono_polarized``: by the integrator `stokes` over `path`, which Dr.Jit differentiates as it stands, with all
that its loop has computed in memory (Mitsuba's adjoint integrators have no polarised light); the loss is of all
components.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch

from .arguments import counts_argument, peer_argument
from .measured import Measured, rounds
from .memory import our_memory, peer_memory
from .ours import Ours, chosen
from .peers import KNOWN, Peer, PeerError, Peers
from .report import Result, Table
from .rows import ALL_ROWS, Row
from .scene_arrays import load_peer

VARIANTS = ("rgb", "rgb_polarized", "mono_polarized")
PARTS = ("time", "memory", "all")
# what a peer loads
POLARIZED = {
    "variant": "llvm_ad_mono_polarized",
    "integrator": {"type": "stokes", "nested": {"type": "path", "max_depth": 5, "rr_depth": 100}},
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument("--part", choices=PARTS, default="all", help="which tables (default %(default)s)")
    counts_argument(parser, "--samples", [4, 16], "samples a pixel of the table of memory")


def has_gradient(peer: Peer) -> bool:
    """Mitsuba's scenes of one colour have one by the texels of a picture in three only once."""
    try:
        for seed in range(2):
            peer.ask("step", seed=seed)
    except PeerError as error:
        if "no gradient reached" not in str(error):
            raise
        return False
    return True


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """Seconds of a row, and ratios of their medians."""
    programs = {}
    for variant in VARIANTS:
        renderer = Ours.of_row(row, options.resolution, options.spp, variant=variant, **dict(options.renderer))

        def run_ours(seed: int, ours: Ours = renderer) -> dict[str, float]:
            ours.forward(seed)  # what ran before has emptied the caches
            return {"image": ours.forward(seed)["forward"], "gradient": ours.step(seed)["backward"]}

        programs[variant] = run_ours
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp, **POLARIZED)
        differentiates = has_gradient(peer)

        def run(seed: int, peer: Peer = peer, differentiates: bool = differentiates) -> dict[str, float]:
            peer.ask("forward", seed=seed)
            times = {"image": peer.ask("forward", seed=seed)["forward"]}
            if differentiates:
                times["gradient"] = peer.ask("step", seed=seed)["backward"]
            return times

        programs[peer.title] = run
    seconds: dict[str, Any] = {"scene": row.name}
    medians: dict[str, dict[str, float]] = {}
    for who, times in rounds(programs, options).items():
        measured = {name: Measured.of(values) for name, values in times.items()}
        medians[who] = {name: value.median for name, value in measured.items()}
        seconds |= {f"{who} {name} s": value for name, value in measured.items()}
    plain, polarized = medians["rgb"], medians["rgb_polarized"]
    ratios: dict[str, Any] = {"scene": row.name}
    ratios["polarised image / rgb"] = polarized["image"] / plain["image"]
    ratios["polarised gradient / two polarised images"] = polarized["gradient"] / (2 * polarized["image"])
    ratios["polarised gradient / rgb"] = polarized["gradient"] / plain["gradient"]
    for peer in peers:
        for what, value in medians[peer.title].items():
            ratios[f"{peer.title} {what} / mono_polarized"] = value / medians["mono_polarized"][what]
    return seconds, ratios


def measure_memory(row: Row, spp: int, options: argparse.Namespace, versions: dict[str, str]) -> dict[str, Any]:
    """Peak memory of image and gradient above the loaded scene, MiB; the versions of peers are added to `versions`."""
    runs = [our_memory(row, spp, options, variant="mono_polarized")["peak"] for _ in range(options.rounds)]
    result: dict[str, Any] = {"scene": row.name, "spp": spp, "mono_polarized MiB": Measured.of(runs)}
    for asked in options.peer:
        runs = [peer_memory(asked, row, spp, options, versions, **POLARIZED) for _ in range(options.rounds)]
        result[f"{KNOWN[asked[0]].title} MiB"] = Measured.of(runs)
    return result


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    strangers = [name for name, _ in options.peer if name != "mitsuba"]
    if strangers:
        raise PeerError(f"--peer: {strangers[0]} has no polarised variant that is known here; mitsuba has")
    size = f"{options.resolution}x{options.resolution}, {options.threads} threads"
    tables, versions = [], {}
    if options.part != "memory":
        with Peers(options.peer, options.threads, options.renderer) as peers:
            measured = [measure_row(row, peers, options) for row in chosen(options, ALL_ROWS)]
            versions = {peer.key: peer.version for peer in peers}
        title = f"{size}, {options.spp} spp, depth 5, medians of {options.rounds} alternating rounds"
        notes = ["Image: without derivatives. Gradient: backward alone."]
        tables.append(Table(title, ["scene"], [seconds for seconds, _ in measured], notes, part="time"))
        tables.append(Table("Ratios of the medians", ["scene"], [ratios for _, ratios in measured], part="ratios"))
    if options.part != "time":
        rows = [
            measure_memory(row, spp, options, versions) for row in chosen(options, ALL_ROWS) for spp in options.samples
        ]
        title = f"Peak memory above the loaded scene, {size}, medians of {options.rounds} fresh processes"
        tables.append(Table(title, ["scene", "spp"], rows, part="memory"))
    return Result(tables, versions)
