"""Seconds of one iteration of the translucent slab: a picture and its derivative by the albedo of every voxel.

Full size: 64 x 256 x 256 voxels of three colours, 128 x 128 pixels, 6 passes of 16 + 4 samples a pixel, optical
thickness 100 behind a rough dielectric surface. `--spp` is the number of the picture's samples in a pass.
"""

from __future__ import annotations

import argparse

import torch

from .arguments import peer_argument, positive
from .measured import rounds
from .media import SLAB, Loaded, iteration, iteration_table, media_arguments
from .peers import Peers
from .report import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    media_arguments(parser, spp_grad=4, passes=6)
    parser.add_argument(
        "--size", type=positive, nargs=3, default=[64, 256, 256], metavar="N", help="voxels (default 64 256 256)"
    )
    parser.set_defaults(resolution=128, spp=16, rounds=3, warmup=1)


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    with Peers(options.peer, options.threads, options.renderer) as peers, Loaded(SLAB, *options.size) as loaded:
        ours = loaded.ours(options, options.spp, spp_grad=options.spp_grad, passes=options.passes)

        def run_ours(seed: int) -> dict[str, float]:
            return iteration(ours, seed)

        programs = {"ours": run_ours}
        for peer in peers:
            loaded.load_peer(peer, options, options.spp)
            counts = {"spp": options.spp, "spp_grad": options.spp_grad, "passes": options.passes}
            programs[peer.title] = lambda seed, peer=peer, counts=counts: peer.ask(
                "iteration", seed=seed, views=[0], **counts
            )
        found = rounds(programs, options)
        versions = {peer.key: peer.version for peer in peers}
    size = " x ".join(map(str, options.size))
    title = (
        f"One iteration, {options.resolution}x{options.resolution}, {options.passes} passes of {options.spp} + "
        f"{options.spp_grad} spp, {options.threads} threads, medians of {options.rounds} alternating rounds"
    )
    return Result([iteration_table(found, f"slab, {size} albedos", title, [])], versions)
