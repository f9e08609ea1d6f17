"""One inverse problem as all programs get it, in a folder, and the judge of what they find."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

TARGET_SEED, JUDGE_SEED = 1 << 40, 1 << 41  # far from the iterations'
PASS = 64  # samples a pixel of a pass


@dataclass(frozen=True)
class Unknown:
    """A parameter of the scene: where it begins, between which values it is kept, how its step compares to others'.

    Bounds are numbers, or lists of one a channel.
    """

    name: str
    start: np.ndarray
    low: float | list[float] = 0.0
    high: float | list[float] = 1.0
    scale: float = 1.0


@dataclass(frozen=True)
class View:
    """A camera of the scene, by its index or, to judge, any other; and parameters that have other values for it."""

    sensor: int | tr.PerspectiveCamera
    set: dict[str, list[float]] = field(default_factory=dict)


@dataclass
class Task:
    """A scene with the true values, what is unknown, and what is given.

    Args:
        scene: with its integrator and cameras.
        unknowns: what is sought.
        views: of the given pictures.
        held_out: of pictures that nobody is given, by which results are judged.
        integrator: with which Mitsuba finds its gradients.
        target_spp, judge_spp: samples a pixel of given pictures, and of those that judge.
        dark: differences are divided by picture + `dark`; None: not at all.
    """

    scene: tr.Scene
    unknowns: list[Unknown]
    views: list[View]
    held_out: list[View]
    integrator: dict[str, Any]
    target_spp: int = 256
    judge_spp: int = 8
    dark: float | None = None

    def __post_init__(self) -> None:
        self.truth = {u.name: self.scene.get_parameter(u.name).detach().clone() for u in self.unknowns}
        self.renderer = tr.Renderer(self.scene)
        with torch.no_grad():
            self.judged = self._judged(self.truth)

    def picture(self, view: View, values: dict[str, torch.Tensor], spp: int, seed: int, **settings: Any):
        """(H, W, 3) with these values of the unknowns."""
        changed = {name: torch.tensor(value) for name, value in view.set.items()}
        passes = max(1, spp // PASS)
        counts = {"spp": min(spp, PASS), "passes": passes}
        with torch.no_grad():
            return self.renderer(sensor=view.sensor, seed=seed, params={**values, **changed}, **counts, **settings)

    def _judged(self, values: dict[str, torch.Tensor]) -> torch.Tensor:
        return torch.stack([self.picture(view, values, self.judge_spp, JUDGE_SEED) for view in self.held_out])

    def error(self, found: dict[str, np.ndarray]) -> float:
        """Root mean square difference of the held-out pictures from the true ones, relative to those.

        Both have the same random numbers: what differs are the values. Pixels are weighted as in the given pictures.
        """
        pictures = self._judged({name: torch.from_numpy(value) for name, value in found.items()})
        weight = self.weight_of(self.judged)
        return float((weight * (pictures - self.judged)).norm() / (weight * self.judged).norm())

    def weight_of(self, pictures: torch.Tensor) -> torch.Tensor:
        """By what differences from these true pictures are multiplied."""
        return torch.ones_like(pictures) if self.dark is None else 1 / (pictures + self.dark)

    def write(self, folder: Path) -> None:
        """Makes the folder that `inverse_loop` describes."""
        path = folder / "scene.xml"
        self.scene.save(path)
        path.write_text(with_free_sampler(path.read_text()))
        described = {
            "unknowns": [{"name": u.name, "low": u.low, "high": u.high, "scale": u.scale} for u in self.unknowns],
            "views": [{"sensor": v.sensor, "set": v.set} for v in self.views],
            "stride": stride_of(len(self.views)),
            "integrator": self.integrator,
            "target_spp": self.target_spp,
        }
        (folder / "task.json").write_text(json.dumps(described, indent=1))
        np.savez(folder / "start.npz", **{u.name: u.start.astype(np.float32) for u in self.unknowns})
        seeds = range(TARGET_SEED, TARGET_SEED + len(self.views))
        targets = [
            self.picture(view, self.truth, self.target_spp, seed, sampler="sobol")
            for view, seed in zip(self.views, seeds, strict=True)
        ]
        pictures = torch.stack(targets)
        np.save(folder / "targets.npy", pictures.numpy())
        np.save(folder / "weights.npy", self.weight_of(pictures).numpy())


def with_free_sampler(text: str) -> str:
    """The XML of a scene whose cameras have the sampler `$sampler`."""
    text = re.sub(r"<sampler\b[^>]*/>|<sampler\b.*?</sampler>", "", text, flags=re.DOTALL)
    text = text.replace("</sensor>", '<sampler type="$sampler"/></sensor>')
    head = '<scene version="3.0.0">'
    return text.replace(head, f'{head}<default name="sampler" value="independent"/>', 1)


def stride_of(count: int) -> int:
    """A step through so many pictures that comes to each once, and to far ones one after the other."""
    return next(s for s in range(round(count * 0.618) or 1, count + 1) if math.gcd(s, count) == 1)
