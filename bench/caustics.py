"""Caustics: one iteration of finding the heights of a glass plate that throws a picture.

The scene is that of `scenes/make_caustics.py`; the plate's front is a height field, for peers a mesh of as many
vertices. An iteration is a picture of 64 samples a pixel, its distance from the wanted one, up to its brightness, and
the derivative of that by all heights with 32 samples. Peers render in one pass. Three parts:

time: seconds of an iteration, the heights having changed before it.
memory: peak of a process that loads the scene and makes three iterations.
check: the derivative of the distance by smooth changes of the heights, against finite differences with common random
  numbers, `--seeds` of them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr
from scenes import make_caustics

from .arguments import natural, peer_argument, positive
from .fresh import measure
from .measured import Measured, rounds
from .peers import KNOWN, Peer, PeerError, Peers
from .report import Result, Table

PARTS = ("time", "memory", "check")
STEPS = 3  # iterations whose memory is measured
LARGEST = 0.01  # of the heights
STEP = 3e-5  # of the heights, in an iteration
CHANGE = 2e-5  # of the heights, for finite differences: moves light by a small part of a pixel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument("--size", type=positive, default=512, help="heights along a side (default %(default)s)")
    parser.add_argument("--spp-grad", type=positive, default=32, help="samples of the derivative (default %(default)s)")
    parser.add_argument("--passes", type=positive, default=1, help="passes (default %(default)s)")
    parser.add_argument("--part", choices=PARTS, nargs="+", default=list(PARTS), help="only these (default: all)")
    parser.add_argument("--seeds", type=natural, default=16, help="of the check, at least 2 (default %(default)s)")
    parser.set_defaults(resolution=128, spp=64, rounds=7, warmup=2)


def waves(size: int, amplitude: float = 2e-3) -> np.ndarray:
    """Heights that bend light by a few pixels, as a plate that is half done: (size, size), float32."""
    axis = (2 * np.arange(size) + 1) / size - 1
    x, y = axis[None, :], axis[:, None]
    height = np.sin(5 * x + 2 * y) * np.cos(4 * y - x) + 0.3 * np.sin(13 * x - 9 * y + 1) + 0.2 * np.cos(21 * y + 8 * x)
    return (amplitude * height / np.abs(height).max()).astype(np.float32)


class Plate:
    """This renderer's scene, and an iteration of it."""

    def __init__(self, size: int, resolution: int, spp: int, **settings: Any) -> None:
        scene = make_caustics.caustics(torch.from_numpy(waves(size)), resolution=resolution, spp=spp)
        self.scene = tr.load_dict(scene)
        warnings.filterwarnings("ignore", category=tr.MissingTermWarning)  # there are no moving edges
        (self.heights,) = self.scene.train_only(make_caustics.LENS)
        try:
            self.renderer = tr.Renderer(self.scene, spp=spp, **settings)
        except (TypeError, ValueError) as error:
            raise SystemExit(f"--set: {error}") from error
        target = torch.from_numpy(make_caustics.target(resolution))
        self.target = target / target.mean()

    def loss(self, image: torch.Tensor, mean: torch.Tensor | None = None) -> torch.Tensor:
        """The distance from the target that does not know how bright a picture is; its mean is not differentiated."""
        return (image / (image.detach().mean() if mean is None else mean) - self.target).square().mean()

    def iteration(self, seed: int, **settings: Any) -> dict[str, float]:
        """Seconds of picture and derivative, and what was not finite."""
        self.heights.grad = None
        start = time.perf_counter()
        image = self.renderer(seed=seed, **settings)
        loss = self.loss(image)
        middle = time.perf_counter()
        loss.backward()
        end = time.perf_counter()
        gradient = self.heights.grad
        if not gradient.abs().sum() > 0:
            raise RuntimeError("no gradient reached the heights")
        with torch.no_grad():  # so that the next iteration sees other heights
            self.heights.sub_(STEP * gradient / gradient.abs().max()).clamp_(-LARGEST, LARGEST)
        bad = [int((~torch.isfinite(values)).sum()) for values in (image, gradient)]
        return {
            "forward": middle - start,
            "backward": end - middle,
            "loss": loss.item(),
            "bad image": bad[0] // 3,
            "bad gradient": bad[1],
        }


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    return {"spp_grad": options.spp_grad, "passes": options.passes, **dict(options.renderer)}


