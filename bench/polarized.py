"""Polarised light beside intensity: time of images and gradients of the scenes of `table2`, and of Mitsuba's images.

Polarised images are those of the variants ``rgb_polarized`` and ``mono_polarized``, whose Stokes vectors are rendered
whole; the loss is of their intensity. With ``--peer mitsuba=PYTHON`` the image of ``llvm_ad_mono_polarized`` is timed
beside that of ``mono_polarized``, by the integrator `path`; its adjoint integrators have no polarised light.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch

from .arguments import peer_argument
from .measured import Measured, rounds
from .ours import Ours, chosen
from .peers import Peer, PeerError, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer

VARIANTS = ("rgb", "rgb_polarized", "mono_polarized")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)


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
        load_peer(peer, row, options.resolution, options.spp, variant="llvm_ad_mono_polarized")

        def run(seed: int, peer: Peer = peer) -> dict[str, float]:
            peer.ask("forward", seed=seed)
            return {"image": peer.ask("forward", seed=seed)["forward"]}

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
        ratios[f"{peer.title} image / mono_polarized"] = (
            medians[peer.title]["image"] / medians["mono_polarized"]["image"]
        )
    return seconds, ratios


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    strangers = [name for name, _ in options.peer if name != "mitsuba"]
    if strangers:
        raise PeerError(f"--peer: {strangers[0]} has no polarised variant that is known here; mitsuba has")
    with Peers(options.peer, options.threads, options.renderer) as peers:
        measured = [measure_row(row, peers, options) for row in chosen(options)]
        versions = {peer.key: peer.version for peer in peers}
    size = f"{options.resolution}x{options.resolution}, {options.spp} spp, {options.threads} threads"
    title = f"{size}, depth 5, medians of {options.rounds} alternating rounds"
    tables = [
        Table(title, ["scene"], [seconds for seconds, _ in measured], part="time"),
        Table("Ratios of the medians", ["scene"], [ratios for _, ratios in measured], part="ratios"),
    ]
    return Result(tables, versions)
