"""Scenes at the edge of what makes sense, and the check that their images and gradients are finite."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch

import torchrender as tr
from torchrender.scene.declaration import models

VARIANTS = [("mono", torch.float32), ("rgb", torch.float32), ("rgb", torch.float64)]
AROUND = ("twosided", "blendbsdf", "mask", "normalmap", "bumpmap")  # others: test_layers.py
BSDFS = [kind for category, kind in models() if category == "bsdf" and kind not in ("null", *AROUND)]
variants = pytest.mark.parametrize(("variant", "dtype"), VARIANTS, ids=["mono", "rgb", "double"])


def camera(origin=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), size: int = 16, scale: float = 1.0) -> dict:
    to_world = tr.Transform.look_at([scale * x for x in origin], [scale * x for x in target], list(up))
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    clip = {"near_clip": 1e-3 * scale, "far_clip": 1e4 * scale}
    return {"type": "perspective", "fov": 40, "to_world": to_world, "film": film, **clip}


def load(objects: dict, variant: str = "rgb", dtype: torch.dtype = torch.float32, **settings) -> tr.Scene:
    return tr.load_dict({"type": "scene", "camera": camera(), **objects}, variant=variant, dtype=dtype, **settings)


def differentiable(scene: tr.Scene) -> dict[str, torch.nn.Parameter]:
    """All parameters of the scene that have a derivative."""
    refusals = {slot.name: slot.refusal for slot in scene.layout().slots}
    return {n: p for n, p in scene.named_parameters() if not refusals.get(n, "not rendered")}


def check(scene: tr.Scene, spp: int = 16, integrator: tr.PathTracer | None = None, **settings: Any) -> torch.Tensor:
    """Render and differentiate with respect to everything: all finite, and no sample that was not. The image."""
    integrator = integrator or tr.PathTracer(max_depth=6, rr_depth=3)
    chosen = differentiable(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # terms of derivatives that are missing are not the subject
        for parameter in chosen.values():
            parameter.requires_grad_()
        image = tr.render(scene, spp=spp, seed=7, integrator=integrator, nan="raise", **settings)
        assert torch.isfinite(image).all()
        if image.requires_grad:
            found = torch.autograd.grad(image.sum(), list(chosen.values()), allow_unused=True)
            for name, gradient in zip(chosen, found, strict=True):
                assert gradient is None or torch.isfinite(gradient).all(), name
    return image.detach()


SKY = {"type": "constant", "radiance": 1.0}
FLOOR = {"type": "rectangle", "to_world": tr.Transform.scale(1.5)}  # in z = 0, towards the camera
LAMP = {
    "type": "rectangle",
    "to_world": tr.Transform.translate([0, 0, 2]).rotate([0, 1, 0], 180).scale(0.3),
    "emitter": {"type": "area", "radiance": 3.0},
}


# -------------------------------------------------------------------------------------------------------- geometry
DEGENERATE = {
    "an index twice": ([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2], [0, 0, 1], [2, 2, 2]]),
    "in a line": ([[-1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
    "all in a point": ([[0, 0, 0]] * 3, [[0, 1, 2]]),
    "slivers": ([[-1, 0, 0], [1, 0, 0], [0, 1e-20, 0], [0, 1e-7, 0]], [[0, 1, 2], [0, 1, 3]]),
    "nearly nothing": ([[1e-30, 0, 0], [0, 1e-30, 0], [0, 0, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [2, 3, 4]]),
    "unused vertices": ([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [9, 9, 9]], [[0, 1, 2]]),
}
