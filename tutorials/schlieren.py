"""Find the hot air over a flame by how it bends light: background-oriented schlieren.

    python tutorials/schlieren.py          # 32^3 voxels, 12 cameras of 48 x 48 vectors
    python tutorials/schlieren.py --full   # 64^3 voxels, 96 x 96 vectors

Hot air is thinner, so that its index of refraction is less: 1.00027 is that of cold air, 1.00018 that of the hottest
here. What lies behind it seems to shift, by some 1e-4 of the distance. In a laboratory cameras photograph a pattern
of dots with and without the plume, and optical flow gives a field of such displacements for each; here they are
computed from a plume that we make up, on a finer grid and with smaller steps, with 2 % noise.

The unknown is the index in a box, as `index_base` + `index_scale` * voxels with a base of 1.00027 and a scale of 1e-4:
voxels are numbers of about 1, and differences from the base keep their precision. The border of the box is `null`, and
the two outer layers of voxels stay 0, cold air. The loss is the squared difference from the displacements in units of
their noise, and a regulariser, the squared differences of neighbouring voxels (H1). With 12 cameras it hardly matters:
with 32^3 voxels weights from 0 to 1000 leave an error of 6.3 to 5.8 %. The problem is almost linear, and L-BFGS needs
some dozen steps. Cf. Atcheson et al., "Time-resolved 3d capture of non-stationary gas flows", SIGGRAPH
Asia 2008, who had 16 cameras.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from bent_rays import coordinates, cube, save_slices
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save_curves

import torchrender as tr

INDEX = "air.interior_medium.index"
BASE, SCALE = 1.00027, 1e-4
HELD = 2  # outer layers of voxels that are cold air
WALL = 3.0  # from the middle of the box to the backgrounds
DISTANCE = 6.0  # from there to the cameras


def plume(size: int) -> torch.Tensor:
    """(size, size, size) voxels of a plume: two strands of hot air that wind around each other, wider above."""
    x, y, z = coordinates(size)
    value = torch.zeros_like(x)
    for strand in range(2):
        turn = 3.5 * z + math.pi * strand
        away = 0.16 + 0.12 * (z + 1)
        width = 0.08 + 0.05 * (z + 1)
        near = (x - away * torch.cos(turn)) ** 2 + (y - away * torch.sin(turn)) ** 2
        value = value - torch.exp(-near / (2 * width**2)) * (0.09 / width)
    # it fades out towards the bottom and the top of the box, and where it would reach the sides
    edge = torch.stack([x, y, z]).abs().amax(0)
    return value * torch.sigmoid((0.72 - edge) / 0.04)


def made(voxels: torch.Tensor, step: float) -> tr.Scene:
    """A box of air."""
    medium: dict[str, Any] = {"type": "gradientindex", "index": voxels, "to_world": cube(), "step": step}
    medium |= {"index_base": BASE, "index_scale": SCALE}
    return tr.load_dict({"type": "scene", "air": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}})


def cameras(count: int, resolution: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Origins and directions (count * resolution^2, 3) of the rays of cameras on half a circle around the z axis."""
    origins, directions = [], []
    for k in range(count):
        turn = math.pi * k / count
        place = (DISTANCE * math.cos(turn), DISTANCE * math.sin(turn), 0.0)
        camera = tr.PerspectiveCamera.look_at(place, (0, 0, 0), up=(0, 0, 1), fov=22, size=(resolution, resolution))
        rays = camera.rays()
        origins.append(rays.origins)
        directions.append(rays.directions)
    return torch.cat(origins).detach(), torch.cat(directions).detach()


