"""The spectral variant beside rgb, and beside Mitsuba's: time of images and gradients, and time to equal noise.

The first tables have the scenes of `table2` in both variants and, with ``--peer mitsuba=PYTHON``, in
``llvm_ad_spectral``, at equal samples. Mitsuba's gradients there are those of coefficients of spectra, ours of colours.

The last table has simple scenes, lit evenly by daylight or by a lamp with lines. Variances are those of single values
of the image, over all rounds, relative to the squared mean; times the seconds of an image they are the time to a given
error.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .arguments import peer_argument
from .measured import Measured, rounds
from .ours import Ours, chosen
from .peers import Peer, PeerError, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer
from .spectral_noise import noise_rows

PARTS = ("time", "noise", "all")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument("--part", choices=PARTS, default="all", help="which tables (default %(default)s)")


def as_colours(row: Row) -> Row:
    """A row whose texels stand for spectra: raw ones are none in Mitsuba."""
    return replace(row, arguments={**row.arguments, "raw": "false"}) if "texture" in row.arguments else row


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """Seconds of a row, and ratios of their medians."""
    settings = dict(options.renderer)
    programs = {}
    for variant in ("rgb", "spectral"):
        ours = Ours.of_row(row, options.resolution, options.spp, variant=variant, **settings)

        def run_ours(seed: int, ours: Ours = ours) -> dict[str, float]:
            ours.forward(seed)  # what ran before has emptied the caches
            return {"image": ours.forward(seed)["forward"], **ours.step(seed)}

        programs[variant] = run_ours
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp, variant="llvm_ad_spectral")

        def run(seed: int, peer: Peer = peer) -> dict[str, float]:
            peer.ask("forward", seed=seed)
            return {"image": peer.ask("forward", seed=seed)["forward"], **peer.ask("step", seed=seed)}

        programs[peer.title] = run
    seconds: dict[str, Any] = {"scene": row.name}
    medians: dict[str, dict[str, float]] = {}
    for who, times in rounds(programs, options).items():
        times["sum"] = [a + b for a, b in zip(times["forward"], times["backward"], strict=True)]
        measured = {name: Measured.of(values) for name, values in times.items()}
        medians[who] = {name: value.median for name, value in measured.items()}
        for name, column in (("image", "image"), ("backward", "gradient"), ("sum", "both")):
            seconds[f"{who} {column} s"] = measured[name]
    ratios: dict[str, Any] = {"scene": row.name}
    ratios["spectral image / rgb"] = medians["spectral"]["image"] / medians["rgb"]["image"]
    ratios["spectral gradient / rgb"] = medians["spectral"]["backward"] / medians["rgb"]["backward"]
    for peer in peers:
        ratios[f"{peer.title} image / spectral"] = medians[peer.title]["image"] / medians["spectral"]["image"]
        ratios[f"{peer.title} both / spectral"] = medians[peer.title]["sum"] / medians["spectral"]["sum"]
    return seconds, ratios


def relative_variance(images: Sequence[np.ndarray]) -> float:
    """The mean variance of the values of independent images, over the squared mean."""
    stack = np.stack(images).astype(np.float64)
    return float(stack.var(0, ddof=1).mean() / stack.mean() ** 2)


def measure_noise(row: Row, peers: list[Peer], options: argparse.Namespace) -> dict[str, Any]:
    """Time and variance of a scene's images."""
    ours = Ours.of_row(row, options.resolution, options.spp, variant="spectral", **dict(options.renderer))
    images: dict[str, list[np.ndarray]] = {"spectral": [], **{peer.title: [] for peer in peers}}
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:

        def run_ours(seed: int) -> dict[str, float]:
            image, seconds = ours.image(seed, options.spp)
            images["spectral"].append(image)
            return {"image": seconds}

        programs = {"spectral": run_ours}
        for peer in peers:
            load_peer(peer, row, options.resolution, options.spp, variant="llvm_ad_spectral")

            def run(seed: int, peer: Peer = peer) -> dict[str, float]:
                file = Path(folder) / "image.npy"
                seconds = peer.ask("image", seed=seed, spp=options.spp, file=str(file))["seconds"]
                images[peer.title].append(np.load(file)[..., :3])
                return {"image": seconds}

            programs[peer.title] = run
        found = rounds(programs, options)
    result: dict[str, Any] = {"scene": row.name}
    costs = {}
    for who, times in found.items():
        seconds, variance = Measured.of(times["image"]), relative_variance(images[who])
        result[f"{who} image s"], result[f"{who} variance"] = seconds, variance
        costs[who] = seconds.median * variance
    for peer in peers:
        means = [np.mean([image.mean((0, 1)) for image in images[who]], axis=0) for who in (peer.title, "spectral")]
        result[f"{peer.title} mean / spectral"] = float(means[0].sum() / means[1].sum())
        result[f"{peer.title} time to equal error / spectral"] = costs[peer.title] / costs["spectral"]
    return result


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    strangers = [name for name, _ in options.peer if name != "mitsuba"]
    if strangers:
        raise PeerError(f"--peer: {strangers[0]} has no spectral variant that is known here; mitsuba has")
    if options.rounds < 2:
        raise SystemExit("--rounds: variances need two rounds or more")
    tables: list[Table] = []
    size = f"{options.resolution}x{options.resolution}, {options.spp} spp, {options.threads} threads"
    with Peers(options.peer, options.threads, options.renderer) as peers:
        if options.part != "noise":
            measured = [measure_row(as_colours(row), peers, options) for row in chosen(options)]
            title = f"{size}, depth 5, medians of {options.rounds} alternating rounds"
            notes = ["Image: without derivatives. Gradient: backward alone. Both: forward and backward."]
            tables.append(Table(title, ["scene"], [seconds for seconds, _ in measured], notes, part="time"))
            tables.append(Table("Ratios of the medians", ["scene"], [ratios for _, ratios in measured], part="ratios"))
        if options.part != "time":
            with noise_rows() as rows:
                wanted = [row for row in rows if options.part == "noise" or not options.only]
                noise = [measure_noise(row, peers, options) for row in wanted]
            if noise:
                tables.append(
                    Table(f"Variance of images, {size}, {options.rounds} rounds", ["scene"], noise, part="noise")
                )
        versions = {peer.key: peer.version for peer in peers}
    return Result(tables, versions)
