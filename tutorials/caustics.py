"""Find the shape of a glass plate that throws a picture.

    python tutorials/caustics.py            # 128 x 128 heights, 64 x 64 pixels, in colours
    python tutorials/caustics.py --grey     # a grey picture by white light
    python tutorials/caustics.py --size 512 # 512 x 512 heights, 128 x 128 pixels
    python tutorials/caustics.py --full     # 2048 x 2048 heights, 10 passes of 256 + 64 samples, 1500 iterations

Light falls through a plate of glass on a screen. The plate's front is a little wavy, by a hundredth of its width at
most, and its waves gather the light to a picture. Glass bends all colours alike; to throw a coloured picture the light
comes in squares of red, green and blue, and the glass in front of each square throws its colour's share.

A path from the camera would have to hit the lamp's one direction by chance, so paths start at the lamp here
(`tr.ParticleTracer`). The plate is a height field (`tr.HeightField`), the derivative by its heights comes through the
refraction: where the light arrives, and how much. Heights are optimised coarse to fine, and through large steps: what
the optimiser moves is ``u = (I + lambda L) heights``, so that its steps are smooth. Where there are several heights to
a pixel that comes about twice as near to the target as moving the heights themselves.

A long run leaves pictures on its way and goes on from its checkpoint when it is started again. At the end the plate is
written as a closed surface in millimetres (STL, PLY), its front also as pictures, and its mesh is rendered once more.
"""

from __future__ import annotations

import argparse
import math
import sys
import warnings
from pathlib import Path
from typing import Any

import torch
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save, save_curves
from plates import write_plate

import torchrender as tr

SCENES = Path(__file__).resolve().parent.parent / "scenes"
sys.path.append(str(SCENES))  # the script that makes the scene is not a part of the package
import make_caustics  # noqa: E402

COARSEST = 32  # heights along a side at the beginning
SLOWER_AT = (0.7, 0.9)  # parts of the run after which there are twice the samples and steps are half as long


