"""Many processes, on one machine or many, fit one texture: each looks at its share of the pictures.

    torchrun --nproc-per-node 2 tutorials/many_machines.py           # two processes on this machine
    torchrun --nproc-per-node 2 tutorials/many_machines.py --demo    # the same, smaller
    python tutorials/many_machines.py                                # one process, which finds the same

The monkey of `textured_monkey.py` is photographed from all around. In every step each process renders its pictures and
their derivative; `torch.nn.parallel.DistributedDataParallel` averages the gradients, and all processes take the same
step. Which samples a picture has depends on the step and on the picture, not on the process, so that any number of
processes finds the same, to rounding.

The first process writes checkpoints. If a process dies, its neighbours notice when they wait for its gradient, and
torchrun begins all of them again (``--max-restarts 3``; in its environment TORCH_DISABLE_SHARE_RDZV_TCP_STORE=1, see
docs/many_machines.md), which go on from the checkpoint: whichever process is killed, and whenever, the end is the same,
bit for bit.

What changes on other machines is the command. On four of them, each with 2 processes of 8 threads:

    torchrun --nnodes 4 --nproc-per-node 2 --rdzv-backend c10d --rdzv-endpoint FIRST:29500 \\
        --max-restarts 3 tutorials/many_machines.py --threads 8

docs/many_machines.md has the same for SLURM, and what changes with NCCL: one word.
"""

from __future__ import annotations

import argparse
import inspect
import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from pictures import save, save_curves
from textured_monkey import SCENE, TEXTURE, add_cameras, painted_texture, psnr, seen_texels
from torch.nn.parallel import DistributedDataParallel

import torchrender as tr


@contextmanager
def processes() -> Iterator[tuple[int, int]]:
    """The number of this process and how many there are: those that torchrun has started, or this one alone."""
    if "RANK" not in os.environ:
        yield 0, 1
        return
    dist.init_process_group("gloo")  # renderings lie on the CPU; NCCL beside it, for networks: "cpu:gloo,cuda:nccl"
    try:
        yield dist.get_rank(), dist.get_world_size()
    finally:
        dist.destroy_process_group()


def averaging(renderer: tr.Renderer) -> Any:
    """The renderer with gradients that are averaged over processes."""
    # Buffers are the faces of meshes: the same everywhere already. The option has a new name in newer versions.
    new = "forward_sync_buffers" in inspect.signature(DistributedDataParallel).parameters
    once: dict[str, Any] = {"forward_sync_buffers" if new else "broadcast_buffers": False}
    return DistributedDataParallel(renderer, **once)


