"""Error of images and gradients at equal time: every sampler of torchrender and of its peers, against one reference.

The reference is torchrender's, with `--reference` samples a pixel. Errors are root mean squares over pixels or texels
and over rounds, relative to the reference's mean (image) or root mean square (gradient of mean(image * weight)). Each
program is measured at several sample counts. A straight line through its times says how many samples it has in a common
time, one through its errors in logarithms, whose slope is -0.5 for independent samples, how large its error is then.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

from .arguments import counts_argument, peer_argument, positive
from .measured import Measured, fit_line
from .ours import Ours, chosen
from .peers import KNOWN, Peer, Peers
from .report import Result, Table
from .rows import Row
from .scene_arrays import load_peer

# Makes an image or a gradient (as a list of arrays) from a seed and a sample count; with the seconds that it took.
Estimate = Callable[[int, int], tuple[list[np.ndarray], float]]
PASS = 256  # samples of one pass of the reference, at most
REFERENCE_SEED = 1 << 40  # far from the rounds'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    counts_argument(parser, "--samples", [4, 16, 64], "samples a pixel, in place of --spp")
    parser.add_argument(
        "--reference", type=positive, default=4096, help="samples of the reference, at least (default %(default)s)"
    )
    parser.set_defaults(resolution=128, rounds=11, warmup=1)


def samplers() -> tuple[str, ...]:
    """The samplers that torchrender has; versions without a choice have one."""
    return tuple(getattr(tr, "SAMPLERS", ("independent",)))


@dataclass
class Program:
    """One way to estimate an image and a gradient, and what it did, by sample count."""

    image: Estimate
    gradient: Estimate
    begin: Callable[[], None] = lambda: None  # called before estimates that are measured
    errors: dict[str, dict[int, list[float]]] = field(default_factory=lambda: {"image": {}, "gradient": {}})
    seconds: dict[str, dict[int, list[float]]] = field(default_factory=lambda: {"image": {}, "gradient": {}})


def of_ours(row: Row, options: argparse.Namespace, sampler: str) -> Program:
    settings = {**dict(options.renderer), **({"sampler": sampler} if len(samplers()) > 1 else {})}
    ours = Ours.of_row(row, options.resolution, options.spp, **settings)

    def image(seed: int, spp: int) -> tuple[list[np.ndarray], float]:
        value, seconds = ours.image(seed, spp)
        return [value], seconds

    return Program(image, ours.gradient)


def of_peer(peer: Peer, row: Row, options: argparse.Namespace, folder: Path, sampler: str | None) -> Program:
    chosen_row = row if sampler is None else replace(row, arguments={**row.arguments, "sampler": sampler})

    def image(seed: int, spp: int) -> tuple[list[np.ndarray], float]:
        file = folder / "image.npy"
        seconds = peer.ask("image", seed=seed, spp=spp, file=str(file))["seconds"]
        return [np.load(file)[..., :3]], seconds

    def gradient(seed: int, spp: int) -> tuple[list[np.ndarray], float]:
        file = folder / "gradient.npz"
        seconds = peer.ask("gradient", seed=seed, spp=spp, file=str(file))["seconds"]
        with np.load(file) as stored:
            return [stored[name] for name in stored.files], seconds

    def begin() -> None:
        """The peer has one scene at a time, which nothing has touched yet when it is loaded."""
        load_peer(peer, chosen_row, options.resolution, options.spp)
        image(0, options.samples[0])
        gradient(0, options.samples[0])

    return Program(image, gradient, begin)


@dataclass
class Reference:
    """What estimates are compared with: the mean of two independent halves, and its own squared error, seen in them."""

    value: list[np.ndarray]
    noise: float  # relative, as `squared_error`

    @classmethod
    def of_halves(cls, first: list[np.ndarray], second: list[np.ndarray], kind: str) -> Reference:
        value = [(a + b) / 2 for a, b in zip(first, second, strict=True)]
        return cls(value, squared_error(first, value, kind))  # half of the difference, squared: the mean's variance


def references_of(row: Row, options: argparse.Namespace) -> dict[str, Reference]:
    """Image and gradient with many samples."""
    ours = Ours.of_row(row, options.resolution, options.spp)
    passes = math.ceil(options.reference / (2 * PASS))
    spp = math.ceil(options.reference / (2 * passes))
    halves: dict[str, list[list[np.ndarray]]] = {"image": [], "gradient": []}
    for seed in (REFERENCE_SEED, REFERENCE_SEED + 1):
        halves["image"].append([ours.image(seed, spp, passes)[0]])
        halves["gradient"].append(ours.gradient(seed, spp, passes)[0])
    return {kind: Reference.of_halves(first, second, kind) for kind, (first, second) in halves.items()}


def squared_error(estimate: list[np.ndarray], reference: list[np.ndarray], kind: str) -> float:
    """Mean square of the difference, relative to the square of the reference's mean (image) or its mean square."""
    size = sum(r.size for r in reference)
    difference = sum(float(np.square(e - r).sum()) for e, r in zip(estimate, reference, strict=True)) / size
    if kind == "image":
        return difference / (sum(float(r.sum()) for r in reference) / size) ** 2
    return difference / (sum(float(np.square(r).sum()) for r in reference) / size)


