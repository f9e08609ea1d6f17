"""Derivatives by what moves: silhouettes, shadows, indirect light. How noisy, how fast, how right?

The scalar is mean(image * weight), differentiated in reverse mode by a translation of one thing in the scene.
Efficiency is 1 / (variance x seconds) of one estimate. The seconds are those of an iteration: a new value of the
parameter, an image of one sample, the derivative with `--spp`, and all set-up of these, after a cold call. Tables:

efficiency: of this renderer with its defaults, and of the peers, in alternating rounds with seeds of their own. Of
  Mitsuba both `direct_projective` and `prb_projective` are tried, with several guidings and numbers of samples; that
  with the least mean squared error x seconds counts. Redner takes `--spp` of all kinds of samples.
bias: the same runs, and Mitsuba's defaults, against central differences of this renderer's images with common random
  numbers, in deviations of the difference (z).
passes: of this renderer, the pass that makes the derivative, with outlines and without.
search: the settings of Mitsuba that were tried.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .arguments import peer_argument, positive
from .finite_differences import Sums
from .measured import Measured
from .peers import KNOWN, Peer, Peers
from .report import Result, Table
from .scene_arrays import arrays_of
from .visibility_differences import differences
from .visibility_ours import Moved
from .visibility_scenes import MOVING, Moving
from .visibility_search import RR_DEPTH, Estimate, Runs, Setting, best_of, default, search

SEARCH_SEED = 1 << 20  # far from the rounds'
OFF, SIGNIFICANT = 0.05, 4.0  # a mean that is off by this share of what is right, and by as many deviations, is biased


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument(
        "--search",
        type=positive,
        default=4,
        help="runs of each of Mitsuba's settings, at least 2 (default %(default)s)",
    )
    parser.add_argument(
        "--differences", type=positive, default=16, help="runs of the differences, at least 2 (default %(default)s)"
    )
    parser.add_argument(
        "--difference-spp", type=positive, default=256, help="samples of their images (default %(default)s)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="64x64 pixels, 4 rounds and differences, Mitsuba without guiding alone"
    )
    parser.set_defaults(resolution=128, rounds=16, warmup=1)


def chosen(options: argparse.Namespace) -> list[Moving]:
    """The scenes that `--only` leaves; ends the program if there are none."""
    found = [moving for moving in MOVING if options.only.lower() in moving.name.lower()]
    if not found:
        names = ", ".join(repr(moving.name) for moving in MOVING)
        raise SystemExit(f"--only: no scene's name contains {options.only!r}: {names}")
    return found


class Compared:
    """One scene in all programs."""

    def __init__(self, moving: Moving, peers: list[Peer], options: argparse.Namespace, folder: Path) -> None:
        self.moving, self.options = moving, options
        self.ours = Moved(moving, folder, options.resolution, options.spp, **dict(options.renderer))
        self.notes: list[str] = []
        self.tried: dict[Setting, Runs] = {}
        self.settings: dict[str, Setting] = {}
        self.programs: dict[str, Estimate] = {"ours": self.ours.derivative}
        self.true = differences(self.ours, options.difference_spp, options.differences)
        for peer in peers:
            if peer.ourselves:
                self._load_before(peer)
            elif moving.ours:
                self.notes.append(f"{moving.name}: not in {peer.title}: {moving.ours}.")
            elif KNOWN[peer.name].reads_arrays:
                self._load_redner(peer, folder)
            else:
                self._load_mitsuba(peer, folder)

    def _load_before(self, peer: Peer) -> None:
        size = {"resolution": self.options.resolution, "spp": self.options.spp}
        peer.ask("load_moved", name=self.moving.name, **size)
        self.programs[peer.title] = lambda seed: asked(peer, seed)

    def _load_redner(self, peer: Peer, folder: Path) -> None:
        """Let Redner load the scene, with all of its edge sampling."""
        moving, options = self.moving, self.options
        try:
            arrays = arrays_of(self.ours.scene)
        except ValueError as error:
            self.notes.append(f"{moving.name}: not in {peer.title}: {error}.")
            return
        np.savez(folder / "scene.npz", **arrays)
        settings: dict[str, Any] = {"name": moving.parameter.partition(".")[0], "direction": list(moving.direction)}
        settings |= {"max_depth": moving.max_depth, "resolution": options.resolution, "spp": options.spp}
        peer.ask("load_moved", arrays=str(folder / "scene.npz"), **settings)
        self.programs[peer.title] = lambda seed: asked(peer, seed)

    def _load_mitsuba(self, peer: Peer, folder: Path) -> None:
        """Let Mitsuba load the scene, and find its best setting."""
        path, moving, options = folder / "scene.xml", self.moving, self.options
        self.ours.scene.save(path)
        integrator = {"type": "prb", "max_depth": moving.max_depth, "rr_depth": RR_DEPTH}
        names: dict[str, Any] = {"parameters": [moving.parameter], "integrator": integrator}
        peer.ask("load", path=str(path), arguments={}, resolution=None, spp=options.spp, arrays=None, **names)
        peer.ask("load_moved", direction=list(moving.direction))

        def estimate_of(setting: Setting) -> Estimate:
            request = setting.request(moving)
            return lambda seed: asked(peer, seed, **request)

        seeds = range(SEARCH_SEED, SEARCH_SEED + max(2, options.search))
        self.tried, failed = search(moving, options.spp, seeds, estimate_of, self.true.mean, options.quick)
        for setting, error in failed.items():
            self.notes.append(f"{moving.name}: {setting}: {error}")
        if not self.tried:
            return
        self.settings = {peer.title: best_of(self.tried, self.true.mean)}
        first = default(moving, options.spp)
        if not options.quick and first != self.settings[peer.title]:
            self.settings[f"{peer.title}, defaults"] = first
        self.programs |= {who: estimate_of(setting) for who, setting in self.settings.items()}

    def measure(self) -> dict[str, Runs]:
        """Every program once a round; the first rounds do not count."""
        found = {who: Runs() for who in self.programs}
        for seed in range(self.options.warmup + max(2, self.options.rounds)):
            for who, estimate in self.programs.items():
                derivative, seconds = estimate(seed)
                if seed >= self.options.warmup:
                    found[who].add(derivative, seconds)
        return found

    def efficiency_rows(self, found: dict[str, Runs]) -> Iterator[dict[str, Any]]:
        true = self.true
        right = {who: not biased(Sums.of(runs.derivatives), true) for who, runs in found.items()}
        ours = found["ours"].cost if right["ours"] else 0.0
        for who, runs in found.items():
            row: dict[str, Any] = {"scene": self.moving.name, "program": who, "setting": ""}
            if who in self.settings:
                row["setting"] = str(self.settings[who])
            row["derivative"] = runs.mean
            row["deviation"] = runs.variance**0.5
            row["off by %"] = 100 * (runs.mean / true.mean - 1) if true.mean else None
            row["time s"] = Measured.of(runs.seconds)
            row["efficiency"] = 1 / runs.cost if runs.cost else None
            row["our efficiency / its"] = runs.cost / ours if ours and right[who] else None
            row["to an error of 5 % s"] = runs.cost / (0.05 * true.mean) ** 2 if right[who] else None
            yield row

    def bias_rows(self, found: dict[str, Runs]) -> Iterator[dict[str, Any]]:
        true = self.true
        for who, runs in found.items():
            mean = Sums.of(runs.derivatives)
            row: dict[str, Any] = {"scene": self.moving.name, "program": who, "derivative": mean.mean}
            row["error"] = mean.error2**0.5
            row["differences"] = true.mean
            row["error of these"] = true.error2**0.5
            row["off by %"] = 100 * (mean.mean / true.mean - 1) if true.mean else None
            row["z"] = mean.z(true)
            row["said to lack a term"] = ("yes" if self.ours.incomplete else "no") if who == "ours" else None
            yield row

    def passes_row(self) -> dict[str, Any]:
        """Both passes, alternating; the first rounds do not count."""
        warmup, rounds = self.options.warmup, max(2, self.options.rounds)
        measured = [self.ours.passes(seed) for seed in range(warmup + rounds)][warmup:]
        with_outlines, without = (Measured.of(seconds) for seconds in zip(*measured, strict=True))
        row: dict[str, Any] = {"scene": self.moving.name, "program": "ours", "with outlines s": with_outlines}
        return {**row, "without s": without, "with / without": with_outlines.median / without.median}

    def search_rows(self) -> Iterator[dict[str, Any]]:
        for setting, runs in self.tried.items():
            row: dict[str, Any] = {"scene": self.moving.name, "setting": str(setting), "derivative": runs.mean}
            row["deviation"] = runs.variance**0.5
            row["time s"] = Measured.of(runs.seconds)
            row["efficiency"] = 1 / runs.cost if runs.cost else None
            yield {**row, "squared error x s": runs.error(self.true.mean)}


def biased(mean: Sums, true: Sums) -> bool:
    """Whether a mean is too far from what is right for noise alone."""
    return abs(mean.mean - true.mean) > OFF * abs(true.mean) and abs(mean.z(true)) > SIGNIFICANT


def asked(peer: Peer, seed: int, **request: Any) -> tuple[float, float]:
    """A peer's derivative and its seconds."""
    answer = peer.ask("derivative", seed=seed, **request)
    return answer["derivative"], answer["seconds"]


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    if options.quick:
        options.resolution, options.rounds, options.differences = 64, 4, 4
    efficiency, bias, passes, searched, notes = [], [], [], [], []
    scenes = chosen(options)
    with Peers(options.peer, options.threads, options.renderer) as peers:
        versions = {peer.key: peer.version for peer in peers}
        for moving in scenes:
            with tempfile.TemporaryDirectory(prefix="bench-") as folder:
                compared = Compared(moving, peers, options, Path(folder))
                found = compared.measure()
                passes.append(compared.passes_row())
            efficiency += compared.efficiency_rows(found)
            bias += compared.bias_rows(found)
            searched += compared.search_rows()
            notes += compared.notes
    what = f"{options.resolution}x{options.resolution}, {options.spp} spp, {options.threads} threads"
    labels = ["scene", "program"]
    plot = {"kind": "bars", "columns": ["to an error of 5 % s"], "y": "seconds to a standard error of 5 %"}
    said = [
        "Efficiency is 1 / (variance x s) of one estimate, and says nothing where that is biased: there is no ratio "
        f"where either mean is off by more than {100 * OFF:.0f} % and {SIGNIFICANT:.0f} deviations. To an error of 5 "
        "%: the seconds after which the standard error is 5 % of the derivative.",
        "Settings: integrator, guiding and samples that it starts from, samples a pixel of interior, silhouettes and "
        "others.",
    ]
    title = f"Efficiency of derivatives by motions, {what}, {max(2, options.rounds)} alternating rounds"
    tables = [Table(title, labels, efficiency, [*said, *notes] if peers else [said[0], *notes], plot, "efficiency")]
    spp = f"{max(2, options.differences)} x {options.difference_spp} spp"
    said = ["z follows Student's t; a derivative that lacks a term has a large one."]
    title = f"Means of {max(2, options.rounds)} derivatives against central differences ({spp}), {what}"
    tables.append(Table(title, labels, bias, said, part="bias"))
    title = f"The pass that makes the derivative, with outlines and without, {what}"
    tables.append(Table(title, labels, passes, part="passes"))
    if searched:
        title = f"Settings of Mitsuba, {max(2, options.search)} runs of each, {what}"
        tables.append(Table(title, ["scene", "setting"], searched, part="search"))
    return Result(tables, versions)
