"""One inverse problem as all programs get it, in a folder, and the judge of what they find."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

import torchrender as tr

TARGET_SEED, JUDGE_SEED = 1 << 40, 1 << 41  # far from the iterations'
PASS = 64  # samples a pixel of a pass

Values = dict[str, torch.Tensor]  # of the unknowns, or of parameters of the scene


@dataclass(frozen=True)
class Unknown:
    """A parameter of the scene: where it begins, between which values it is kept, how its step compares to others'.

    Bounds are numbers, or lists of one a channel. The light of pictures is nearly in proportion to what is `linear`.
    """

    name: str
    start: np.ndarray
    low: float | list[float] = 0.0
    high: float | list[float] = 1.0
    scale: float = 1.0
    linear: bool = False


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

    kind: ClassVar[str] = "parameters"

    def __post_init__(self) -> None:
        self.renderer = tr.Renderer(self.scene)
        self.truth = self._truth()
        with torch.no_grad():
            self.judged = self._judged(self.truth)

    def _truth(self) -> Values:
        return {u.name: self.scene.get_parameter(u.name).detach().clone() for u in self.unknowns}

    def params_of(self, values: Values) -> Values:
        """The parameters of the scene that follow from the unknowns."""
        return values

    def picture(self, view: View, values: Values, spp: int, seed: int, **settings: Any) -> torch.Tensor:
        """(H, W, 3) with these values of the unknowns."""
        changed = {name: torch.tensor(value) for name, value in view.set.items()}
        passes = max(1, spp // PASS)
        counts = {"spp": min(spp, PASS), "passes": passes}
        params = {**self.params_of(values), **changed}
        with torch.no_grad():
            return self.renderer_of(values)(sensor=view.sensor, seed=seed, params=params, **counts, **settings)

    def renderer_of(self, values: Values) -> tr.Renderer:
        """Of the scene in which these values are."""
        return self.renderer

    def _judged(self, values: Values) -> torch.Tensor:
        return torch.stack([self.picture(view, values, self.judge_spp, JUDGE_SEED) for view in self.held_out])

    def error(self, found: dict[str, np.ndarray]) -> float:
        """Root mean square difference of the held-out pictures from the true ones, relative to those.

        Both have the same random numbers: what differs are the values. Pixels are weighted as in the given pictures.
        """
        pictures = self._judged(as_tensors(found))
        weight = self.weight_of(self.judged)
        return float((weight * (pictures - self.judged)).norm() / (weight * self.judged).norm())

    def weight_of(self, pictures: torch.Tensor) -> torch.Tensor:
        """By what differences from these true pictures are multiplied."""
        return torch.ones_like(pictures) if self.dark is None else 1 / (pictures + self.dark)

    def shown(self, found: Sequence[dict[str, np.ndarray]]) -> torch.Tensor:
        """The first given and the first held-out picture: the truth, then what each program found."""
        values = [self.truth, *map(as_tensors, found)]
        rows = [
            torch.cat([self.picture(view, each, 64, 0) for each in values], 1)
            for view in (self.views[0], self.held_out[0])
        ]
        width = max(row.shape[1] for row in rows)
        return torch.cat([torch.nn.functional.pad(row, (0, 0, 0, width - row.shape[1])) for row in rows])

    def write(self, folder: Path) -> None:
        """Makes the folder that `inverse_loop` describes."""
        self._write_scene(folder)
        (folder / "task.json").write_text(json.dumps(self._described(), indent=1))
        np.savez(folder / "start.npz", **{u.name: u.start.astype(np.float32) for u in self.unknowns})
        targets = self._targets()
        for name, pictures in {"targets": targets, "weights": self.weight_of(targets)}.items():
            np.save(folder / f"{name}.npy", pictures.numpy())
        np.save(folder / "reference.npy", self._reference(targets).numpy())

    def _write_scene(self, folder: Path) -> None:
        path = folder / "scene.xml"
        self.scene.save(path)
        path.write_text(with_free_sampler(path.read_text()))

    def _described(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "unknowns": [
                {"name": u.name, "low": u.low, "high": u.high, "scale": u.scale, "linear": u.linear}
                for u in self.unknowns
            ],
            "views": [{"sensor": v.sensor, "set": v.set} for v in self.views],
            "stride": stride_of(len(self.views)),
            "integrator": self.integrator,
            "target_spp": self.target_spp,
        }

    def _targets(self) -> torch.Tensor:
        """The given pictures."""
        seeds = range(TARGET_SEED, TARGET_SEED + len(self.views))
        pictures = [
            self.picture(view, self.truth, self.target_spp, seed, sampler="sobol")
            for view, seed in zip(self.views, seeds, strict=True)
        ]
        return torch.stack(pictures)

    def _reference(self, targets: torch.Tensor) -> torch.Tensor:
        """The first view's picture of the scene as it is in its file."""
        return targets[0]


def as_tensors(found: dict[str, np.ndarray]) -> Values:
    return {name: torch.from_numpy(value) for name, value in found.items()}


def camera(origin: tuple[float, float, float], fov: float, resolution: int, at=(0.0, 0.0, 0.0)) -> tr.PerspectiveCamera:
    """One that looks at a point, with a square film."""
    return tr.PerspectiveCamera.look_at(origin, at, fov=fov, size=(resolution, resolution), filter="box")


def around(azimuth: float, elevation: float, distance: float) -> tuple[float, float, float]:
    """A place around the origin; angles in degrees, azimuth 0 on the +z axis."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return distance * math.cos(e) * math.sin(a), distance * math.sin(e), distance * math.cos(e) * math.cos(a)


def with_free_sampler(text: str) -> str:
    """The XML of a scene whose cameras have the sampler `$sampler`."""
    text = re.sub(r"<sampler\b[^>]*/>|<sampler\b.*?</sampler>", "", text, flags=re.DOTALL)
    text = text.replace("</sensor>", '<sampler type="$sampler"/></sensor>')
    head = '<scene version="3.0.0">'
    return text.replace(head, f'{head}<default name="sampler" value="independent"/>', 1)


def stride_of(count: int) -> int:
    """A step through so many pictures that comes to each once, and to far ones one after the other."""
    return next(s for s in range(round(count * 0.618) or 1, count + 1) if math.gcd(s, count) == 1)