def samples_in(common: float, spp: Sequence[int], seconds: Sequence[float]) -> float | None:
    """How many samples a pixel take `common` seconds, by a straight line; None if not even one has the time."""
    fixed, marginal = fit_line(spp, seconds) if len(spp) > 1 else (0.0, seconds[0] / spp[0])
    if marginal <= 0:  # nothing but noise: as many as were measured
        return float(max(spp)) if common >= min(seconds) else None
    count = (common - fixed) / marginal
    return count if count >= 1 else None


def error_slope(spp: Sequence[int], errors: Sequence[float]) -> tuple[float, float]:
    """Offset and slope of log(error) over log(samples), by least squares; a single point gets the slope -1/2."""
    x, y = np.log(spp), np.log(errors)
    if len(x) < 2:
        return float(y[0] + 0.5 * x[0]), -0.5
    slope, offset = np.polyfit(x, y, 1)
    return float(offset), float(slope)


def measure_row(row: Row, peers: list[Peer], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A table row for each program and each of image and gradient."""
    references = references_of(row, options)
    with tempfile.TemporaryDirectory() as folder:
        programs = {f"ours, {sampler}": of_ours(row, options, sampler) for sampler in samplers()}
        for peer in peers:
            for sampler in KNOWN[peer.name].samplers or (None,):
                title = f"{peer.title}, {sampler}" if sampler else peer.title
                programs[title] = of_peer(peer, row, options, Path(folder), sampler)
        for seed in range(options.warmup + options.rounds):
            for program in programs.values():
                program.begin()
                for kind, estimate in (("image", program.image), ("gradient", program.gradient)):
                    for spp in options.samples:
                        value, seconds = estimate(seed, spp)
                        if seed >= options.warmup:
                            error = squared_error(value, references[kind].value, kind)
                            program.errors[kind].setdefault(spp, []).append(error)
                            program.seconds[kind].setdefault(spp, []).append(seconds)
    rows = []
    for kind in ("image", "gradient"):
        first = next(iter(programs.values()))
        common = Measured.of(first.seconds[kind][options.samples[-1]]).median
        noise = references[kind].noise
        ours: float | None = None
        for who, program in programs.items():
            times = {spp: Measured.of(values) for spp, values in program.seconds[kind].items()}
            squares = {spp: float(np.mean(values)) for spp, values in program.errors[kind].items()}
            # where noise is all there is, chance may make the difference negative
            errors = {spp: math.sqrt(max(square - noise, 1e-3 * square)) for spp, square in squares.items()}
            offset, slope = error_slope(options.samples, list(errors.values()))
            count = samples_in(common, options.samples, [times[spp].median for spp in options.samples])
            error = None if count is None else math.exp(offset + slope * math.log(count))
            ours = error if program is first else ours
            result: dict[str, Any] = {"scene": row.name, "of": kind, "program": who}
            for spp in options.samples:
                result[f"error, {spp} spp"] = errors[spp]
                result[f"{spp} spp s"] = times[spp]
            result["common time s"] = common
            result["spp in it"] = count
            result["error then"] = error
            result["relative to the first"] = None if error is None or ours is None else error / ours
            result["slope"] = slope
            result["reference's own error"] = math.sqrt(noise)
            rows.append(result)
    return rows


def run(options: argparse.Namespace) -> Result:
    others = [count for count in options.samples if 4 ** round(math.log(count, 4)) != count]
    for name, _ in options.peer:
        if KNOWN[name].samplers and others:  # they would take more than they are asked for
            raise SystemExit(f"--samples: {KNOWN[name].title}'s samplers take powers of four, got {others[0]}")
    torch.set_num_threads(options.threads)
    with Peers(options.peer, options.threads, options.renderer) as peers:
        rows = [entry for row in chosen(options) for entry in measure_row(row, peers, options)]
        versions = {peer.key: peer.version for peer in peers}
    title = (
        f"Relative error at equal time, {options.resolution}x{options.resolution}, {options.threads} threads, "
        f"{options.rounds} rounds, reference with {options.reference} spp"
    )
    notes = [
        "The common time is that of the first program at its largest sample count.",
        "The reference's own error, seen in its halves, is taken off the squared errors.",
    ]
    if "redner" in versions:
        notes.append(
            "Redner takes independent samples. It looks textures up in mipmaps, so that its gradients of texels are "
            "those of another texture."
        )
    plot = {"kind": "bars", "columns": ["error then"], "y": "relative error at the common time"}
    return Result([Table(title, ["scene", "of", "program"], rows, notes, plot)], versions)
