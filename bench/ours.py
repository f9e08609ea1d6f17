"""The torchrender half of the benchmarks, through its public interface only."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

import torchrender as tr

from .rows import ROWS, Row
from .serving import weight_of


class Ours:
    """A scene that is loaded and ready to be rendered and differentiated in some of its parameters.

    Further settings, such as ``sampler``, go to `torchrender.Renderer`.
    """

    def __init__(self, scene: tr.Scene, parameters: tuple[str, ...], spp: int, **settings: Any) -> None:
        self.scene, self.spp = scene, spp
        self.parameters = [scene.get_parameter(name).requires_grad_() for name in parameters]
        path = tr.PathTracer(max_depth=5, rr_depth=100)
        try:
            self.renderer = tr.Renderer(scene, **{"integrator": path, "spp": spp, **settings})
        except (TypeError, ValueError) as error:
            raise SystemExit(f"{'--set' if settings else '--spp'}: {error}") from error

    @classmethod
    def of_row(cls, row: Row, resolution: int, spp: int, variant: str | None = None, **settings: Any) -> Ours:
        chosen_variant = {} if variant is None else {"variant": variant}
        scene = tr.load_file(row.path, resolution=resolution, spp=spp, **chosen_variant, **row.arguments)
        return cls(scene, row.parameters, spp, **settings)

    def forward(self, seed: int) -> dict[str, float]:
        """Seconds of an image without derivatives."""
        start = time.perf_counter()
        with torch.no_grad():
            self.renderer(seed=seed)
        return {"forward": time.perf_counter() - start}

    def step(self, seed: int, **settings: Any) -> dict[str, float]:
        """Seconds of one forward and one backward pass; the loss is the mean square of the image, or images."""
        for parameter in self.parameters:
            parameter.grad = None
        start = time.perf_counter()
        image = self.renderer(seed=seed, **settings)
        middle = time.perf_counter()
        image.square().mean().backward()
        return {"forward": middle - start, "backward": time.perf_counter() - middle}

    def image(self, seed: int, spp: int, passes: int = 1) -> tuple[np.ndarray, float]:
        """An image (H, W, 3) without derivatives, and the seconds it took."""
        start = time.perf_counter()
        with torch.no_grad():
            image = self.renderer(seed=seed, spp=spp, passes=passes)
        return image.numpy(), time.perf_counter() - start

    def gradient(self, seed: int, spp: int, passes: int = 1) -> tuple[list[np.ndarray], float]:
        """Each parameter's gradient of mean(image * weight), and the seconds it took; the image has one sample."""
        start = time.perf_counter()
        image = self.renderer(seed=seed, spp=1, spp_grad=spp, passes=passes)
        weight = torch.from_numpy(weight_of(*image.shape[:2], np))
        gradients = torch.autograd.grad((image * weight).mean(), self.parameters)
        return [gradient.double().numpy() for gradient in gradients], time.perf_counter() - start


def chosen(options: argparse.Namespace, all_rows: Sequence[Row] = ROWS) -> list[Row]:
    """The rows that `--only` leaves; ends the program if there are none."""
    rows = [row for row in all_rows if options.only.lower() in row.name.lower()]
    if not rows:
        raise SystemExit(
            f"--only: no scene's name contains {options.only!r}: {', '.join(row.name for row in all_rows)}"
        )
    return rows
