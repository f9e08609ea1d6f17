"""One tube, two shadows: find a surface that throws a heart on one wall and a star on another.

    python tutorials/shadow_art.py            # 2 pictures of 128 x 128 pixels, 450 steps
    python tutorials/shadow_art.py --demo     # 2 of 48 x 48, 60 steps

Two suns shine along two axes, each on a wall of its own, and a tube that is bent to a ring hangs between. The cameras
look at the walls only: in their pictures there is no tube, nothing but its shadows, and all that the vertices of the
tube change there is where the shadows end. So the whole derivative is that of moving shadow edges.

As in `mesh_from_pictures.py` the optimiser moves ``u = (I + lambda L) vertices``, so that its steps are smooth. The
heart has a hole, since a tube that is bent to a ring has one; the star shows none, since from that side it hides it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from meshes import cameras, write_ply
from pictures import save, save_curves

import torchrender as tr

SCENES = Path(__file__).resolve().parent.parent / "scenes"
sys.path.append(str(SCENES))  # the script that makes the scene is not a part of the package
import make_shadows  # noqa: E402

VERTICES = "tube.vertex_positions"


def run(
    folder: Path,
    *,
    rings: int = 192,
    corners: int = 48,
    resolution: int = 128,
    spp: int = 16,
    iterations: int = 450,
    rate: float = 0.2,
    smoothness: float = 10.0,
    save_every: int = 50,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the mean squared error of both pictures at the start and at the end.

    Args:
        folder: where pictures, the mesh and the checkpoint go.
        rings, corners: of the tube.
        resolution: pixels along either side of a picture.
        spp: samples a pixel of the rendered pictures, and of their derivative. A sample asks one of the two suns, by
            chance: a step's loss is the noise of that at last, which the error at the end, of 256 samples, has less of.
        iterations: steps of the optimiser.
        rate: how far u moves in the first steps, at most; it falls to a twentieth.
        smoothness: lambda of the large steps.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "tube": [rings, corners],
        "resolution": resolution,
        "spp": spp,
        "iterations": iterations,
        "rate": rate,
        "smoothness": smoothness,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()
    target = torch.stack([make_shadows.draw(inside, resolution) for inside in (make_shadows.heart, make_shadows.star)])
    save(torch.cat(list(target), dim=1), folder, "target")

    vertices, faces = make_shadows.tube(rings, corners)
    scene = make_shadows.make_scene(vertices, faces, resolution)
    # Light that walls and tube send each other is left out: shadows are black.
    direct = tr.DirectIllumination()
    both = ["heart_camera", "star_camera"]
    renderer = tr.Renderer(scene, integrator=direct, sensor=both, spp=spp, sampler="sobol", layout="bhwc")
    smoothing = tr.optim.MeshSmoothing(len(vertices), faces, smoothness)
    u = torch.nn.Parameter(smoothing.to_differential(vertices) if state is None else state["u"])
    # One length for the steps of all vertices: Adam's own for each entry would make the surface rough again.
    optimiser = tr.optim.UniformAdam([u], lr=rate, betas=(0.9, 0.99))
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {"loss": []}
    first = 0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)

    bar = tr.progress(range(first, iterations), desc="shadow art", initial=first, total=iterations)
    for iteration in bar:
        for group in optimiser.param_groups:
            group["lr"] = rate * 0.05 ** (iteration / iterations)
        optimiser.zero_grad()
        images = renderer(seed=generator, params={VERTICES: smoothing.from_differential(u)})
        loss = (images - target).square().mean()
        loss.backward()
        optimiser.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.4f}")

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save(torch.cat(list(images.detach()), dim=1), folder, "progress")
            save_curves(curves, folder / "loss.png", "Shadow art: squared error of both pictures")
            checkpoint.save(
                iteration=done,
                u=u.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
            )
            scene.rebuild()  # as in a process that begins here: an interrupted run finds the same bits

    found = smoothing.from_differential(u.detach())
    write_ply(folder / "tube.ply", found, faces)
    with torch.no_grad():
        images = renderer(seed=1_000_000, spp=256, params={VERTICES: found})
        save(torch.cat(list(images), dim=1), folder, "result")
        # The tube and both walls from the corner where the suns are, in a little light of the sky besides.
        scene.tube.vertex_positions = found
        scene["sky"] = {"type": "constant", "radiance": 0.3}
        (corner,) = cameras(torch.tensor([[4.0, 1.0, 4.0]]), 4 * resolution, 40.0)
        save(tr.render(scene, sensor=corner, spp=64, seed=1_000_001), folder, "corner")
    result = {"start": curves["loss"][0], "end": float((images - target).square().mean())}
    print(f"mean squared error of both shadows: {result['start']:.4f} at the start, {result['end']:.4f} now")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="a coarser tube, 48 x 48 pixels, 60 steps")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 450)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along a side (default 128)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/shadow_art"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {}
    if options.demo:
        settings |= {"rings": 96, "corners": 24, "smoothness": 3.0, "resolution": 48, "iterations": 60}
    settings |= given(options, "iterations", "resolution")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
