"""The scenes with participating media, for this renderer and for peers that read their files."""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr
from scenes import make_media

from .arguments import positive
from .measured import Measured
from .ours import Ours
from .peers import KNOWN, Peer, PeerError
from .report import Table
from .rows import SCENES

RR_DEPTH = 5


@dataclass(frozen=True)
class Medium:
    """A scene file, the volume in it that is differentiated, and how deep paths go."""

    file: str
    argument: str  # the scene's `$parameter` that names the volume's file
    parameter: str
    make: Callable[..., np.ndarray]  # of the numbers of voxels
    max_depth: int


CLOUD = Medium("cloud.xml", "density", "cloud.interior_medium.sigma_t.data", make_media.cloud, 256)
SMOKE = Medium("smoke.xml", "density", "smoke.interior_medium.sigma_t.data", make_media.smoke, 256)
SLAB = Medium("slab.xml", "albedo", "slab.interior_medium.albedo.data", make_media.slab_albedo, 1024)


class Loaded:
    """A scene with its volume in a file, which peers can read too; in a ``with`` block."""

    def __init__(self, medium: Medium, *size: int) -> None:
        self.medium, self.volume = medium, medium.make(*size)

    def __enter__(self) -> Loaded:
        self.folder = tempfile.TemporaryDirectory(prefix="bench-")
        self.path = Path(self.folder.name)
        tr.io.write_volume(self.path / "volume.vol", torch.from_numpy(self.volume.copy()))
        return self

    def __exit__(self, *_: object) -> None:
        self.folder.cleanup()

    def arguments(self) -> dict[str, Any]:
        """What fills the file's `$parameters`."""
        volume = {self.medium.argument: str(self.path / "volume.vol")}
        return {**volume, "max_depth": self.medium.max_depth, "rr_depth": RR_DEPTH}

    def ours(self, options: argparse.Namespace, spp: int, **settings: Any) -> Ours:
        """This renderer's, ready; the file names the integrator."""
        scene = tr.load_file(SCENES / self.medium.file, resolution=options.resolution, **self.arguments())
        settings = {"integrator": None, **settings, **dict(options.renderer)}
        return Ours(scene, (self.medium.parameter,), spp, **settings)

    def load_peer(self, peer: Peer, options: argparse.Namespace, spp: int) -> None:
        """Let a peer load it, to be differentiated by its integrator for that. PeerError if it has no media."""
        if KNOWN[peer.name].reads_arrays:
            raise PeerError(f"{peer.title} has no participating media")
        arguments = {name: str(value) for name, value in self.arguments().items()}
        integrator = {"type": "prbvolpath", "max_depth": self.medium.max_depth, "rr_depth": RR_DEPTH}
        peer.ask(
            "load",
            path=str(SCENES / self.medium.file),
            arguments=arguments,
            parameters=[self.medium.parameter],
            resolution=options.resolution,
            spp=spp,
            arrays=None,
            integrator=integrator,
        )


def iteration(ours: Ours, seed: int, **settings: Any) -> dict[str, float]:
    """Seconds of one iteration, and what was not finite in it: samples, which were dropped, entries of gradients."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # they are counted
        found = ours.step(seed, **settings)
    samples = sum(int(ours.scene.statistics[kind].get("nonfinite", 0)) for kind in ("render", "vjp"))
    entries = sum(int((~torch.isfinite(parameter.grad)).sum()) for parameter in ours.parameters)
    return {**found, "bad image": float(samples), "bad gradient": float(entries)}


def media_arguments(parser: argparse.ArgumentParser, spp_grad: int, passes: int) -> None:
    """What an iteration consists of, besides `--spp`."""
    parser.add_argument(
        "--spp-grad", type=positive, default=spp_grad, help="samples of the derivative in a pass (default %(default)s)"
    )
    parser.add_argument("--passes", type=positive, default=passes, help="passes (default %(default)s)")


def iteration_table(found: dict[str, dict[str, list[float]]], label: str, title: str, notes: list[str]) -> Table:
    """A row of medians for each program, by its name; the first one is ours."""
    rows: list[dict[str, Any]] = []
    for who, values in found.items():
        values["sum"] = [a + b for a, b in zip(values["forward"], values["backward"], strict=True)]
        row: dict[str, Any] = {"scene": label, "program": who}
        for name in ("forward", "backward", "sum"):
            row[f"{name} s"] = Measured.of(values[name])
        for name in ("forward", "sum"):
            row[f"{name} / ours"] = row[f"{name} s"].median / rows[0][f"{name} s"].median if rows else 1.0
        for name in ("image", "gradient"):
            row[f"not finite, {name}"] = int(sum(values[f"bad {name}"]))
        rows.append(row)
    notes = [
        *notes,
        "Not finite, in all rounds together: pixels (ours: samples, which are dropped), entries of gradients.",
    ]
    plot = {"kind": "bars", "columns": ["forward s", "backward s"], "y": "one iteration, s"}
    return Table(title, ["scene", "program"], rows, notes, plot, part="iteration")
