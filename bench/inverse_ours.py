"""This renderer's half of the inverse problems: PyTorch's Adam on parameters of the scene."""

from __future__ import annotations

import warnings

import numpy as np
import torch

import torchrender as tr

from .inverse_loop import BETAS, EPSILON, Loop


class OurLoop(Loop):
    """See `Loop`. A setting's "renderer" has further settings of `torchrender.Renderer`."""

    def __init__(self, folder: str) -> None:
        super().__init__(folder)
        self.scene = tr.load_file(self.folder / "scene.xml")
        warnings.filterwarnings("ignore", category=tr.MissingTermWarning)  # no normal turns away from the viewer
        self.images = torch.from_numpy(self.targets)
        self.weight = torch.from_numpy(self.weights)
        self.bounds = {u["name"]: (torch.tensor(u["low"]), torch.tensor(u["high"])) for u in self.task["unknowns"]}

    def _prepare(self) -> None:
        setting = self.setting
        self.unknowns = {}
        for unknown in self.task["unknowns"]:
            parameter = self.scene.get_parameter(unknown["name"])
            with torch.no_grad():
                parameter.requires_grad_().copy_(torch.from_numpy(self.start[unknown["name"]]))
            parameter.grad = None
            self.unknowns[unknown["name"]] = parameter
        groups = [
            {"params": [self.unknowns[unknown["name"]]], "scale": unknown["scale"]} for unknown in self.task["unknowns"]
        ]
        self.optimiser = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON)
        counts = {"spp": setting["spp"], "spp_grad": setting["spp_grad"], "sampler": setting["sampler"]}
        self.renderer = tr.Renderer(self.scene, **counts, **setting.get("renderer", {}))

    def _step(self, view: int, seed: int, rate: float) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = rate * group["scale"]
        self.optimiser.zero_grad()
        place = self.task["views"][view]
        changed = {name: torch.tensor(value) for name, value in place["set"].items()}
        image = self.renderer(sensor=place["sensor"], view=view, seed=seed, params=changed)
        ((image - self.images[view]) * self.weight[view]).square().mean().backward()
        self.optimiser.step()
        with torch.no_grad():
            for name, value in self.unknowns.items():
                value.clamp_(*self.bounds[name])

    def _values(self) -> dict[str, np.ndarray]:
        return {name: value.detach().numpy().copy() for name, value in self.unknowns.items()}
