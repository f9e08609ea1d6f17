"""Rays through a cube of glass whose index varies, by the core and by PyTorch alone, for `gradient_index.py`."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

import torchrender as tr
from scenes import make_grin
from torchrender.gradientindex import flights

INDEX = "cube.interior_medium.index"


def index_of(size: int) -> torch.Tensor:
    """(size, size, size) indices around 1.5, with waves of 16 to 70 voxels."""
    axis = torch.arange(size, dtype=torch.float32)
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    long = torch.sin(0.11 * x + 1) * torch.sin(0.13 * y) * torch.cos(0.09 * z)
    return 1.5 + 0.02 * (long + 0.5 * torch.sin(0.31 * x + 0.2 * y) * torch.sin(0.17 * z + 0.29 * y))


def cube(index: torch.Tensor, dtype: torch.dtype = torch.float32, **medium: Any) -> tr.Scene:
    """The cube [-1, 1]^3 with this index, in air."""
    to_world = tr.Transform.translate([-1, -1, -1]) @ tr.Transform.scale(2)
    interior = {"type": "gradientindex", "index": index, "to_world": to_world, "max_steps": 1_000_000, **medium}
    shape = {"type": "cube", "bsdf": {"type": "dielectric"}, "interior": interior}
    return tr.load_dict({"type": "scene", "cube": shape}, dtype=dtype)


def beam(resolution: int, spp: int, view: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Origins and directions (resolution^2 * spp, 3) along z (view 0) or x, samples of a pixel one after another."""
    pixel = torch.arange(resolution, dtype=torch.float32)
    corner = torch.stack(torch.meshgrid(pixel, pixel, indexing="ij"), -1).reshape(-1, 1, 2)
    place = corner + torch.rand(resolution**2, spp, 2, generator=torch.Generator().manual_seed(view))
    place = (place / resolution - 0.5).reshape(-1, 2) * 1.9
    origins = torch.nn.functional.pad(place, (0, 1), value=-3.0).roll(view, 1)
    directions = torch.tensor([0.0, 0.0, 1.0]).roll(view).expand_as(origins).contiguous()
    return origins, directions


def pictures(index: torch.Tensor, resolution: int, interpolation: str) -> list[tr.Scene]:
    """Two scenes: the cube throws a picture along z, and along x."""
    turns = (tr.Transform(), tr.Transform.rotate([0, 1, 0], 90))
    return [tr.load_dict(make_grin.grin_cube(turn, index, resolution, interpolation)) for turn in turns]


def light(scenes: list[tr.Scene], leaf: torch.Tensor, spp: int, spp_grad: int, passes: int) -> None:
    """Renders the pictures and the derivative of their mean square."""
    leaf.grad = None
    for scene in scenes:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tr.MissingTermWarning)
            samples = {"spp": spp, "spp_grad": spp_grad, "passes": passes}
            image = tr.render(scene, seed=0, params={INDEX: leaf}, sampler="stratified", **samples)
            image.square().mean().backward()


@contextmanager
def native_seconds() -> Iterator[dict[str, float]]:
    """Adds up the seconds of calls of the core within, by what they do ("trace", "reverse")."""
    found: dict[str, float] = {}
    original = flights.Bending.call

    def timed(self: flights.Bending, what: str, *arguments: Any, **named: Any) -> None:
        start = time.perf_counter()
        original(self, what, *arguments, **named)
        found[what] = found.get(what, 0.0) + time.perf_counter() - start

    flights.Bending.call = timed
    try:
        yield found
    finally:
        flights.Bending.call = original


def loss_of(position: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """A function of where rays come out and whereto."""
    return (torch.sin(3 * position) + torch.cos(2 * direction)).mean()


def iteration(scene: tr.Scene, index: torch.Tensor, views: list[tuple[torch.Tensor, torch.Tensor]]) -> dict[str, float]:
    """Seconds of rays and adjoint of all views, of that in the core, and all steps; the gradient is left in `index`."""
    index.grad = None
    found = {"forward": 0.0, "backward": 0.0, "steps": 0.0}
    with native_seconds() as native:
        for origins, directions in views:
            start = time.perf_counter()
            rays = tr.gradientindex.trace(scene, "cube", origins, directions, params={INDEX: index})
            traced = time.perf_counter()
            loss_of(rays.position, rays.direction).backward()
            found["forward"] += traced - start
            found["backward"] += time.perf_counter() - traced
            found["steps"] += float(rays.steps.sum())
    return {**found, "core forward": native["trace"], "core backward": native["reverse"]}


def in_torch(
    index: torch.Tensor,
    origins: torch.Tensor,
    directions: torch.Tensor,
    step: float = 1.0,
    interpolation: str = "cubic",
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """The rays along z of `trace`, by operations of PyTorch: positions and directions behind the cube, and steps.

    The same scheme: velocity Verlet, and at the end a kick of what is left of a step. Rays must leave at z = 1.
    """

    def field(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        n, slope = tr.gradientindex.evaluate(index, (x + 1) / 2, interpolation)
        return n, n[:, None] * slope / 2

    ext_ior = 1.000277
    dt = step * (2 / index.shape[0]) / (math.ceil(float(index.detach().amax()) * 16) / 16)
    x = origins + (-1 - origins[:, 2:]) / directions[:, 2:] * directions
    n, force = field(x)
    across = ext_ior * directions[:, :2]
    p = torch.cat([across, torch.sqrt(n**2 - across.square().sum(1))[:, None]], 1)
    p = p + 0.5 * dt * force
    steps = 0
    while True:
        flying = x[:, 2] + dt * p[:, 2] < 1
        if not bool(flying.any()):
            break
        x = torch.where(flying[:, None], x + dt * p, x)
        p = torch.where(flying[:, None], p + dt * field(x)[1], p)
        steps += 1
    rest = (1 - x[:, 2]) / p[:, 2]
    x = x + rest[:, None] * p
    n, force = field(x)
    p = p + (rest - 0.5 * dt)[:, None] * force
    across = (torch.nn.functional.normalize(p, dim=1) * n[:, None])[:, :2] / ext_ior
    return x, torch.cat([across, torch.sqrt(1 - across.square().sum(1))[:, None]], 1), steps
