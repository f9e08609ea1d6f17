"""Gradients of a small cloud by its density in every voxel: time, variance, bias, memory.

Full size: 128 x 128 pixels, 16 samples a pixel, 128^3 voxels, optical depth 10, albedo 0.9, light from everywhere. The
scalar is mean(image * weight), where it is not the time that is asked for. Four parts:

time: forward and backward, of the mean square of the image.
variance: of a voxel's gradient over `--seeds` runs, in the mean over all voxels, and the squared distance from the mean
  of `--reference` samples a pixel, which contains a bias; both times the seconds of a run.
bias: sums of the gradient over all voxels, over empty, thin and dense ones, and over 64 blocks, in the mean over
  `--seeds` runs, against finite differences of images (`finite_differences.py`), in deviations of the difference (z).
memory: peak of three steps in a fresh process, beyond the parameter and its gradient.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .arguments import peer_argument, positive
from .finite_differences import Sums, derivatives, groups_of
from .fresh import measure
from .measured import Measured, rounds
from .media import CLOUD, Loaded
from .peers import Peer, Peers
from .report import Result, Table

PARTS = ("time", "variance", "bias", "memory")
PASS = 256  # samples of one pass of the reference, at most
REFERENCE_SEED = 1 << 40  # far from the rounds'
STEPS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument("--size", type=positive, default=128, help="voxels along a side (default %(default)s)")
    parser.add_argument("--part", choices=PARTS, nargs="+", default=list(PARTS), help="only these (default: all)")
    parser.add_argument(
        "--seeds", type=positive, default=48, help="runs for variance and bias, at least 2 (default %(default)s)"
    )
    parser.add_argument(
        "--reference", type=positive, default=4096, help="samples of the reference (default %(default)s)"
    )
    parser.add_argument(
        "--differences", type=positive, default=32, help="runs of finite differences (default %(default)s)"
    )
    parser.set_defaults(resolution=128, spp=16, rounds=5, warmup=1)


def time_table(loaded: Loaded, peers: list[Peer], options: argparse.Namespace) -> Table:
    """Seconds of forward and backward passes."""
    ours = loaded.ours(options, options.spp)
    programs = {"ours": ours.step}
    for peer in peers:
        loaded.load_peer(peer, options, options.spp)
        programs[peer.title] = lambda seed, peer=peer: peer.ask("step", seed=seed)
    found = rounds(programs, options)
    rows: list[dict[str, Any]] = []
    for who, seconds in found.items():
        seconds["sum"] = [a + b for a, b in zip(seconds["forward"], seconds["backward"], strict=True)]
        row: dict[str, Any] = {"program": who}
        row |= {f"{name} s": Measured.of(seconds[name]) for name in ("forward", "backward", "sum")}
        for name in ("forward", "sum"):
            row[f"{name} / ours"] = row[f"{name} s"].median / rows[0][f"{name} s"].median if rows else 1.0
        rows.append(row)
    title = (
        f"Image and gradient of {options.size}^3 densities, {options.resolution}x{options.resolution}, "
        f"{options.spp} spp, {options.threads} threads, medians of {options.rounds} alternating rounds"
    )
    plot = {"kind": "bars", "columns": ["forward s", "backward s"], "y": "s"}
    return Table(title, ["program"], rows, plot=plot, part="time")


class Runs:
    """What several runs of one program found: the sum over runs of each voxel's gradient and of its square."""

    def __init__(self, groups: dict[str, np.ndarray]) -> None:
        self.total = self.squares = np.zeros(())
        self.count, self.bad = 0, 0
        self.seconds: list[float] = []
        self.sums: dict[str, list[float]] = {name: [] for name in groups}
        self.groups = groups

    def add(self, gradient: np.ndarray, seconds: float) -> None:
        """One run's gradient (Z, Y, X, 1); entries that are not finite count as 0."""
        finite = np.isfinite(gradient)
        self.bad += int(gradient.size - finite.sum())
        gradient = np.where(finite, gradient, 0.0)
        self.total, self.squares = self.total + gradient, self.squares + np.square(gradient)
        self.count += 1
        self.seconds.append(seconds)
        for name, where in self.groups.items():
            self.sums[name].append(float(gradient[where].sum()))

    @property
    def variance(self) -> float:
        """Of a voxel's gradient in one run, in the mean over all voxels."""
        return float((self.squares - np.square(self.total) / self.count).mean() / (self.count - 1))

    def error(self, reference: np.ndarray) -> float:
        """Mean square of the distance of a voxel's gradient in one run from a reference."""
        cross = self.squares - 2 * self.total * reference + self.count * np.square(reference)
        return float(cross.mean() / self.count)


def runs_of(
    loaded: Loaded, peers: list[Peer], options: argparse.Namespace, groups: dict[str, np.ndarray]
) -> dict[str, Runs]:
    """`--seeds` gradients of each program."""
    ours = loaded.ours(options, options.spp)
    for peer in peers:
        loaded.load_peer(peer, options, options.spp)
    found = {who: Runs(groups) for who in ("ours", *(peer.title for peer in peers))}
    file = Path(loaded.path) / "gradient.npz"
    for seed in range(max(2, options.seeds)):
        (gradient,), seconds = ours.gradient(seed, options.spp)
        found["ours"].add(gradient, seconds)
        for peer in peers:
            seconds = peer.ask("gradient", seed=seed, spp=options.spp, file=str(file))["seconds"]
            with np.load(file) as stored:
                found[peer.title].add(stored[stored.files[0]].reshape(gradient.shape), seconds)
    return found