def distance(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The mean squared difference of two pictures in units of their mean: how bright the lamp is does not matter."""
    return (image / image.detach().mean() - target / target.mean()).square().mean()


def sizes_of(size: int, coarsest: int = COARSEST) -> list[int]:
    """The sizes of the grids, from the coarsest one on, each twice the one before."""
    sizes = [size]
    while sizes[0] % 2 == 0 and sizes[0] // 2 >= coarsest:
        sizes.insert(0, sizes[0] // 2)
    return sizes


def size_at(iteration: int, iterations: int, sizes: list[int]) -> int:
    """The grid of an iteration: number k of n begins after a part (k / n)^2 of the run, the finest one at last."""
    n = len(sizes)
    return sizes[sum(iteration >= round(iterations * (k / n) ** 2) for k in range(1, n))]


def grown(
    u: torch.nn.Parameter,
    size: int,
    optimiser: torch.optim.Optimizer,
    smoothing: tr.optim.GridSmoothing,
    finer: tr.optim.GridSmoothing,
) -> torch.nn.Parameter:
    """What is optimised on a grid of this size, as far as large steps have come, with the optimiser's state."""
    shape = (size,) * smoothing.dims
    with torch.no_grad():
        values = tr.optim.resample(smoothing.from_differential(u), shape, "clamp")
    u = tr.optim.upsample_tensor(u, shape, optimiser, wrap_mode="clamp")
    u.data.copy_(finer.to_differential(values))
    return u


def picture_of(heights: torch.Tensor) -> torch.Tensor:
    """Heights (H, W) as a picture, black at the lowest and white at the highest point, v upwards."""
    heights = heights.detach().flip(0)
    low, high = heights.min(), heights.max()
    return ((heights - low) / (high - low).clamp(min=1e-12))[..., None].expand(-1, -1, 3)


def run(
    folder: Path,
    *,
    size: int = 2048,
    resolution: int = 128,
    colour: bool = True,
    spp: int = 256,
    spp_grad: int = 64,
    passes: int = 10,
    iterations: int = 1500,
    rate: float = 3e-4,
    smoothness: float = 1.0,
    limit: float = 0.01,
    width_mm: float = 100.0,
    mesh: int = 1024,
    verification_spp: int = 1024,
    save_every: int = 50,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the distance from the target in the last iteration and of the verification.

    Args:
        folder: where pictures, the plate and the checkpoint go.
        size: heights along either side of the plate; the first grid is 32 wide, or as little more as halving leads to.
        resolution: pixels along either side of the picture.
        colour: a coloured picture, by light in red, green and blue squares; else a grey one.
        spp, spp_grad, passes: samples a pixel of picture and derivative in a pass, and passes, of the first iterations.
        iterations: steps of the optimiser.
        rate: the learning rate of the first iterations; heights move a tenth of that in a step, about.
        smoothness: lambda of the large steps, for each height along the side of a pixel.
        limit: the largest height, up and down.
        width_mm: width of the finished plate in millimetres.
        mesh: triangles along a side of the written front, at most.
        verification_spp: samples a pixel of the last picture, that of the mesh.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "size": size,
        "resolution": resolution,
        "colour": colour,
        "samples": [spp, spp_grad, passes],
        "iterations": iterations,
        "rate": rate,
        "smoothness": smoothness,
        "limit": limit,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()
    target = torch.from_numpy(make_caustics.target(resolution, colour=colour))
    save(target, folder, "target")

    sizes = sizes_of(size)
    coarsest = torch.zeros(sizes[0], sizes[0])
    scene = tr.load_dict(make_caustics.caustics(coarsest, colour=colour, resolution=resolution))
    renderer = tr.Renderer(scene)
    # The renderer warns that the term from moving edges is missing in derivatives of shapes. A plate without folds that
    # is wholly in the light has none.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    u = torch.nn.Parameter(coarsest if state is None else state["u"])
    smoothing = tr.optim.GridSmoothing(smoothness * len(u) / resolution)
    # The derivatives by single heights are tiny, next to which Adam's usual epsilon would be large.
    optimiser = torch.optim.Adam([u], lr=rate, betas=(0.9, 0.95), eps=1e-20)
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {"loss": []}
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)

    bar = tr.progress(range(first, iterations), desc="caustics", initial=first, total=iterations)
    for iteration in bar:
        finer = size_at(iteration, iterations, sizes)
        if finer > len(u):
            before, smoothing = smoothing, tr.optim.GridSmoothing(smoothness * finer / resolution)
            u = grown(u, finer, optimiser, before, smoothing)
        slower = sum(iteration >= round(part * iterations) for part in SLOWER_AT)
        for group in optimiser.param_groups:
            group["lr"] = rate / 2**slower
        samples = {"spp": spp * 2**slower, "spp_grad": spp_grad * 2**slower, "passes": passes}

        optimiser.zero_grad()
        heights = smoothing.from_differential(u)
        image = renderer(seed=generator, params={make_caustics.LENS: heights}, **samples)
        loss = distance(image, target)
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            heights = smoothing.from_differential(u)
            # How thick the plate is does not matter: that the middle of the heights is 0 leaves them the most room.
            middle = (heights.max() + heights.min()) / 2
            u -= middle
            heights -= middle
            if heights.abs().max() > limit:
                heights.clamp_(-limit, limit)
                u.copy_(smoothing.to_differential(heights))
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", grid=len(u))

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save(image.detach() * (target.mean() / image.detach().mean()), folder, "progress")
            tr.io.write_image(folder / f"heights_{done:04d}.png", picture_of(heights), raw=True)
            save_curves(curves, folder / "loss.png", f"Caustics: {size} x {size} heights")
            checkpoint.save(
                iteration=done,
                u=u.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
            )

    with torch.no_grad():
        heights = smoothing.from_differential(u)
    tr.io.write_image(folder / "lens.exr", heights)  # what tr.HeightField takes
    write_plate(folder, heights, thickness=make_caustics.THICKNESS, width_mm=width_mm, resolution=min(size, mesh))
    print(f"it throws its picture on a screen at {make_caustics.DISTANCE * width_mm / 2:g} mm")
    result = {"loss": curves["loss"][-1], "verification": verify(folder, heights, target, colour, verification_spp)}
    print(
        f"distance from the target: {result['loss']:.4f} in the last iteration, "
        f"{result['verification']:.4f} with the plate's front as a mesh and {verification_spp} samples a pixel"
    )
    return result


def verify(folder: Path, heights: torch.Tensor, target: torch.Tensor, colour: bool, spp: int) -> float:
    """Render the plate another way, its front as a mesh with vertex normals, and save that; the distance from the
    target."""
    resolution = min(2 * len(heights), 2048)
    matrix = torch.tensor(make_caustics.FACING_DOWN, dtype=torch.float32)
    vertices, faces, normals, texcoords = tr.heightfield.mesh(
        heights, to_world=matrix, resolution=(resolution, resolution)
    )
    glass = {"type": "ref", "id": "glass"}
    mesh = tr.Mesh(vertices, faces, vertex_normals=normals, vertex_texcoords=texcoords, bsdf=glass)
    scene = tr.load_dict(make_caustics.caustics(mesh, colour=colour, resolution=len(target)))
    with torch.no_grad():
        image = tr.render(scene, seed=1_000_000, spp=min(spp, 64), passes=math.ceil(spp / 64))
    save(image * (target.mean() / image.mean()), folder, "result")
    return distance(image, target).item()


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="2048 x 2048 heights, 10 passes of 256 + 64 spp")
    parser.add_argument("--size", type=at_least_one, help="heights along a side, with 128 x 128 pixels and 64 + 32 spp")
    parser.add_argument("--grey", action="store_true", help="a grey picture by white light")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser")
    parser.add_argument("--width-mm", type=float, default=100.0, help="width of the plate in mm (default 100)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/caustics"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"colour": not options.grey, "width_mm": options.width_mm}
    if not options.full:
        settings |= {"size": 512, "spp": 64, "spp_grad": 32, "passes": 1, "iterations": 1000}
        if options.size is None:
            settings |= {"size": 128, "resolution": 64, "iterations": 200, "rate": 1e-3}
    settings |= given(options, "size", "iterations")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
