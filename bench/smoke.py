"""Smoke: seconds of one full-size iteration, and what a reconstruction finds in a given time.

Full size: 128^3 densities, nine pictures of 128 x 128 pixels, 8 passes of 64 + 16 samples a pixel. `--spp` is the
number of the pictures' samples in a pass. A peer's iteration is measured in one pass and multiplied, but that of
another state of torchrender in all of them. The reconstruction is the same optimisation for all programs
(`reconstruction.py`), each with its own gradients, for `--seconds` of its own time; this renderer renders its result
from a place that no picture was taken from.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch

from scenes import make_media

from .arguments import natural, peer_argument, positive
from .measured import rounds
from .media import SMOKE, Loaded, iteration, iteration_table, media_arguments
from .peers import Peer, Peers
from .reconstruction import Recipe, gradient_of_ours, gradient_of_peer, psnr, reconstruct
from .report import Result, Table

VIEWS = list(range(make_media.VIEWS))
TARGET_SEED = 1 << 40  # far from the iterations'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    media_arguments(parser, spp_grad=16, passes=8)
    parser.add_argument("--size", type=positive, default=128, help="voxels along a side (default %(default)s)")
    parser.add_argument(
        "--seconds", type=natural, default=300, help="of a reconstruction; 0: none (default %(default)s)"
    )
    parser.add_argument(
        "--target", type=positive, default=1024, help="samples of the given pictures (default %(default)s)"
    )
    parser.set_defaults(resolution=128, spp=64, rounds=1, warmup=0)


def iterations(loaded: Loaded, peers: list[Peer], options: argparse.Namespace) -> Table:
    """Seconds of one iteration of all programs."""
    ours = loaded.ours(options, options.spp, spp_grad=options.spp_grad, passes=options.passes)
    programs = {"ours": lambda seed: iteration(ours, seed, sensor=VIEWS)}
    counts = {"views": VIEWS, "spp": options.spp, "spp_grad": options.spp_grad}
    for peer in peers:
        loaded.load_peer(peer, options, options.spp)

        def run(seed: int, peer: Peer = peer) -> dict[str, float]:
            passes = options.passes if peer.ourselves else 1
            found = peer.ask("iteration", seed=seed, passes=passes, **counts)
            return {name: value * options.passes / passes for name, value in found.items()}

        programs[peer.title] = run
    found = rounds(programs, options)
    title = (
        f"One iteration, {len(VIEWS)} views of {options.resolution}x{options.resolution}, {options.passes} passes of "
        f"{options.spp} + {options.spp_grad} spp, {options.threads} threads, medians of {options.rounds} rounds"
    )
    others = [peer.title for peer in peers if not peer.ourselves]
    notes = [f"{', '.join(others)}: one pass, times {options.passes}."] if others and options.passes > 1 else []
    return iteration_table(found, f"smoke, {options.size}^3 densities", title, notes)


def reconstructions(loaded: Loaded, peers: list[Peer], options: argparse.Namespace) -> Table:
    """What all programs find in the same time."""
    ours = loaded.ours(options, 16)
    held_back = len(VIEWS)
    passes = max(1, options.target // 64)
    with torch.no_grad():
        targets = [
            ours.renderer(sensor=view, seed=TARGET_SEED, spp=min(options.target, 64), passes=passes)
            for view in (*VIEWS, held_back)
        ]
    recipe = Recipe(size=options.size, seconds=options.seconds, views=len(VIEWS))
    programs = {"ours": gradient_of_ours(ours, SMOKE.parameter, targets, recipe)}
    for peer in peers:
        loaded.load_peer(peer, options, 16)
        programs[peer.title] = gradient_of_peer(peer, loaded.path, targets, recipe)
    truth = torch.from_numpy(loaded.volume)
    rows: list[dict[str, Any]] = []
    for who, gradient in programs.items():
        found = reconstruct(gradient, recipe)
        with torch.no_grad():
            image = ours.renderer(
                sensor=held_back,
                seed=TARGET_SEED + 1,
                spp=min(options.target, 64),
                passes=passes,
                params={SMOKE.parameter: found.density},
            )
        row = {"scene": "smoke", "program": who, "iterations": found.iterations}
        row["PSNR of the held-back view dB"] = psnr(image, targets[held_back])
        row["PSNR of the densities dB"] = psnr(found.density, truth)
        row["gain of ours dB"] = (
            rows[0]["PSNR of the held-back view dB"] - row["PSNR of the held-back view dB"] if rows else 0.0
        )
        row["not finite, gradient"] = found.bad
        rows.append(row)
    title = (
        f"Reconstruction in {options.seconds} s, {len(VIEWS)} views of {options.resolution}x{options.resolution}, one "
        f"an iteration, {recipe.spp} + {recipe.spp_grad} spp, {options.threads} threads"
    )
    notes = ["Peers: the time that their gradients take; passing volumes on is not counted."] if peers else []
    return Table(title, ["scene", "program"], rows, notes, part="reconstruction")


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    with Peers(options.peer, options.threads, options.renderer) as peers, Loaded(SMOKE, options.size) as loaded:
        tables = [iterations(loaded, peers, options)]
        if options.seconds:
            tables.append(reconstructions(loaded, peers, options))
        versions = {peer.key: peer.version for peer in peers}
    return Result(tables, versions)