class Scene:
    """The scene for peers: its dict and target in files, in a ``with`` block."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options

    def __enter__(self) -> Scene:
        self.folder = tempfile.TemporaryDirectory(prefix="bench-")
        path = Path(self.folder.name)
        options = self.options
        np.save(path / "target.npy", make_caustics.target(options.resolution))
        np.save(path / "heights.npy", waves(options.size))
        scene = make_caustics.caustics(None, resolution=options.resolution, spp=options.spp)
        (path / "scene.json").write_text(json.dumps(scene, default=lambda array: array.tolist()))
        return self

    def __exit__(self, *_: object) -> None:
        self.folder.cleanup()

    def load(self, peer: Peer) -> None:
        """Let a peer load it."""
        if KNOWN[peer.name].reads_arrays:
            raise PeerError(f"{peer.title} has no particle tracer")
        if self.options.passes != 1 and not peer.ourselves:
            raise PeerError(f"{peer.title} is measured in one pass, got --passes {self.options.passes}")
        peer.ask("load_caustics", folder=self.folder.name, front=make_caustics.FACING_DOWN)

    def counts(self, peer: Peer) -> dict[str, int]:
        """Samples of an iteration, in as many passes as the peer knows."""
        passes = {"passes": self.options.passes} if peer.ourselves else {}
        return {"spp": self.options.spp, "spp_grad": self.options.spp_grad, **passes}


def time_table(scene: Scene, peers: list[Peer], options: argparse.Namespace) -> Table:
    """Seconds of an iteration."""
    plate = Plate(options.size, options.resolution, options.spp, **settings_of(options))
    programs = {"ours": plate.iteration}
    for peer in peers:
        scene.load(peer)
        programs[peer.title] = lambda seed, peer=peer: peer.ask("caustics", seed=seed, **scene.counts(peer))
    rows: list[dict[str, Any]] = []
    for who, values in rounds(programs, options).items():
        values["sum"] = [a + b for a, b in zip(values["forward"], values["backward"], strict=True)]
        row: dict[str, Any] = {"program": who}
        row |= {f"{name} s": Measured.of(values[name]) for name in ("forward", "backward", "sum")}
        for name in ("forward", "sum"):
            row[f"{name} / ours"] = row[f"{name} s"].median / rows[0][f"{name} s"].median if rows else 1.0
        row["distance after"] = values["loss"][-1]
        row |= {f"not finite, {name}": int(sum(values[f"bad {name}"])) for name in ("image", "gradient")}
        rows.append(row)
    title = (
        f"One iteration, {options.size}x{options.size} heights, {options.resolution}x{options.resolution} pixels, "
        f"{options.passes} x ({options.spp} + {options.spp_grad}) spp, {options.threads} threads, medians of "
        f"{options.rounds} alternating rounds"
    )
    notes = ["Not finite, in all rounds together: pixels, entries of gradients."]
    plot = {"kind": "bars", "columns": ["forward s", "backward s"], "y": "one iteration, s"}
    return Table(title, ["program"], rows, notes, plot, part="time")


def memory_table(scene: Scene, options: argparse.Namespace) -> Table:
    """Peak memory of fresh processes."""
    shared = {"threads": options.threads, "resolution": options.resolution, "spp": options.spp, "steps": STEPS}
    found = {"ours": measure("caustics_memory", size=options.size, renderer=settings_of(options), **shared)}
    for asked in options.peer:
        peer = Peer(*asked, options.threads, settings=dict(options.renderer))
        try:
            scene.load(peer)
            before = peer.ask("settle")["memory"]
            for seed in range(STEPS):
                peer.ask("caustics", seed=seed, **scene.counts(peer))
            peak = peer.ask("memory")["peak"]
            found[peer.title] = {"peak": peak, "added": max(0.0, peak - before)}
        finally:
            peer.close()
    ours = found["ours"]
    rows = [
        {
            "program": who,
            "peak of the process MiB": values["peak"],
            "of that, beyond the loaded scene MiB": values["added"],
            "peak / ours": values["peak"] / ours["peak"],
            "beyond the scene / ours": values["added"] / max(ours["added"], 1e-6),
        }
        for who, values in found.items()
    ]
    title = f"Memory of {STEPS} iterations in fresh processes, {options.size}x{options.size} heights"
    return Table(title, ["program"], rows, part="memory")


def check_table(options: argparse.Namespace) -> Table:
    """The derivative by smooth changes, against finite differences."""
    plate = Plate(options.size, options.resolution, options.spp, **settings_of(options))
    base = plate.heights.detach().clone()
    x = (2 * torch.arange(options.size) + 1) / options.size - 1
    rows: list[dict[str, Any]] = []
    for number in range(3):
        turn = torch.Generator().manual_seed(number)
        frequency = 2 + 6 * torch.rand(4, generator=turn)
        change = torch.sin(frequency[0] * x + frequency[1])[:, None] * torch.sin(frequency[2] * x + frequency[3])[None]

        def slope(seed: int, change: torch.Tensor = change) -> tuple[float, float]:
            heights = base.clone().requires_grad_()
            settings = {"seed": seed, "correlated": True, "spp_grad": options.spp}
            image = plate.renderer(params={make_caustics.LENS: heights}, **settings)
            mean = image.detach().mean()
            (gradient,) = torch.autograd.grad(plate.loss(image, mean), heights)
            ends = []
            for sign in (1, -1):
                with torch.no_grad():
                    image = plate.renderer(params={make_caustics.LENS: base + sign * CHANGE * change}, seed=seed)
                ends.append(plate.loss(image.double(), mean).item())
            return (gradient.double() * change).sum().item(), (ends[0] - ends[1]) / (2 * CHANGE)

        ours, differences = np.array([slope(seed) for seed in range(max(2, options.seeds))]).T
        error = (ours - differences).std(ddof=1) / len(ours) ** 0.5
        rows.append(
            {
                "change": f"{number + 1}",
                "derivative": ours.mean(),
                "finite difference": differences.mean(),
                "relative difference %": 100 * abs(ours.mean() / differences.mean() - 1),
                "difference / its deviation": (ours.mean() - differences.mean()) / error,
            }
        )
    title = f"Derivative by smooth changes of {options.size}x{options.size} heights, {len(ours)} seeds"
    return Table(title, ["change"], rows, part="check")


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    tables = []
    with Peers(options.peer, options.threads, options.renderer) as peers, Scene(options) as scene:
        versions = {peer.key: peer.version for peer in peers}
        if "time" in options.part:
            tables.append(time_table(scene, peers, options))
        if "memory" in options.part:
            tables.append(memory_table(scene, options))
    if "check" in options.part:
        tables.append(check_table(options))
    return Result(tables, versions)
