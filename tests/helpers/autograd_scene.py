"""A small scene that is differentiated, for tests of autograd."""

from __future__ import annotations

import torch
from small_scene import COLOUR, ball_and_wall

import torchrender as tr


def make(**settings) -> tr.Scene:
    # No roulette: which paths live depends on the colours, and finite differences would see other samples.
    integrator = {"type": "path", "max_depth": 3, "rr_depth": 100}
    lamp = {"type": "point", "position": [0, 1, 3], "intensity": 3.0}
    return tr.load_dict(ball_and_wall(integrator=integrator, lamp=lamp), **settings)


def picture(scene, value=None, name=COLOUR, **settings):
    params = {} if value is None else {"params": {name: value}}
    return tr.render(scene, **{"seed": 1, **params, **settings})


def rand(*shape, dtype=torch.float32, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)
