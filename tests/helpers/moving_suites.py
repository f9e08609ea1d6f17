"""Scenes of flat meshes that move by one number, for the configurations with which other renderers are tested."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import torch
import trimesh
from moving_differences import agrees

import torchrender as tr

DOUBLE = torch.float64
Image = Callable[..., torch.Tensor]  # of a scene, by parameters and settings of `tr.render`


def sheet(corners: object, **more) -> tr.Mesh:
    """Two triangles from four corners in reading order, or one from three; seen from where these turn left."""
    corners = np.asarray(corners, float)
    return tr.Mesh(corners, np.array([[0, 1, 2], [2, 1, 3]][: len(corners) - 2]), **more)


def rectangle(to_world: tr.Transform, **more) -> tr.Mesh:
    """The square from -1 to 1 in x and y, which faces +z, moved."""
    return sheet([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], to_world=to_world, **more)


def ball(to_world: tr.Transform, smooth: bool = False, **more) -> tr.Mesh:
    """The unit sphere of 1280 triangles, moved; `smooth`: with normals of its own."""
    mesh = trimesh.creation.icosphere(3)
    normals = mesh.vertices if smooth else None
    return tr.Mesh(mesh.vertices, mesh.faces, vertex_normals=normals, to_world=to_world, **more)


def glowing(radiance: float) -> dict:
    return {"type": "area", "radiance": radiance}


def diffuse(reflectance: object) -> dict:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


Weight = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]  # by u to the right and v down, from -1 to 1


def everywhere(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Another weight for every place, so that opposite edges do not cancel, whether a thing moves, turns or grows."""
    return 4 * (u + 0.5 * v + u * u + v * v)


def in_the_middle(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """For a shadow that is there and moves sideways."""
    return 400 * u * torch.exp(-8 * (u * u + v * v))


def at_the_border(u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """For the first and last row."""
    return 40 * u * (v.abs() > 0.99)


def weighted(image: torch.Tensor, weight: Weight | torch.Tensor = everywhere) -> torch.Tensor:
    """The weighted mean, with another factor for each colour where the weight is not an image itself."""
    if isinstance(weight, torch.Tensor):
        return (image * weight).mean()
    h, w, c = image.shape
    v, u = torch.meshgrid(torch.linspace(-1, 1, h), torch.linspace(-1, 1, w), indexing="ij")
    return (image * (weight(u, v)[..., None] * torch.tensor([1.0, 0.8, 0.6])[:c]).to(image)).mean()


def rendered(scene: tr.Scene, params: dict, **settings) -> torch.Tensor:
    return tr.render(scene, params=params, **settings)


def moved(scene: tr.Scene, moves: Mapping[str, torch.Tensor] | None, theta: torch.Tensor) -> dict[str, torch.Tensor]:
    """Values of parameters; theta alone, by that name, where no moves are given."""
    if moves is None:
        return {"theta": theta}
    return {name: scene.get_parameter(name).detach() + theta * move for name, move in moves.items()}


def derivative(f: Callable[..., torch.Tensor], **settings) -> float:
    """Of a function of theta with these settings, where theta is zero, in reverse mode."""
    theta = torch.zeros((), dtype=DOUBLE, requires_grad=True)
    return float(torch.autograd.grad(f(theta, **settings), theta)[0])


def both_modes(f: Callable[[torch.Tensor], torch.Tensor]) -> tuple[float, float]:
    """The derivative of a function of theta, where theta is zero, in forward and in reverse mode."""
    theta = torch.zeros((), dtype=DOUBLE)
    _, forward = torch.func.jvp(f, (theta,), (torch.ones_like(theta),))
    return float(forward), derivative(f)


def by_theta(
    scene: tr.Scene,
    moves: Mapping[str, torch.Tensor] | None,
    *,
    spp: int,
    differences_spp: int,
    step: float,
    seeds: int,
    image: Image = rendered,
    weight: Weight | torch.Tensor = everywhere,
    **settings,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Reverse-mode derivatives of a weighted mean by how far all `moves` have gone, and central differences, by seed.

    The derivatives are of independent samples, with these settings of `tr.render`, the differences of the same points
    of Sobol's sequence at both ends.
    """

    def f(theta: torch.Tensor, **more) -> torch.Tensor:
        return weighted(image(scene, moved(scene, moves, theta), **more), weight)

    here = torch.zeros((), dtype=DOUBLE)
    derivatives, differences = [], []
    for seed in range(seeds):
        derivatives.append(derivative(f, spp=1, seed=seeds + seed, spp_grad=spp, seed_grad=seed, **settings))
        with torch.no_grad():
            ends = [f(here + h, spp=differences_spp, seed=seed, sampler="sobol") for h in (step, -step)]
        differences.append(float(ends[0] - ends[1]) / (2 * step))
    return torch.tensor(derivatives), torch.tensor(differences)


def check(derivatives: torch.Tensor, differences: torch.Tensor, rtol: float, tests: int) -> None:
    """`agrees`; and that the standard error is below the limit, so that this means something."""
    passed, text = agrees(derivatives, differences, rtol, tests)
    gap = derivatives - differences
    error, limit = float(gap.std()) / math.sqrt(len(gap)), rtol * float(differences.mean().abs())
    print(f"{text}, off by {float(gap.mean() / differences.mean()):.2%}, z {float(gap.mean()) / error:.2f}")
    assert passed, text
    assert error < limit, f"the limit is {limit:.2g}: {text}"
    assert limit > 10 * 5e-5, "`agrees` allows 5e-5 for where rays start"
