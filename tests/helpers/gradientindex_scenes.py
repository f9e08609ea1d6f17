"""Scenes with media that light bends in."""

from __future__ import annotations

import torch
from bent_scenes import BOX, DOUBLE, difference, in_both_modes

import torchrender as tr
from scenes.make_grin import beam_and_screen

T = tr.Transform
INDEX = "lens.interior_medium.index"


def colours() -> torch.Tensor:
    """A sky that is different everywhere."""
    y, x = torch.meshgrid(torch.arange(16.0), torch.arange(32.0), indexing="ij")
    return torch.stack([1 + torch.sin(x * 0.4), 1 + torch.cos(y * 0.5), 1 + torch.sin(x * 0.2 + y * 0.3)], -1)


def seen(index, bsdf: str = "null", shape: str = "sphere", size: int = 12, back: dict | None = None, **medium):
    """A lens before a sky, or before something else, that a camera sees."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    interior = {"type": "gradientindex", "index": index, "to_world": BOX, "ext_ior": 1.0, **medium}
    described = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "lens": {"type": shape, "interior": interior, "bsdf": {"type": bsdf}},
        "camera": {
            "type": "perspective",
            "fov": 30,
            "to_world": T.look_at([3, 2, 4], [0, 0, 0], [0, 1, 0]),
            "film": film,
        },
        **(back or {"sky": {"type": "envmap", "bitmap": colours()}}),
    }
    return tr.load_dict(described, dtype=DOUBLE)


def thrown(index, bsdf: str = "null", size: int = 16, dtype: torch.dtype = DOUBLE, **medium) -> tr.Scene:
    """A beam through a cube, onto a screen that measures it; its edges stay within both."""
    interior = {"type": "gradientindex", "index": index, "to_world": T.translate([-0.5] * 3), "ext_ior": 1.0, **medium}
    screen = T.translate([0, 0, 1.0]) @ T.rotate([0, 1, 0], 180)
    film = {"width": size, "height": size, "rfilter": {"type": "gaussian"}}
    lens = {"type": "cube", "to_world": T.scale(0.5), "interior": interior, "bsdf": {"type": bsdf}}
    return tr.load_dict({**beam_and_screen(0.4, -1, screen, film), "lens": lens}, dtype=dtype)


def direction_of(value: torch.Tensor) -> torch.Tensor:
    """Some change of a parameter; of matrices one that leaves lengths of columns, and with them the steps, alone."""
    change = torch.randn(value.shape, generator=torch.Generator().manual_seed(7), dtype=DOUBLE)
    if value.shape == (4, 4):
        change = change.clone()
        change[3] = 0
        change.fill_diagonal_(0)
    return change


def derivatives(scene: tr.Scene, name: str, spp: int = 4, **settings) -> tuple[float, float, float]:
    """In reverse and forward mode and by differences, with the same random numbers, of a weighted sum of pixels."""
    value = scene.get_parameter(name).detach()
    along = direction_of(value)
    weight: list[torch.Tensor] = []

    def f(x: torch.Tensor) -> torch.Tensor:
        image = tr.render(scene, spp=spp, seed=3, correlated=True, params={name: x}, **settings)
        if not weight:
            weight.append(torch.rand(image.shape, generator=torch.Generator().manual_seed(5), dtype=DOUBLE))
        return (image * weight[0]).sum()

    reverse, forward = in_both_modes(f, value, along)
    with torch.no_grad():
        return reverse, forward, difference(f, value, along, 1e-6)
