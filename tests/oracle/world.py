"""A scene as the native renderer gets it, with tensors that everything is attached to."""

from __future__ import annotations

from collections.abc import Mapping

import torch

import torchrender as tr
from torchrender.scene.gather import gather
from torchrender.wavefront.world import World as Traced


class World(Traced):
    """A packed scene with tensors in its slots, those of `params` in place of its own."""

    def __init__(self, scene: tr.Scene, params: Mapping[str, torch.Tensor] | None = None) -> None:
        layout = scene.layout()
        tensors = gather(scene, layout, params)
        native = scene.native(layout, [tuple(t.shape) for t in tensors])
        super().__init__(scene, layout, native, tensors, moving=True)
