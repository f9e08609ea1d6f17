"""This renderer's half of the inverse problems whose unknowns are not parameters of the scene."""

from __future__ import annotations

import numpy as np
import torch

import torchrender as tr
from scenes import make_caustics

from .inverse_loop import Grids, Loop, kind_of
from .inverse_ours import OurLoop
from .inverse_shapes import posed

LENS = make_caustics.LENS


class OurBody(OurLoop):
    """Of a mesh that moves."""

    def __init__(self, folder: str) -> None:
        super().__init__(folder)
        self.mesh = self.scene.get_submodule(self.task["moved"])
        self.mesh.compute_normals()  # which follow the vertices
        self.name = f"{self.task['moved']}.vertex_positions"


class OurPose(OurBody):
    """Six numbers, which move a mesh. The mesh of the scene is where none of them moves it."""

    def __init__(self, folder: str) -> None:
        super().__init__(folder)
        self.still = self.scene.get_parameter(self.name).detach().clone()

    def _leaves(self) -> dict[str, torch.Tensor]:
        return {name: torch.nn.Parameter(torch.from_numpy(value.copy())) for name, value in self.start.items()}

    def _params(self) -> dict[str, torch.Tensor]:
        return {self.name: posed(self.leaves["pose"], self.still)}


class OurMesh(OurBody):
    """Vertices in large steps: what is moved are u = (I + lambda L) vertices."""

    adam = staticmethod(tr.optim.UniformAdam)

    def _leaves(self) -> dict[str, torch.Tensor]:
        vertices = torch.from_numpy(self.start[self.name])
        self.smoothing = tr.optim.MeshSmoothing(len(vertices), self.mesh.faces, self.setting["smoothness"])
        return {self.name: torch.nn.Parameter(self.smoothing.to_differential(vertices))}

    def _loss(self, view: int, seed: int) -> torch.Tensor:
        views = self._views()
        vertices = self.smoothing.from_differential(self.leaves[self.name])
        sensors = [self.task["views"][view]["sensor"] for view in views]
        images = self.renderer(sensor=sensors, seed=seed, params={self.name: vertices})
        return ((images - self.images[views]) * self.weight[views]).square().mean()

    def _constrain(self) -> None:
        pass

    def _values(self) -> dict[str, np.ndarray]:
        return {self.name: self.smoothing.from_differential(self.leaves[self.name].detach()).numpy()}


class OurHeights(Grids, OurLoop):
    """Heights coarse to fine, and through large steps: what is moved are u = (I + lambda L) heights."""

    def _load(self) -> tr.Scene:
        coarse = self.sizes[0]
        scene = make_caustics.caustics(torch.zeros(coarse, coarse), resolution=self.targets.shape[1])
        return tr.load_dict(scene)

    def _leaves(self) -> dict[str, torch.Tensor]:
        coarse = self.sizes[0]
        self.smoothing = self._smoothing(coarse)
        heights = tr.optim.resample(torch.from_numpy(self.start[LENS]), (coarse, coarse), "clamp")
        return {LENS: torch.nn.Parameter(self.smoothing.to_differential(heights))}

    def _smoothing(self, size: int) -> tr.optim.GridSmoothing:
        return tr.optim.GridSmoothing(self._lambda(size))

    def _step(self, view: int, seed: int, rate: float) -> None:
        if self._size() > len(self.leaves[LENS]):
            self._grow(self._size())
        super()._step(view, seed, rate)

    def _grow(self, size: int) -> None:
        """A finer grid, with as much of the optimiser's state as there is."""
        shape, u = (size, size), self.leaves[LENS]
        with torch.no_grad():
            heights = tr.optim.resample(self.smoothing.from_differential(u), shape, "clamp")
        self.smoothing = self._smoothing(size)
        u = self.leaves[LENS] = tr.optim.upsample_tensor(u, shape, self.optimiser, wrap_mode="clamp")
        u.data.copy_(self.smoothing.to_differential(heights))

    def _loss(self, view: int, seed: int) -> torch.Tensor:
        image = self.renderer(seed=seed, params={LENS: self.smoothing.from_differential(self.leaves[LENS])})
        target = self.images[view]
        return (image / image.detach().mean() - target / target.mean()).square().mean()

    def _constrain(self) -> None:
        """How thick the plate is does not matter: that the middle of the heights is 0 leaves them the most room."""
        u = self.leaves[LENS]
        heights = self.smoothing.from_differential(u)
        middle = (heights.max() + heights.min()) / 2
        u.copy_(self.smoothing.to_differential((heights - middle).clamp(*self.bounds[LENS])))

    def _values(self) -> dict[str, np.ndarray]:
        heights = self.smoothing.from_differential(self.leaves[LENS].detach())
        heights = heights.clamp(*self.bounds[LENS])  # beyond which smoothing, and what undoes it, may round
        return {LENS: tr.optim.resample(heights, self.start[LENS].shape, "clamp").numpy()}


def loop_of(folder: str) -> Loop:
    """The loop of a task's kind."""
    kinds = {"parameters": OurLoop, "pose": OurPose, "mesh": OurMesh, "heights": OurHeights}
    return kinds[kind_of(folder)](folder)
