"""The torchrender half of the benchmark of moving silhouettes and shadows, through its public interface only."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

from .serving import weight_of
from .visibility_scenes import Moving


class Moved:
    """A scene in which one thing moves; further settings go to `torchrender.Renderer`."""

    def __init__(self, moving: Moving, folder: Path, resolution: int, spp: int, **settings: Any) -> None:
        self.moving, self.spp = moving, spp
        self.scene = tr.load_dict(moving.described(folder, resolution, spp))
        self.start = self.scene.get_parameter(moving.parameter).detach().clone()
        self.change = moving.change(self.start)
        self.incomplete = False  # whether a derivative was said to lack a term
        try:
            self.renderer = tr.Renderer(self.scene, **settings)
            self.without = tr.Renderer(self.scene, **{**settings, "visibility": False})
        except (TypeError, ValueError) as error:
            raise SystemExit(f"--set: {error}") from error

    def at(self, amount: torch.Tensor) -> dict[str, torch.Tensor]:
        """The parameters after a motion by `amount`, a scalar."""
        moved = self.start.double() + amount.double() * self.change
        return {self.moving.parameter: moved.to(self.start.dtype)}

    def derivative(self, seed: int) -> tuple[float, float]:
        """The derivative of mean(image * weight) by the motion, and the seconds of an iteration that needs it.

        These are a new value of the parameter, an image of one sample, and the gradient.
        """
        start = time.perf_counter()
        amount, loss = self._loss(self.renderer, seed)
        (gradient,) = torch.autograd.grad(loss, amount)
        return float(gradient), time.perf_counter() - start

    def passes(self, seed: int) -> tuple[float, float]:
        """Seconds of the pass that makes the derivative, with outlines and without."""
        seconds = []
        for renderer in (self.renderer, self.without):
            amount, loss = self._loss(renderer, seed)
            start = time.perf_counter()
            torch.autograd.grad(loss, amount)
            seconds.append(time.perf_counter() - start)
        return seconds[0], seconds[1]

    def _loss(self, renderer: tr.Renderer, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The motion's amount, and the scalar of an image of one sample."""
        amount = torch.zeros((), requires_grad=True)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", tr.MissingTermWarning)
            image = renderer(seed=seed, spp=1, spp_grad=self.spp, params=self.at(amount))
        if renderer is self.renderer:
            self.incomplete |= any(issubclass(warning.category, tr.MissingTermWarning) for warning in said)
        weight = torch.from_numpy(weight_of(*image.shape[:2], np))
        return amount, (image * weight).mean()