def variance_table(loaded: Loaded, found: dict[str, Runs], options: argparse.Namespace) -> Table:
    """Variance and squared error of a voxel's gradient, times seconds."""
    ours = loaded.ours(options, options.spp)
    passes = math.ceil(options.reference / (2 * PASS))
    spp = math.ceil(options.reference / (2 * passes))
    halves = [ours.gradient(REFERENCE_SEED + i, spp, passes)[0][0] for i in range(2)]
    reference = (halves[0] + halves[1]) / 2
    noise = float(np.square(halves[0] - reference).mean())  # the squared error of the mean of both
    signal = float(np.square(reference).mean())
    rows: list[dict[str, Any]] = []
    for who, runs in found.items():
        seconds = Measured.of(runs.seconds)
        row: dict[str, Any] = {"program": who, "gradient s": seconds, "deviation of a voxel": math.sqrt(runs.variance)}
        row["variance x s"] = runs.variance * seconds.median
        row["(error² - noise) x s"] = max(0.0, runs.error(reference) - noise) * seconds.median
        for name in ("variance x s", "(error² - noise) x s"):
            row[f"{name} / ours"] = row[name] / rows[0][name] if rows and rows[0][name] else None if rows else 1.0
        row["error² of the mean of all / gradient²"] = (
            float(np.square(runs.total / runs.count - reference).mean()) / signal if signal else None
        )
        row["not finite"] = runs.bad
        rows.append(row)
    title = (
        f"Noise of a voxel's gradient, {options.size}^3 voxels, {options.resolution}x{options.resolution}, "
        f"{options.spp} spp, {max(2, options.seeds)} runs; reference of {options.reference} spp"
    )
    notes = [
        "Error: distance from the reference, with the bias that a program has; the reference's own noise is taken off.",
        f"Noise of the reference, relative to the squared gradient: {noise / signal if signal else 0:.3g}.",
    ]
    return Table(title, ["program"], rows, notes, part="variance")


def bias_table(
    loaded: Loaded, found: dict[str, Runs], groups: dict[str, np.ndarray], options: argparse.Namespace
) -> Table:
    """Sums of gradients against finite differences."""
    ours = loaded.ours(options, options.spp)
    side = 2 * float(ours.scene.get_parameter("cloud.interior_medium.scale"))  # of a cube [-1, 1]^3
    true = derivatives(ours, CLOUD.parameter, loaded.volume, groups, side, options.spp, options.differences)
    estimates = {who: {name: Sums.of(values) for name, values in runs.sums.items()} for who, runs in found.items()}
    rows: list[dict[str, Any]] = []
    blocks = [name for name in groups if name.startswith("block")]
    for name in groups:
        if name in blocks:
            continue
        row: dict[str, Any] = {"cells": name, "number": int(groups[name].sum())}
        row["finite differences"] = true[name].mean
        for who, sums in estimates.items():
            row[f"{who}: sum"] = sums[name].mean
            row[f"{who}: z"] = sums[name].z(true[name])
        rows.append(row)
    row = {"cells": f"{len(blocks)} blocks, largest absolute z", "number": int(next(iter(groups.values())).size)}
    rms: dict[str, Any] = {"cells": f"{len(blocks)} blocks, root mean square of z", "number": row["number"]}
    for who, sums in estimates.items():
        z = [sums[name].z(true[name]) for name in blocks]
        row[f"{who}: z"] = max(abs(value) for value in z)
        rms[f"{who}: z"] = math.sqrt(sum(value * value for value in z) / len(z))
    title = (
        f"Sums of the gradient over cells, {max(2, options.seeds)} runs of {options.spp} spp, against finite "
        f"differences ({options.differences} runs)"
    )
    notes = ["z follows Student's t of about as many degrees of freedom as there are runs of finite differences."]
    return Table(title, ["cells"], [*rows, row, rms], notes, part="bias")


def memory_table(options: argparse.Namespace) -> Table:
    """Peak memory in fresh processes."""
    settings = {"threads": options.threads, "resolution": options.resolution, "spp": options.spp}
    settings |= {"size": options.size, "renderer": dict(options.renderer), "steps": STEPS}
    runs = [measure("media_memory", **settings) for _ in range(options.rounds)]
    beyond = [max(0.0, run["peak"] - run["gradients"]) for run in runs]
    row = {
        "scene": "cloud",
        "parameter and gradient MiB": 2 * runs[0]["gradients"],
        "peak above the loaded scene MiB": Measured.of(run["peak"] for run in runs),
        "beyond parameter and gradient MiB": Measured.of(beyond),
    }
    title = (
        f"Peak memory of {STEPS} steps in fresh processes, {options.size}^3 voxels, {options.spp} spp, "
        f"{options.threads} threads, medians of {options.rounds} processes"
    )
    notes = ["The loaded scene holds the parameter. Beyond: the core's own tables, and a gradient buffer a thread."]
    return Table(title, ["scene"], [row], notes, part="memory")


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    tables = []
    with Peers(options.peer, options.threads, options.renderer) as peers, Loaded(CLOUD, options.size) as loaded:
        if "time" in options.part:
            tables.append(time_table(loaded, peers, options))
        if {"variance", "bias"} & set(options.part):
            groups = groups_of(loaded.volume)
            found = runs_of(loaded, peers, options, groups)
            if "variance" in options.part:
                tables.append(variance_table(loaded, found, options))
            if "bias" in options.part:
                tables.append(bias_table(loaded, found, groups, options))
        versions = {peer.key: peer.version for peer in peers}
    if "memory" in options.part:
        tables.append(memory_table(options))
    return Result(tables, versions)
