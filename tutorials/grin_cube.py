"""A cube of glass that throws one picture along one axis and another one along another, by its index of refraction.

    python tutorials/grin_cube.py             # 40^3 voxels, two pictures of 64 x 64, 120 iterations
    python tutorials/grin_cube.py --full      # 160^3 voxels, two pictures of 256 x 256, 500 iterations

Two lamps send parallel light through a cube of glass, each through two opposite faces, on a screen behind. The faces
are flat. What bends the light is the index of refraction, which varies between 1.45 and 1.55 within the cube: it
gathers the one beam to a sun, the other one to a moon and a star. This is the inversion of gradient-index optics in
"Mitsuba 2: A Retargetable Forward and Inverse Renderer" (Nimier-David, Vicini, Zeltner, Jakob, ACM Transactions on
Graphics 38(6), 2019), with its numbers of voxels, pixels and iterations. Its scene was not published; this one is
ours.

Paths start at the lamps (`tr.ParticleTracer`), and screens measure what arrives (`tr.IrradianceMeter`). The derivative
goes through every bent way, in memory that does not grow with its steps. Two pictures are far fewer numbers than there
are voxels; what they fix, in first order, is the integral of the index along the one and the other axis. Both have the
same mean at each height y, whatever the two pictures are: so the lamps leave a margin of 6 % of the cube dark, whose
index is free to even that out.

The grid becomes finer in the run. What the optimiser moves is ``u = (I + lambda L) x``, of which a sigmoid makes the
index, so that its steps are smooth; where the grid is twice as fine, lambda is four times as large, and steps are a
quarter as long, because the same change of the index over half the distance bends light twice as much.
"""

from __future__ import annotations

import argparse
import math
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from bent_rays import save_slices
from caustics import distance, grown, sizes_of
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save, save_curves

import torchrender as tr

SCENES = Path(__file__).resolve().parent.parent / "scenes"
sys.path.append(str(SCENES))  # the script that makes the scene is not a part of the package
from make_grin import INDEX, LEAST, MOST, grin_cube  # noqa: E402
from make_shadows import star  # noqa: E402

COARSEST = 20  # voxels along a side at the beginning, about
SLOWER_AT = 0.8  # part of the run after which there are twice the samples
FLOOR = 0.2  # of a picture's mean: no place is wholly dark