def run(
    folder: Path,
    *,
    texture_size: int = 256,
    resolution: int = 128,
    view_count: int = 8,
    spp: int = 16,
    iterations: int = 150,
    target_spp: int = 256,
    rate: float = 0.06,
    threads: int | None = None,
    save_every: int = 10,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program, by all processes; returns the PSNR of the texture in dB at the start and at the end.

    Args:
        folder: where pictures and the checkpoint go; the same one on a disk that all machines see.
        texture_size, resolution: texels and pixels along a side.
        view_count: pictures that are given, a multiple of the number of processes, which share them.
        spp: samples a pixel of the rendered pictures, and of their derivative.
        iterations: steps of the optimiser.
        target_spp: samples a pixel of the given pictures.
        rate: learning rate at the start; it falls to zero along a cosine.
        threads: of each process; None leaves what torchrun says.
        save_every: iterations after which a checkpoint is written.
        restart: begin anew, whatever checkpoint there is.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    with processes() as (rank, size):
        if view_count % size:
            raise ValueError(f"--views: expected a multiple of the {size} processes, got {view_count}")
        folder.mkdir(parents=True, exist_ok=True)
        settings: dict[str, Any] = {"texture": texture_size, "resolution": resolution, "views": view_count}
        settings |= {"samples": [spp, target_spp], "iterations": iterations, "rate": rate}
        begins = restart and rank == 0 and os.environ.get("TORCHELASTIC_RESTART_COUNT", "0") == "0"
        checkpoint = Checkpoint(folder / "checkpoint.pt", settings, begins)
        if size > 1:
            dist.barrier()  # an old checkpoint is gone for all
        state = checkpoint.load()

        scene = tr.load_file(SCENE, resolution=resolution)
        scene["sky"] = {"type": "constant", "radiance": 0.5}
        views = add_cameras(scene, view_count, resolution)
        mine = range(rank, view_count, size)  # the pictures of this process
        renderer = tr.Renderer(scene, spp=spp, layout="chw")
        painted = painted_texture(texture_size)
        with torch.no_grad():
            targets = {
                i: renderer(sensor=views[i], seed=1_000_000 + i, spp=target_spp, params={TEXTURE: painted})
                for i in mine
            }
        mask = seen_texels(renderer, painted, views)

        bitmap = scene["monkey"].bsdf.brdf_0.reflectance
        start = torch.full((texture_size, texture_size, 3), 0.5) if state is None else state["texture"]
        bitmap.data = torch.nn.Parameter(start)
        (texture,) = scene.train_only(TEXTURE)
        parallel = averaging(renderer) if size > 1 else renderer
        optimiser = torch.optim.Adam([texture], lr=rate, betas=(0.9, 0.95))
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
        curves: dict[str, list[float]] = {"loss": []}
        first = 0
        if state is not None:
            curves, first = checkpoint.restore(state, iterations, optimiser)
            schedule.load_state_dict(state["schedule"])

        bar = tr.progress(range(first, iterations), desc="many machines", initial=first, total=iterations)
        for iteration in bar:
            optimiser.zero_grad()
            losses = []
            for number, i in enumerate(mine):
                # A seed for each step and picture. Gradients are added up, and exchanged once, with the last picture.
                last = number == len(mine) - 1
                with nullcontext() if last or parallel is renderer else parallel.no_sync():
                    image = parallel(sensor=views[i], seed=iteration * view_count + i)
                    loss = (image - targets[i]).square().mean() / len(mine)
                    loss.backward()
                losses.append(loss.detach())
            optimiser.step()
            schedule.step()
            with torch.no_grad():
                texture.clamp_(0.0, 1.0)
            total = torch.stack(losses).sum() / size
            if size > 1:
                dist.all_reduce(total)
            curves["loss"].append(total.item())
            bar.set_postfix(loss=f"{total.item():.3g}")
            done = iteration + 1
            if rank == 0 and (done % save_every == 0 or done == iterations):
                checkpoint.save(
                    iteration=done,
                    texture=texture.detach(),
                    optimiser=optimiser.state_dict(),
                    schedule=schedule.state_dict(),
                    curves=curves,
                )

        # One picture by all of them: each traces its share of the samples, and all have the whole.
        with torch.no_grad():
            settings = {"sensor": views[0], "seed": 1_000_002, "spp": 64}
            picture = tr.distributed.render(scene, **settings) if size > 1 else tr.render(scene, **settings)
        found = texture.detach()
        grey = torch.full_like(painted, 0.5)
        result = {"start": psnr(grey, painted, mask), "end": psnr(found, painted, mask), "processes": float(size)}
        if rank == 0:
            save(picture, folder, "result")
            save(painted, folder, "texture_target")
            save(torch.where(mask[..., None], found, 1.0), folder, "texture_result")
            save_curves(curves, folder / "loss.png", f"{view_count} pictures, {size} processes")
            print(f"PSNR of the texture where it is seen: {result['start']:.1f} dB, then {result['end']:.1f} dB")
        return result


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="fewer texels, pixels and steps")
    parser.add_argument("--iterations", type=at_least_one, help="steps of the optimiser (default 150)")
    parser.add_argument("--views", type=at_least_one, default=8, help="pictures that are given (default 8)")
    parser.add_argument("--threads", type=at_least_one, help="threads of each process (default: what torchrun says)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/many_machines"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"view_count": options.views, "threads": options.threads}
    if options.demo:
        settings |= {"texture_size": 64, "resolution": 64, "iterations": 100, "target_spp": 64}
    settings |= given(options, "iterations")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
