"""This renderer's half of the inverse problems: Adam or `tr.optim.LeastSquares` on parameters of the scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch

import torchrender as tr

from .inverse_loop import BETAS, EPSILON, Loop


class OurLoop(Loop):
    """See `Loop`. A setting's "renderer" has further settings of `torchrender.Renderer`.

    With "damping" in it unknowns that light is linear in are moved by `LeastSquares`, whose damping it is, in place
    of Adam; with "signs" so are the others, by random signs with that damping and so many "probes".

    Of other kinds are its subclasses in `inverse_ours_kinds.py`, which have other leaves of the derivative (`_leaves`),
    from which the scene's parameters follow (`_params`).
    """

    adam: Callable[..., torch.optim.Optimizer] = staticmethod(partial(torch.optim.Adam, fused=True))

    def __init__(self, folder: str) -> None:
        super().__init__(folder)
        self.scene = self._load()
        warnings.filterwarnings("ignore", category=tr.MissingTermWarning)  # no normal turns away from the viewer
        self.images = torch.from_numpy(self.targets)
        self.weight = torch.from_numpy(self.weights)
        self.bounds = {u["name"]: (torch.tensor(u["low"]), torch.tensor(u["high"])) for u in self.task["unknowns"]}

    def _load(self) -> tr.Scene:
        return tr.load_file(self.folder / "scene.xml")

    def _leaves(self) -> dict[str, torch.Tensor]:
        """What the optimiser moves, at the start, by the names of the unknowns."""
        leaves = {}
        for unknown in self.task["unknowns"]:
            parameter = self.scene.get_parameter(unknown["name"])
            with torch.no_grad():
                parameter.requires_grad_().copy_(torch.from_numpy(self.start[unknown["name"]]))
            parameter.grad = None
            leaves[unknown["name"]] = parameter
        return leaves

    def _params(self) -> Mapping[str, torch.Tensor]:
        """Parameters of the scene that follow from the leaves."""
        return {}

    def _prepare(self) -> None:
        setting = self.setting
        self.leaves = self._leaves()
        by_adam: list[dict[str, Any]] = []
        by_squares: list[dict[str, Any]] = []
        for unknown in self.task["unknowns"]:
            group = {"params": [self.leaves[unknown["name"]]]}
            curvature, damping = ("light", "damping") if unknown["linear"] else ("signs", "signs")
            if damping in setting:
                probes = {name: setting[name] for name in ("probes",) if name in setting}
                by_squares.append({**group, **probes, "curvature": curvature, "damping": setting[damping]})
            else:
                by_adam.append({**group, "scale": unknown["scale"]})
        self.optimiser = self.adam(by_adam, lr=1.0, betas=BETAS, eps=EPSILON) if by_adam else None
        self.squares = tr.optim.LeastSquares(by_squares) if by_squares else None
        torch.manual_seed(self.seed)  # of the signs
        counts = {"spp": setting["spp"], "spp_grad": setting["spp_grad"], "sampler": setting["sampler"]}
        self.renderer = tr.Renderer(self.scene, **counts, **setting.get("renderer", {}))

    def _step(self, view: int, seed: int, rate: float) -> None:
        for leaf in self.leaves.values():
            leaf.grad = None
        if self.squares:
            self.squares.step(*self._compared(view, seed))
        else:
            self._loss(view, seed).backward()
        if self.optimiser:
            for group in self.optimiser.param_groups:
                group["lr"] = rate * group["scale"]
            self.optimiser.step()
        with torch.no_grad():
            self._constrain()

    def _loss(self, view: int, seed: int) -> torch.Tensor:
        """What falls, of the picture of a view."""
        image, target, weight = self._compared(view, seed)
        return ((image - target) * weight).square().mean()

    def _compared(self, view: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The picture of a view, or its chosen pixels; what they should be; by what differences are multiplied."""
        place = self.task["views"][view]
        changed: dict[str, Any] = {name: torch.tensor(value) for name, value in place["set"].items()}
        pixels = self._pixels(seed)
        image = self.renderer(
            sensor=place["sensor"], view=view, seed=seed, params={**self._params(), **changed}, pixels=pixels
        )
        target, weight = self.images[view], self.weight[view]
        if pixels is not None:
            chosen = torch.from_numpy(pixels[:, 0] * target.shape[1] + pixels[:, 1])
            target, weight = (whole.flatten(0, 1)[chosen] for whole in (target, weight))
        return image, target, weight

    def _constrain(self) -> None:
        for name, value in self.leaves.items():
            value.clamp_(*self.bounds[name])

    def _values(self) -> dict[str, np.ndarray]:
        return {name: value.detach().numpy().copy() for name, value in self.leaves.items()}
