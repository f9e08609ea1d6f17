"""The inverse problem of caustics: the heights of a plate of glass that throws a picture in colours."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

import torchrender as tr
from scenes import make_caustics

from .caustics import LARGEST, waves
from .inverse_task import JUDGE_SEED, Task, Unknown, Values, View, as_tensors

LENS = make_caustics.LENS


def relative(image: torch.Tensor) -> torch.Tensor:
    """In units of its mean: how bright the lamp is does not matter."""
    return image / image.mean()


@dataclass
class CausticTask(Task):
    """Heights, judged by what they throw, rendered with many samples and other random numbers.

    The picture that is wanted is drawn, not thrown: which heights come nearest to it, nobody knows.
    """

    resolution: int = 128  # pixels along a side of the picture
    kind: ClassVar[str] = "heights"

    @property
    def size(self) -> int:
        return len(self.unknowns[0].start)

    def _truth(self) -> Values:
        return {}

    def picture(self, view: View, values: Values, spp: int, seed: int, **settings: Any) -> torch.Tensor:
        """(H, W, 3) in units of its mean: what these heights throw, or the one that is wanted where there are none."""
        if not values:
            return self.wanted
        return relative(super().picture(view, values, spp, seed, **settings))

    def _judged(self, values: Values) -> torch.Tensor:
        """Two pictures with independent samples; the wanted one twice where there are no heights."""
        self.wanted = relative(torch.from_numpy(make_caustics.target(self.resolution)))
        return torch.stack([self.picture(self.views[0], values, self.judge_spp, JUDGE_SEED + i) for i in range(2)])

    def error(self, found: dict[str, np.ndarray]) -> float:
        """Root mean square difference from the wanted picture, relative to that.

        The product of two pictures' differences has the noise of neither in its mean.
        """
        one, two = self._judged(as_tensors(found)) - self.judged
        return float((one * two).mean().clamp(min=0).sqrt() / self.judged.square().mean().sqrt())

    def shown(self, found: Sequence[dict[str, np.ndarray]]) -> torch.Tensor:
        """The wanted picture and those that are thrown; below, the heights."""
        thrown = [self.picture(self.views[0], values, 512, 0) for values in ({}, *map(as_tensors, found))]
        size = len(self.wanted)

        def as_picture(heights: torch.Tensor) -> torch.Tensor:
            small = torch.nn.functional.interpolate(heights.flip(0)[None, None], (size, size), mode="area")[0, 0]
            return ((small - small.min()) / (small.max() - small.min()).clamp(min=1e-12))[..., None].expand(-1, -1, 3)

        heights = [torch.zeros(size, size, 3), *(as_picture(torch.from_numpy(each[LENS])) for each in found)]
        return torch.cat([torch.cat(thrown, 1) * 0.4, torch.cat(heights, 1)])

    def _write_scene(self, folder: Path) -> None:
        """What `mitsuba_caustics.py` reads."""
        np.save(folder / "heights.npy", waves(self.size))
        np.save(folder / "target.npy", self.wanted.numpy())
        scene = make_caustics.caustics(None, resolution=len(self.wanted))
        (folder / "scene.json").write_text(json.dumps(scene, default=lambda array: array.tolist()))

    def _described(self) -> dict[str, Any]:
        described = {"size": self.size, "coarsest": min(32, self.size // 2), "front": make_caustics.FACING_DOWN}
        return {**super()._described(), **described}

    def _targets(self) -> torch.Tensor:
        return self.wanted[None]

    def _reference(self, targets: torch.Tensor) -> torch.Tensor:
        """What the waves of `heights.npy` throw."""
        return self.picture(self.views[0], {LENS: torch.from_numpy(waves(self.size))}, self.judge_spp, 0)


def caustic(quick: bool) -> Task:
    """A plate that throws a coloured picture, from a flat one."""
    size, resolution = (32, 16) if quick else (512, 128)
    start = np.zeros((size, size), np.float32)
    scene = tr.load_dict(make_caustics.caustics(torch.from_numpy(start), resolution=resolution))
    unknown = Unknown(LENS, start, low=-LARGEST, high=LARGEST)
    view = View(0)
    judge_spp = 16 if quick else 64
    return CausticTask(
        scene, [unknown], [view], [view], {"type": "ptracer"}, judge_spp=judge_spp, resolution=resolution
    )
