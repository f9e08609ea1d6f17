"""The torchrender half of the benchmarks, through its public interface only."""

from __future__ import annotations

import time
from statistics import median

import torch

import torchrender as tr

from .mitsuba_server import weight_of
from .rows import Row


class Ours:
    """One row's scene, loaded and ready to render and differentiate."""

    def __init__(self, row: Row, resolution: int, spp: int) -> None:
        self.scene = tr.load_file(row.path, resolution=resolution, spp=spp, **row.arguments)
        self.spp = spp
        self.parameters = [self.scene.get_parameter(name).requires_grad_() for name in row.parameters]
        self.renderer = tr.Renderer(self.scene, integrator=tr.PathTracer(max_depth=5, rr_depth=100), spp=spp)

    def step(self, seed: int) -> dict[str, float]:
        """Seconds of one forward and one backward pass; the loss is the mean square of the image."""
        for parameter in self.parameters:
            parameter.grad = None
        start = time.perf_counter()
        image = self.renderer(seed=seed)
        middle = time.perf_counter()
        image.square().mean().backward()
        return {"forward": middle - start, "backward": time.perf_counter() - middle}

    def embree_seconds(self, rounds: int) -> float:
        """Median seconds inside Embree's queries during one forward and one backward pass, mean over the threads."""
        samples = []
        for seed in range(rounds):
            image = self.renderer(seed=seed)
            image.square().mean().backward()
            samples.append(sum(self.scene.statistics[kind]["seconds_trace"] for kind in ("render", "vjp")))
        return median(samples) / torch.get_num_threads()

    def gradient(self, seed: int) -> dict:
        """Sums over the entries of each parameter's gradient of mean(image * weight), and the seconds it took."""
        import numpy as np

        start = time.perf_counter()
        image = self.renderer(seed=seed, spp=1, spp_grad=self.spp)
        weight = torch.from_numpy(weight_of(*image.shape[:2], np))
        gradients = torch.autograd.grad((image * weight).mean(), self.parameters)
        seconds = time.perf_counter() - start
        return {"sums": [float(gradient.double().sum()) for gradient in gradients], "seconds": seconds}