def sun(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Inside of a disk with twelve rays around it."""
    radius, half = torch.hypot(x, y), math.pi / 12
    angle = torch.remainder(torch.atan2(y, x) + half, 2 * half) - half
    ray = (radius > 0.42) & ((radius * torch.sin(angle)).abs() < 0.22 * (0.8 - radius))
    return (radius < 0.34) | ray


def moon(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Inside of a crescent, or of a star beside it."""
    crescent = (torch.hypot(x, y) < 0.75) & (torch.hypot(x - 0.3, y - 0.1) > 0.6)
    return crescent | star((x - 0.32) / 0.3, (y - 0.1) / 0.3)


def draw(inside: Any, resolution: int, detail: int = 8) -> torch.Tensor:
    """A picture (H, W, 1) of mean 1: what is inside is bright."""
    axis = (torch.arange(resolution * detail) + 0.5) / (resolution * detail) * 2 - 1
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    share = torch.nn.functional.avg_pool2d(inside(x, y).float()[None], detail)[0]
    return (FLOOR + (1 - FLOOR) * share / share.mean())[..., None]


def save_pictures(images: list[torch.Tensor], folder: Path, name: str) -> None:
    side_by_side = torch.cat([image / image.mean() for image in images], dim=1)
    save(side_by_side.expand(-1, -1, 3) / 5, folder, name)


def save_index(index: torch.Tensor, folder: Path, name: str) -> None:
    """Draw slices through the middle, across each axis."""
    middle = len(index) // 2
    slices = {"across z": index[middle], "across y": index[:, middle], "across x": index[:, :, middle].T}
    save_slices(slices, folder / f"{name}.png", f"Index of refraction, {len(index)}³ voxels", 0.5)


def run(
    folder: Path,
    *,
    size: int = 160,
    resolution: int = 256,
    cubic: bool = False,
    spp: int = 16,
    spp_grad: int = 8,
    iterations: int = 500,
    rate: float = 0.4,
    smoothness: float = 0.1,
    verification_spp: int = 512,
    save_every: int = 25,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the distance of both pictures from their targets at the end.

    Args:
        folder: where pictures, the index and the checkpoint go.
        size: voxels along a side of the finest grid.
        resolution: pixels along a side of both pictures.
        cubic: splines of the index are cubic, not quadratic, which takes 1.5 times as long.
        spp, spp_grad: samples a pixel of picture and derivative, twice as many in the last fifth of the run.
        iterations: steps of the optimiser.
        rate: how far u moves in a step on the coarsest grid, at most.
        smoothness: lambda of the large steps on the coarsest grid.
        verification_spp: samples a pixel of the last pictures.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "size": size,
        "resolution": resolution,
        "cubic": cubic,
        "samples": [spp, spp_grad],
        "iterations": iterations,
        "rate": rate,
        "smoothness": smoothness,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()
    targets = {"sun": draw(sun, resolution), "moon": draw(moon, resolution)}
    save_pictures(list(targets.values()), folder, "target")

    sizes = sizes_of(size, COARSEST)
    turns = {"sun": tr.Transform(), "moon": tr.Transform.rotate([0, 1, 0], 90)}
    interpolation = "cubic" if cubic else "quadratic"
    scenes = {name: tr.load_dict(grin_cube(turn, sizes[0], resolution, interpolation)) for name, turn in turns.items()}
    # The renderer warns that the term from edges seen through the medium is missing: what jumps where light comes to
    # another face. Hardly any light comes to an edge of the cube.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    between = tr.constraints.ScaledSigmoid(LEAST, MOST)
    u = torch.nn.Parameter(torch.zeros(*[sizes[0]] * 3, 1) if state is None else state["u"])
    # One length for the steps of all voxels: Adam's own for each entry would make the index rough again.
    optimiser = tr.optim.UniformAdam([u], lr=rate, betas=(0.9, 0.99))
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {name: [] for name in scenes}
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)

    def smoothing_of(size: int) -> tr.optim.GridSmoothing:
        return tr.optim.GridSmoothing(smoothness * (size / sizes[0]) ** 2, dims=3)

    def index() -> torch.Tensor:
        return between(smoothing_of(len(u)).from_differential(u))[..., 0]

    def render(name: str, n: torch.Tensor, **settings: Any) -> torch.Tensor:
        """The picture (H, W, 1) of a grey light."""
        return tr.render(scenes[name], sampler="stratified", params={INDEX: n}, **settings)[..., :1]

    bar = tr.progress(range(first, iterations), desc="grin cube", initial=first, total=iterations)
    for iteration in bar:
        finer = sizes[iteration * len(sizes) // iterations]  # each grid has as many
        if finer > len(u):
            u = grown(u, finer, optimiser, smoothing_of(len(u)), smoothing_of(finer))
        for group in optimiser.param_groups:
            group["lr"] = rate / (finer / sizes[0]) ** 2
        times = 2 if iteration >= SLOWER_AT * iterations else 1
        optimiser.zero_grad()
        n = index()
        images = {name: render(name, n, spp=spp * times, spp_grad=spp_grad * times, seed=generator) for name in scenes}
        distances = {name: distance(image, targets[name]) for name, image in images.items()}
        torch.stack(list(distances.values())).mean().backward()
        optimiser.step()
        for name, value in distances.items():
            curves[name].append(value.item())
        bar.set_postfix({name: f"{value.item():.3f}" for name, value in distances.items()}, grid=f"{finer}^3")

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save_pictures([image.detach() for image in images.values()], folder, "progress")
            save_index(n.detach(), folder, "index")
            save_curves(curves, folder / "loss.png", f"Two pictures by one cube of {size}³ voxels")
            checkpoint.save(
                iteration=done,
                u=u.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
            )

    with torch.no_grad():
        n = index()
        images = {name: render(name, n, spp=verification_spp, seed=1_000_000) for name in scenes}
    tr.io.write_volume(folder / "index.vol", n[..., None])
    save_index(n, folder, "index")
    save_pictures(list(images.values()), folder, "result")
    result = {name: distance(image, targets[name]).item() for name, image in images.items()}
    told = ", ".join(f"{name} {value:.4f}" for name, value in result.items())
    print(f"distance from the targets with {verification_spp} samples a pixel: {told}")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="160^3 voxels, two pictures of 256 x 256, 500 iterations")
    parser.add_argument("--cubic", action="store_true", help="cubic splines in place of quadratic ones")
    parser.add_argument("--size", type=at_least_one, help="voxels along a side (default 40)")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 120)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/grin_cube"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {} if options.full else {"size": 40, "resolution": 64, "iterations": 120}
    settings |= {"cubic": options.cubic}
    settings |= given(options, "size", "iterations")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
