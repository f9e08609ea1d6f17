"""Derivatives of Stokes images: reverse mode, forward mode and central differences, in a room of a ball and a floor."""

from __future__ import annotations

import numpy as np
import torch
from torch.autograd import forward_ad

import torchrender as tr

T = tr.Transform


def sky() -> torch.Tensor:
    row, column = np.linspace(0, np.pi, 33)[:, None], np.linspace(0, 2 * np.pi, 64, endpoint=False)[None]
    smooth = 1 + 0.6 * np.sin(row) * np.cos(column + 1) + 0.3 * np.cos(row)
    return torch.tensor(smooth[..., None], dtype=torch.float64)


def room(ball: dict, floor: dict, **more) -> tr.Scene:
    """The middle of a ball, which mirrors a floor."""
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    pose = T.look_at([3, -3.5, 2], [0.2, 0.1, -0.3], [0.3, 0.1, 1])
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 7, "rr_depth": 100},
            "sensor": {"type": "perspective", "fov": 8, "to_world": pose, "film": film},
            "sky": {"type": "envmap", "bitmap": sky()},
            "floor": {"type": "rectangle", "to_world": T.translate([0, 0, -1.1]) @ T.scale(50), "bsdf": floor},
            "ball": {"type": "sphere", "bsdf": ball},
            **more,
        },
        dtype=torch.float64,
    )


def image(scene: tr.Scene, name: str, value: torch.Tensor, seed: int = 3, spp: int = 16) -> torch.Tensor:
    """Of the same samples, whose differences do not have the motion of edges."""
    settings = {"spp": spp, "seed": seed, "correlated": True, "visibility": False}
    return tr.render(scene, params={name: value}, outputs=("stokes",), **settings).stokes


def modes(scene: tr.Scene, name: str, direction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The value of the parameter, and the image's derivative; reverse and forward mode are compared."""
    base = dict(scene.named_parameters())[name].detach().clone()
    with forward_ad.dual_level():
        tangent = forward_ad.unpack_dual(image(scene, name, forward_ad.make_dual(base, direction))).tangent
    weight = torch.randn(tangent.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    leaf = base.clone().requires_grad_()
    (image(scene, name, leaf) * weight).sum().backward()
    reverse, forward = float((leaf.grad * direction).sum()), float((tangent * weight).sum())
    assert abs(reverse - forward) <= 1e-10 * max(1.0, abs(forward)), (reverse, forward)
    return base, tangent


def check(scene: tr.Scene, name: str, direction: torch.Tensor, step: float = 1e-5, tolerance: float = 1e-6) -> None:
    base, tangent = modes(scene, name, direction)
    with torch.no_grad():
        up, down = (image(scene, name, base + sign * step * direction) for sign in (1, -1))
    difference = (up - down) / (2 * step)
    scale = float(difference.abs().max())
    assert scale > 1e-7
    assert float((tangent - difference).abs().max()) <= tolerance * max(1.0, scale), (tangent - difference).abs().amax()


def along(scene: tr.Scene, name: str) -> torch.Tensor:
    value = dict(scene.named_parameters())[name]
    return torch.randn(value.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def turning(matrix: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """How a matrix changes as it is turned about an axis through its origin, in the world."""
    x, y, z = (axis / axis.norm()).tolist()
    cross = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    change = torch.zeros_like(matrix)
    change[:3, :3] = cross @ matrix[:3, :3]
    return change


def two_means(scene: tr.Scene, name: str, step: float = 2e-3, seeds: int = 24) -> tuple[torch.Tensor, float]:
    """z of I, Q and U of the mean derivative less that of differences, over seeds; and the derivative's size."""
    base, direction = dict(scene.named_parameters())[name].detach().clone(), along(scene, name)
    found, sizes = [], []
    for seed in range(seeds):
        with forward_ad.dual_level():
            dual = image(scene, name, forward_ad.make_dual(base, direction), seed, 64)
            tangent = forward_ad.unpack_dual(dual).tangent
        with torch.no_grad():
            up, down = (image(scene, name, base + s * step * direction, seed, 64) for s in (1, -1))
        found.append((tangent - (up - down) / (2 * step)).mean((0, 1, 2))[:3])
        sizes.append(tangent.mean((0, 1, 2))[:3])
    error = torch.stack(found)
    z = error.mean(0) / (error.std(0) / seeds**0.5 + 1e-12)
    return z, float(torch.stack(sizes).mean(0).abs().max())
