"""Find albedos that make a picture appear in a translucent block.

    python tutorials/slab.py            # 16 x 64 x 64 voxels of three colours
    python tutorials/slab.py --full     # 64 x 256 x 256 voxels, 128 x 128 pixels, 6 passes of 16 + 4 samples

The block is a hundred mean free paths thick, of something like wax, behind a rough surface. Light enters anywhere,
scatters hundreds of times and leaves somewhere else, so that every voxel has a part in many pixels, and a picture that
is painted into it is blurred. We are given a photograph of such a block and find the albedo of each of its voxels.

As in `smoke.py`, a long run leaves pictures on its way and goes on from its checkpoint when it is started again.
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
from volumes import SCENES, make_media, psnr, volume_of

import torchrender as tr

ALBEDO = "slab.interior_medium.albedo.data"
GROW_AT = (0.2, 0.5)  # parts of the run after which the grid becomes twice as fine


def front_of(albedo: torch.Tensor) -> torch.Tensor:
    """What lies under the front of the block, as a picture: the mean of the nearest eighth of (Z, Y, X, 3)."""
    low, high = make_media.ALBEDOS
    near = albedo.detach()[-max(1, len(albedo) // 8) :].mean(0).flip(0)
    return ((near - low) / (high - low)).clamp(0, 1)


def run(
    folder: Path,
    *,
    size: tuple[int, int, int] = (64, 256, 256),
    resolution: int = 128,
    spp: int = 16,
    spp_grad: int = 4,
    passes: int = 6,
    iterations: int = 170,
    target_spp: int = 1024,
    rate: float = 0.2,
    max_depth: int = 1024,
    save_every: int = 10,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns the PSNR in dB of the picture, at the start and at the end.

    Args:
        folder: where pictures, the found volume and the checkpoint go.
        size: voxels (Z, Y, X), multiples of 4; the first grid has a quarter of each.
        resolution: pixels along either side of the picture.
        spp, spp_grad, passes: samples a pixel of picture and derivative in a pass, and passes of an iteration.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given picture.
        rate: learning rate at the start; it falls to zero along a cosine.
        max_depth: longest path in segments.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "size": list(size),
        "resolution": resolution,
        "samples": [spp, spp_grad, passes, target_spp],
        "iterations": iterations,
        "rate": rate,
        "max_depth": max_depth,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()

    scene = tr.load_file(SCENES / "slab.xml", resolution=resolution, max_depth=max_depth)
    renderer = tr.Renderer(scene, spp=spp, spp_grad=spp_grad, passes=passes)
    if state is None:
        truth = volume_of(make_media.slab_albedo(*size))
        with torch.no_grad():
            target = renderer(seed=1_000_000, spp=16, passes=max(1, target_spp // 16), params={ALBEDO: truth})
        save(front_of(truth), folder, "albedo_target")
    else:
        target = state["target"]
    save(target, folder, "target")

    # Albedos stay between bounds: the optimiser moves numbers without any, of which a sigmoid makes albedos. Near an
    # albedo of 1 a path in a thick medium hardly ends, so that the upper bound also bounds the time.
    bounded = tr.constraints.ScaledSigmoid(0.6, 0.995)
    coarse = tuple(n // 4 for n in size)
    grey = bounded.right_inverse(torch.full((*coarse, 3), 0.85))
    raw = torch.nn.Parameter(grey if state is None else state["raw"])
    # The derivatives of a mean by single voxels are tiny, next to which Adam's usual epsilon would be large.
    optimiser = torch.optim.Adam([raw], lr=rate, betas=(0.9, 0.95), eps=1e-20)
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {"loss": []}
    first, start_psnr = 0, 0.0
    if state is not None:
        curves, first = checkpoint.restore(state, iterations, optimiser, generator)
        start_psnr = state["start_psnr"]

    def picture(seed: int) -> torch.Tensor:
        with torch.no_grad():
            return renderer(seed=seed, passes=max(passes, 32), params={ALBEDO: bounded(raw)})

    if state is None:
        start = picture(1_000_001)
        start_psnr = psnr(start, target)
        save(start, folder, "start")

    grow_at = {round(part * iterations) for part in GROW_AT}
    bar = tr.progress(range(first, iterations), desc="slab", initial=first, total=iterations)
    for iteration in bar:
        if iteration in grow_at and len(raw) < size[0]:
            finer = tuple(2 * n for n in raw.shape[:3])
            raw = tr.optim.upsample_tensor(raw, finer, optimiser, wrap_mode="clamp")
        for group in optimiser.param_groups:
            group["lr"] = rate * 0.5 * (1 + math.cos(math.pi * iteration / iterations))
        optimiser.zero_grad()
        image = renderer(seed=generator, params={ALBEDO: bounded(raw)})
        loss = (image - target).square().mean()
        loss.backward()
        optimiser.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", grid="x".join(map(str, raw.shape[:3])))

        done = iteration + 1
        if done % save_every == 0 or done == iterations:
            save(image, folder, "progress")
            save(front_of(bounded(raw)), folder, f"albedo_{done:04d}")
            save_curves(curves, folder / "loss.png", f"Slab: {' x '.join(map(str, size))} albedos from one picture")
            checkpoint.save(
                iteration=done,
                raw=raw.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
                start_psnr=start_psnr,
                target=target,
            )

    albedo = bounded(raw).detach()
    tr.io.write_volume(folder / "albedo.vol", albedo)
    save(front_of(albedo), folder, "albedo_result")
    found = picture(1_000_002)
    save(found, folder, "result")
    result = {"start": start_psnr, "end": psnr(found, target), "loss": curves["loss"][-1]}
    print(f"PSNR of the picture: {result['start']:.1f} dB at the start, {result['end']:.1f} dB now")
    return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--full", action="store_true", help="64 x 256 x 256 voxels, 6 passes of 16 + 4 spp")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 80, with --full 170)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/slab"), help="folder for the pictures")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"iterations": options.iterations or (170 if options.full else 80)}
    if not options.full:
        settings |= {"size": (16, 64, 64), "resolution": 64, "spp_grad": 16, "passes": 1}
    with reported(parser, "pictures", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
