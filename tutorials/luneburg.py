"""Find a Luneburg lens by the spots of its rays.

    python tutorials/luneburg.py             # 9^3, 17^3 and 33^3 voxels
    python tutorials/luneburg.py --levels 4  # and 65^3

A ball is to gather parallel light, from wherever it comes, in the point of its surface that lies opposite. Rudolf
Luneburg found in 1944 which index of refraction does that, n^2 = 2 - r^2. Here it is found by gradient descent: beams
from 26 sides go through a grid of voxels, and the loss is how far their rays come out from the antipodes.

`tr.gradientindex.trace` follows the rays, and differentiates what it follows, in memory that does not grow with their
steps. The problem and the recipe, coarse to fine with Adam, a rate of 1e-2 halved at every level, are those of Teh,
O'Toole and Gkioulekas, "Adjoint nonlinear ray tracing", SIGGRAPH 2022. Ours are what the index is divided by (below), a
border of voxels around the ball, and rates that fall to a tenth within a level, along a cosine: without these three
spots were 2 % of the radius and the index 7 % off.

Rays do not change when n is multiplied by a number, since the border of the ball does not refract. So the index is
divided by its mean on the surface, and that it is 1 everywhere there is a second term of the loss; both by
`tr.gradientindex.evaluate`.

The run leaves pictures on its way, and a checkpoint from which it goes on when it is started again.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from bent_rays import across, coordinates, cube, disk, paths, save_slices
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

INDEX = "ball.interior_medium.index"
COARSEST = 9  # voxels a side; every level has 2 n - 1
HALF = 1.2  # of the grid's side: beyond the ball there is a border, where the index goes on as it ends
JUDGED = 0.9  # radius up to which the index is compared with the truth: near the rim hardly a ray is bent


def sides() -> torch.Tensor:
    """(26, 3) unit vectors: to the faces, edges and corners of a cube."""
    grid = torch.cartesian_prod(*[torch.tensor([-1.0, 0.0, 1.0])] * 3)
    return torch.nn.functional.normalize(grid[grid.abs().sum(1) > 0], dim=1)


def at(index: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """n (...) at points (..., 3) of the world."""
    return tr.gradientindex.evaluate(index, (points + HALF) / (2 * HALF))[0]


def matched(n: torch.Tensor, surface: torch.Tensor) -> torch.Tensor:
    """The index (Z, Y, X) times the number that makes its mean on the surface 1."""
    return n / at(n, surface).mean()


def beams(directions: torch.Tensor, count: int, generator: torch.Generator | None = None) -> tuple[torch.Tensor, ...]:
    """Origins, directions and antipodes, each (sides * count, 3), of beams almost as wide as the ball."""
    first, second = across(directions)
    points = 0.98 * disk(len(directions) * count, generator).reshape(len(directions), count, 2)
    if generator is None:
        points = (0.98 * disk(count)).expand(len(directions), -1, -1)
    origins = points[..., :1] * first[:, None] + points[..., 1:] * second[:, None] - 2 * directions[:, None]
    along = directions[:, None].expand_as(origins).reshape(-1, 3)
    return origins.reshape(-1, 3), along, along


def trace(scene: tr.Scene, index: torch.Tensor, rays: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """(N, 3): how far rays come out from their antipodes."""
    origins, directions, antipodes = rays
    found = tr.gradientindex.trace(scene, "ball", origins, directions, params={INDEX: index})
    return (found.position - antipodes)[found.valid]


def errors(scene: tr.Scene, index: torch.Tensor, count: int) -> dict[str, float]:
    """The root mean square of spots in radii, from 26 sides and from 26 others, and what the index is off by."""
    turned = sides() @ tr.rotation.so3_exp(torch.tensor([0.3, 0.4, 0.5])).T
    with torch.no_grad():
        spots = [trace(scene, index, beams(d, count)).square().sum(1).mean().sqrt().item() for d in (sides(), turned)]
    x, y, z = coordinates(41)
    points = torch.stack([x, y, z], -1)[x * x + y * y + z * z < JUDGED**2]
    n = at(index, points)
    relative = n / torch.sqrt(2 - points.square().sum(1)) - 1
    return {
        "spot": spots[0],
        "spot from other sides": spots[1],
        "index": relative.square().mean().sqrt().item(),
        "largest of index": relative.abs().max().item(),
    }


def save_state(index: torch.Tensor, folder: Path, name: str) -> None:
    """Draw the middle slice of the index with rays through it, beside the truth."""
    axis = torch.linspace(-1, 1, 129)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    radius = torch.sqrt(x * x + y * y)
    outside = radius > 1
    n = at(index, torch.stack([x, y, torch.zeros_like(x)], -1))
    true = torch.sqrt((2 - radius * radius).clamp(min=1))
    slices = {"found": n, "n² = 2 - r²": true}
    slices = {key: torch.where(outside, torch.nan, value.detach()) for key, value in slices.items()}
    start = torch.stack([torch.full((19,), -1.4), torch.linspace(-0.9, 0.9, 19), torch.zeros(19)], 1)
    lines = paths(
        index.detach(), HALF, start, torch.tensor([[1.0, 0.0, 0.0]]).expand(19, 3), lambda p: p.norm(dim=1) < 1, 0.01
    )
    title = f"Index of refraction, {len(index)}³ voxels"
    save_slices(slices, folder / f"{name}.png", title, 1.0, [p[:, :2] for p in lines[:271]])


def run(
    folder: Path,
    *,
    levels: int = 3,
    iterations: int = 70,
    rays: int = 400,
    rate: float = 1e-2,
    weight: float = 1.0,
    step: float = 0.5,
    save_every: int = 10,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns root mean squares at the end: of the spots, in radii, and of what the index is off by.

    Args:
        folder: where pictures, the index and the checkpoint go.
        levels: grids, 9^3 voxels the first, each twice as fine as the one before.
        iterations: steps of the optimiser on each.
        rays: rays from each side in an iteration.
        rate: learning rate of the first level, halved at every further one.
        weight: of the index on the surface, which is to be 1.
        step: the longest step of a ray in voxels.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {"levels": levels, "iterations": iterations, "rays": rays, "rate": rate}
    settings |= {"weight": weight, "step": step}
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()

    # The medium fills the ball; its grid the cube around that. The border of the ball does not refract ("null").
    medium = {"type": "gradientindex", "index": 1.0, "to_world": cube(HALF), "step": step}
    scene = tr.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}})
    directions = sides()
    surface = torch.nn.functional.normalize(torch.randn(2000, 3, generator=torch.Generator().manual_seed(1)), dim=1)

    # A number without bounds for every voxel, of which softplus makes an index that is positive.
    positive = tr.constraints.Positive()
    raw = torch.nn.Parameter(
        positive.right_inverse(torch.ones(COARSEST, COARSEST, COARSEST, 1)) if state is None else state["raw"]
    )
    optimiser = torch.optim.Adam([raw], lr=rate)
    generator = torch.Generator().manual_seed(0)
    curves: dict[str, list[float]] = {"mean squared distance": []}
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, levels * iterations, optimiser, generator)

    total = levels * iterations
    bar = tr.progress(range(first, total), desc="luneburg", initial=first, total=total)
    for iteration in bar:
        level = iteration // iterations
        size = (COARSEST - 1) * 2**level + 1
        if size > len(raw):
            # The moments of the optimiser grow with the grid, so that nothing is forgotten.
            raw = tr.optim.upsample_tensor(raw, (size,) * 3, optimiser, wrap_mode="clamp")
        for group in optimiser.param_groups:
            group["lr"] = rate / 2**level * (0.55 + 0.45 * math.cos(math.pi * (iteration % iterations) / iterations))
        optimiser.zero_grad()
        index = matched(positive(raw)[..., 0], surface)
        spots = trace(scene, index, beams(directions, rays, generator)).square().sum(1).mean()
        loss = spots + weight * (at(index, surface) - 1).square().mean()
        loss.backward()
        optimiser.step()
        curves["mean squared distance"].append(spots.item())
        bar.set_postfix(spot=f"{math.sqrt(spots.item()):.3g}", grid=f"{size}^3")

        done = iteration + 1
        if done % save_every == 0 or done == total:
            save_state(matched(positive(raw)[..., 0], surface), folder, "progress")
            save_curves(curves, folder / "loss.png", f"Luneburg lens, {len(directions)} beams of {rays} rays")
            checkpoint.save(
                iteration=done,
                raw=raw.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
            )

    index = matched(positive(raw)[..., 0], surface).detach()
    tr.io.write_volume(folder / "index.vol", index[..., None])
    save_state(index, folder, "result")
    result = errors(scene, index, 400)
    percent = {name: f"{100 * value:.2f} %" for name, value in result.items()}
    print(f"spots: {percent['spot']} of the radius, {percent['spot from other sides']} from other sides")
    print(f"index for r < {JUDGED}: {percent['index']} off (rms), {percent['largest of index']} at most")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--levels", type=at_least_one, help="grids, of 9, 17, 33, 65 voxels a side (default 3)")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser on each (default 70)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/luneburg"), help="folder for the results")
    options = parser.parse_args(argv)
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **given(options, "levels", "iterations"))


if __name__ == "__main__":
    main()
