"""Do all programs find the same gradients, and how noisy is one estimate of them?

The scalar is mean(image * weight); compared are sums over the entries of each parameter. Efficiency is
1 / (variance x time).
"""

from __future__ import annotations

import argparse
from statistics import fmean, median, pvariance
from typing import Any

import torch

from .arguments import peer_argument
from .measured import Measured
from .ours import Ours, chosen
from .peers import Peer, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)


def gradient_rows(row: Row, peers: list[Peer], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row of the table for each parameter of a scene."""
    ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))

    def mine(seed: int) -> dict[str, Any]:
        gradients, seconds = ours.gradient(seed, options.spp)
        return {"sums": [float(gradient.sum()) for gradient in gradients], "seconds": seconds}

    runs: dict[str, list[dict[str, Any]]] = {"ours": []}
    for peer in peers:
        load_peer(peer, row, options.resolution, options.spp)
        runs[peer.title] = []
    for seed in range(options.warmup + options.rounds):
        answers = {"ours": mine(seed)}
        for peer in peers:
            answers[peer.title] = peer.ask("gradient", seed=seed, spp=options.spp)
        if seed >= options.warmup:
            for who, answer in answers.items():
                runs[who].append(answer)
    rows = []
    for i, parameter in enumerate(row.parameters):
        result: dict[str, Any] = {"scene": row.name, "parameter": parameter}
        mean, variance, seconds = {}, {}, {}
        for who, samples in runs.items():
            sums = [sample["sums"][i] for sample in samples]
            mean[who], variance[who] = fmean(sums), pvariance(sums)
            seconds[who] = median(sample["seconds"] for sample in samples)
            prefix = "" if who == "ours" else f"{who} "
            result[f"{prefix}gradient"] = mean[who]
            result[f"{prefix}deviation"] = variance[who] ** 0.5 if len(sums) > 1 else None
            result[f"{prefix}time s"] = Measured.of(sample["seconds"] for sample in samples)
        for peer in peers:
            error = ((variance["ours"] + variance[peer.title]) / max(options.rounds - 1, 1)) ** 0.5
            result[f"{peer.title} z"] = (mean["ours"] - mean[peer.title]) / error if error else None
            cost, our_cost = (variance[who] * seconds[who] for who in (peer.title, "ours"))
            result[f"our efficiency / {peer.title}"] = cost / our_cost if our_cost else None
        rows.append(result)
    return rows


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    with Peers(options.peer, options.threads, options.renderer) as peers:
        rows = [entry for row in chosen(options) for entry in gradient_rows(row, peers, options)]
        versions = {peer.key: peer.version for peer in peers}
        who = [""] + [f"{peer.title} " for peer in peers]
    title = f"Gradients at {options.resolution}x{options.resolution}, {options.spp} spp, {options.rounds} runs of each"
    notes = [
        "Sums over the entries of a parameter's gradient; deviation is that of one run, z of the means' difference."
    ]
    plot = {"kind": "bars", "columns": [f"{name}deviation" for name in who], "y": "deviation of one estimate"}
    return Result([Table(title, ["scene", "parameter"], rows, notes, plot)], versions)