def displacements(
    scene: tr.Scene, rays: tuple[torch.Tensor, torch.Tensor], voxels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """(N, 3), how far rays are displaced where they come to the background, across their direction, and which ones go
    through the box at all."""
    origins, directions = rays
    found = tr.gradientindex.trace(scene, "air", origins, directions, params={INDEX: voxels})
    rest = WALL - (found.position * directions).sum(1, True)
    turned = found.direction - directions
    from_ray = found.position - origins
    from_ray = from_ray - directions * (from_ray * directions).sum(1, True)
    moved = from_ray + rest * turned
    moved = moved - directions * (moved * directions).sum(1, True)
    return torch.where(found.valid[:, None], moved, 0.0), found.valid


def roughness(voxels: torch.Tensor) -> torch.Tensor:
    """The mean squared difference of neighbours."""
    return sum((voxels.diff(dim=axis).square().mean() for axis in range(3)), voxels.new_zeros(()))


def field(voxels: torch.Tensor, size: int) -> torch.Tensor:
    """(size, size, size): the index where another grid has its voxels, less that of cold air, in units of its scale."""
    points = (torch.stack(coordinates(size), -1).double() + 1) / 2
    n, _ = tr.gradientindex.evaluate(BASE + SCALE * voxels.double(), points)
    return ((n - BASE) / SCALE).float()


def run(
    folder: Path,
    *,
    size: int = 64,
    resolution: int = 96,
    views: int = 12,
    noise: float = 0.02,
    smoothness: float = 3.0,
    iterations: int = 12,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the error of the index relative to the truth, in the square mean, and that of the
    displacements relative to their noise.

    Args:
        folder: where pictures, the index and the checkpoint go.
        size: voxels along each side.
        resolution: vectors along either side of each camera's field.
        views: cameras, on half a circle.
        noise: standard deviation of the errors of both components relative to the root mean square displacement.
        smoothness: weight of the regulariser.
        iterations: times five steps of L-BFGS; after each there are pictures and a checkpoint.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {"size": size, "resolution": resolution, "views": views, "noise": noise}
    settings |= {"smoothness": smoothness, "iterations": iterations}
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()

    rays = cameras(views, resolution)
    true = plume(2 * size)
    with torch.no_grad():
        data, through = displacements(made(true, 0.5), rays, true)
        level = noise * data[through].square().sum(1).mean().sqrt() / math.sqrt(2)
        error = level * torch.randn(data.shape, generator=torch.Generator().manual_seed(0))
        data = data + error - rays[1] * (error * rays[1]).sum(1, True)

    scene = made(torch.zeros(size, size, size), 1.0)
    inner = size - 2 * HELD
    unknown = torch.nn.Parameter(torch.zeros(inner, inner, inner) if state is None else state["unknown"])
    optimiser = torch.optim.LBFGS([unknown], max_iter=5, history_size=10, line_search_fn="strong_wolfe")
    curves: dict[str, list[float]] = {"loss": []}
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser)

    def voxels() -> torch.Tensor:
        return torch.nn.functional.pad(unknown, (HELD,) * 6)

    def misfit() -> torch.Tensor:
        residual = displacements(scene, rays, voxels())[0] - data
        return residual[through].square().sum(1).mean() / (2 * level**2)

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = misfit() + smoothness * roughness(voxels())
        loss.backward()
        curves["loss"].append(loss.item())
        return loss

    target = field(true, size)

    def compare() -> float:
        found = field(voxels().detach(), size)
        middle = size // 2
        slices = {"found, x and z": found[:, middle], "truth": target[:, middle]}
        slices |= {"found, x and y": found[middle], "truth ": target[middle]}
        save_slices(slices, folder / "progress.png", "Index of refraction, (n - 1.00027) / 1e-4")
        return (torch.linalg.vector_norm(found - target) / torch.linalg.vector_norm(target)).item()

    bar = tr.progress(range(first, iterations), desc="schlieren", initial=first, total=iterations)
    off = math.nan
    for iteration in bar:
        optimiser.step(closure)
        off = compare()
        bar.set_postfix(loss=f"{curves['loss'][-1]:.4g}", error=f"{off:.3g}")
        save_curves(curves, folder / "loss.png", f"Schlieren: {size}³ voxels from {views} cameras")
        checkpoint.save(
            iteration=iteration + 1, unknown=unknown.detach(), optimiser=optimiser.state_dict(), curves=curves
        )

    off = compare()
    (folder / "progress.png").replace(folder / "result.png")
    with torch.no_grad():
        tr.io.write_volume(folder / "index.vol", (BASE + SCALE * voxels())[..., None])
        result = {"error": off, "residual": math.sqrt(misfit().item()), "displacement": float(data.norm(dim=1).max())}
    print(
        f"displacements up to {result['displacement']:.2e}; the residual is {result['residual']:.2f} times their noise"
    )
    print(f"relative error of the index: {100 * off:.1f} %")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="64^3 voxels, 96 x 96 vectors a camera")
    parser.add_argument("--iterations", type=at_least_one, help="times five steps of L-BFGS (default 12)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/schlieren"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {} if options.full else {"size": 32, "resolution": 48}
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings, **given(options, "iterations"))


if __name__ == "__main__":
    main()
