"""Recover the density of smoke from nine pictures taken around it.

    python tutorials/smoke.py            # 64^3 voxels, smaller pictures
    python tutorials/smoke.py --full     # 128^3 voxels, 128 x 128 pixels, 8 passes of 64 + 16 samples: for a night

We photograph smoke from nine sides, forget it, start from a thin haze, and let gradient descent change every voxel
until the nine pictures are the same. Light scatters many times in smoke, and a voxel darkens what lies behind it and
brightens what lies beside it: the derivative of the volumetric path tracer knows all of that, also where there is no
smoke yet.

A long run leaves pictures on its way, and a checkpoint. Started again after it was ended, or killed, it goes on there,
and finds what it would have found in one go.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from checkpoints import Checkpoint
from command_line import at_least_one, reported
from pictures import save, save_curves
from volumes import SCENES, make_media, projections, psnr, turntable, volume_of

import torchrender as tr

DENSITY = "smoke.interior_medium.sigma_t.data"
HELD_BACK = make_media.VIEWS  # the sensor after those of the ring
GROW_AT = (0.04, 0.16)  # parts of the run after which the grid becomes twice as fine


def run(
    folder: Path,
    *,
    size: int = 128,
    resolution: int = 128,
    views_per_step: int = make_media.VIEWS,
    spp: int = 64,
    spp_grad: int = 16,
    passes: int = 8,
    iterations: int = 250,
    target_spp: int = 2048,
    rate: float = 0.2,
    max_depth: int = 256,
    save_every: int = 10,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the PSNR in dB of a picture that was not given, at the start and at the end.

    Args:
        folder: where pictures, the found volume and the checkpoint go.
        size: voxels along each side, a multiple of 4; the first grid has a quarter of that.
        resolution: pixels along either side of every picture.
        views_per_step: how many of the nine pictures an iteration looks at, at random.
        spp, spp_grad, passes: samples a pixel of picture and derivative in a pass, and passes of an iteration.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.
        max_depth: longest path in segments.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "size": size,
        "resolution": resolution,
        "views_per_step": views_per_step,
        "samples": [spp, spp_grad, passes, target_spp],
        "iterations": iterations,
        "rate": rate,
        "max_depth": max_depth,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()

    scene = tr.load_file(SCENES / "smoke.xml", resolution=resolution, max_depth=max_depth)
    scale = float(scene.get_parameter("smoke.interior_medium.scale"))
    truth = volume_of(make_media.smoke(size))
    renderer = tr.Renderer(scene, spp=spp, spp_grad=spp_grad, passes=passes)
    save(projections(truth, 2 * scale), folder, "density_target")

    # The given pictures, and one more from a place in between, which only judges the result.
    if state is None:
        with torch.no_grad():
            targets = torch.stack(
                [
                    renderer(
                        sensor=view, seed=1_000_000, spp=64, passes=max(1, target_spp // 64), params={DENSITY: truth}
                    )
                    for view in tr.progress(range(HELD_BACK + 1), desc="pictures")
                ]
            )
    else:
        targets = state["targets"]
    save(targets[0], folder, "target")
    save(targets[HELD_BACK], folder, "held_back_target")

    # The optimiser moves numbers without bounds, of which a sigmoid makes densities from 0 to 1. A thin haze is a
    # better start than dense smoke: light reaches every voxel, and pictures see through to the other side.
    bounded = tr.constraints.UnitInterval()
    coarse = size // 4
    haze = bounded.right_inverse(torch.full((coarse, coarse, coarse, 1), 0.01))
    raw = torch.nn.Parameter(haze if state is None else state["raw"])
    # A mean over many pixels has tiny derivatives by voxels, next to which Adam's usual epsilon would be large.
    optimiser = torch.optim.Adam([raw], lr=rate, betas=(0.9, 0.95), eps=1e-20)
    # Which views, and the seeds of the samples: all chance in the loop comes from this generator.
    generator = torch.Generator().manual_seed(0)
    curves: dict[str, list[float]] = {"loss": []}
    first, start_psnr = 0, 0.0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)
        start_psnr = state["start_psnr"]

    def picture(view: int, seed: int) -> torch.Tensor:
        with torch.no_grad():
            return renderer(sensor=view, seed=seed, spp=64, params={DENSITY: bounded(raw)})

    if state is None:
        start_psnr = psnr(picture(HELD_BACK, 1_000_001), targets[HELD_BACK])

    grow_at = {round(part * iterations) for part in GROW_AT}
    bar = tr.progress(range(first, iterations), desc="smoke", initial=first, total=iterations)
    for iteration in bar:
        if iteration in grow_at and len(raw) < size:
            # Coarse to fine: the coarse grids find the shape with less noise in every voxel. The moments of the
            # optimiser grow with the grid, so that nothing is forgotten.
            finer = (2 * len(raw),) * 3
            raw = tr.optim.upsample_tensor(raw, finer, optimiser, wrap_mode="clamp")
        for group in optimiser.param_groups:
            group["lr"] = rate * 0.5 * (1 + math.cos(math.pi * iteration / iterations))
        optimiser.zero_grad()
        chosen = torch.randperm(make_media.VIEWS, generator=generator)[:views_per_step].sort().values.tolist()
        # Picture and derivative come from independent samples, which makes the gradient of the squared error unbiased.
        # `passes` averages independent passes in the memory of one.
        images = renderer(sensor=chosen, seed=generator, params={DENSITY: bounded(raw)}, layout="bhwc")
        loss = (images - targets[chosen]).square().mean()
        loss.backward()
        optimiser.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", grid=f"{len(raw)}^3")

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save(images[0], folder, "progress")
            save(projections(bounded(raw), 2 * scale), folder, f"density_{done:04d}")
            save_curves(curves, folder / "loss.png", f"Smoke: {size}^3 densities from {make_media.VIEWS} pictures")
            checkpoint.save(
                iteration=done,
                raw=raw.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
                start_psnr=start_psnr,
                targets=targets,
            )

    density = bounded(raw).detach()
    tr.io.write_volume(folder / "density.vol", density)
    save(projections(density, 2 * scale), folder, "density_result")
    save(picture(0, 1_000_002), folder, "result")
    held_back = picture(HELD_BACK, 1_000_003)
    save(held_back, folder, "held_back_result")
    strips = [turntable(renderer, resolution, params={DENSITY: volume}) for volume in (density, truth)]
    save(torch.cat(strips), folder, "turntable")

    result = {"start": start_psnr, "end": psnr(held_back, targets[HELD_BACK]), "loss": curves["loss"][-1]}
    found = tr.optim.resample(density, (size,) * 3, "clamp")
    result["density"] = psnr(found, truth)
    print(f"PSNR of a picture that was not given: {result['start']:.1f} dB at the start, {result['end']:.1f} dB now")
    print(f"PSNR of the densities: {result['density']:.1f} dB")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="128^3 voxels, 128 x 128 pixels, 8 passes of 64 + 16 spp")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 100, with --full 250)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/smoke"), help="folder for the pictures")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"iterations": options.iterations or (250 if options.full else 100)}
    if not options.full:
        settings |= {"size": 64, "resolution": 64, "spp": 16, "spp_grad": 8, "passes": 1, "target_spp": 1024}
    with reported(parser, "pictures", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
