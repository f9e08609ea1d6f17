"""What every process of `bench.distributed` runs, under torchrun; the first prints one line of JSON."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import torch
import torch.distributed as dist

import torchrender as tr

from .ours import Ours
from .rows import ROWS

SIZES = (1 << 10, 1 << 16, 1 << 20, 1 << 24)  # bytes of sums that are timed
TIMES = ("time", "processor time")  # of a step that processes share
APART = ("time apart", "processor time apart")  # of processes that share nothing
SAMPLES = (1, 4, 16, 64)  # samples a pixel whose time tells what samples cost, and what the rest does


def step(ours: Ours, group: Any, seed: int, spp: int) -> tuple[float, float]:
    """Time and processor time of this process for an image and a gradient."""
    for parameter in ours.parameters:
        parameter.grad = None
    start, used = time.perf_counter(), time.process_time()
    settings = {**ours.renderer.settings, "spp": spp, "seed": seed}
    if group is None:
        image = tr.render(ours.scene, **settings)
    else:
        image = tr.distributed.render(ours.scene, group=group, **settings)
    image.square().mean().backward()
    return time.perf_counter() - start, time.process_time() - used


def largest(numbers: tuple[float, ...], group: Any) -> list[float]:
    """Of all processes."""
    found = torch.tensor(numbers, dtype=torch.float64)
    dist.all_reduce(found, dist.ReduceOp.MAX, group=group)
    return found.tolist()


def steps(ours: Ours, settings: dict[str, Any]) -> dict[int, dict[str, Any]]:
    """Steps by numbers of processes, in rounds that have each of them once.

    After the step that n processes share each renders and differentiates 1/n of its samples once more, by itself and at
    the same time: what the machine itself takes from processes that have nothing to do with each other.
    """
    sizes = settings["processes"]
    groups = {n: dist.new_group(list(range(n))) for n in sizes}
    found: dict[int, dict[str, Any]] = {n: {name: [] for name in (*TIMES, *APART)} for n in sizes}
    for number in range(settings["warmup"] + settings["rounds"]):
        for n in sizes:
            dist.barrier()
            if dist.get_rank() >= n:
                continue
            seconds = largest(step(ours, groups[n] if n > 1 else None, number, settings["spp"]), groups[n])
            sent = ours.scene.statistics["distributed"] if n > 1 else {"bytes": 0, "collectives": 0}
            apart = seconds
            if n > 1:
                dist.barrier(groups[n])
                seed = (number + 1) * n + dist.get_rank()
                apart = largest(step(ours, None, seed, max(1, settings["spp"] // n)), groups[n])
            if number >= settings["warmup"]:
                for name, each in zip((*TIMES, *APART), (*seconds, *apart), strict=True):
                    found[n][name].append(each)
            found[n] |= sent
    return found


def sums(rounds: int) -> list[tuple[int, list[float]]]:
    """Seconds of sums by their bytes."""
    found = []
    for size in SIZES:
        buffer, seconds = torch.zeros(size // 4), []
        for _ in range(rounds + 1):
            dist.barrier()
            start = time.perf_counter()
            dist.all_reduce(buffer)
            seconds.append(time.perf_counter() - start)
        found.append((size, seconds[1:]))
    return found


def main() -> None:
    settings = json.loads(sys.argv[1])
    torch.set_num_threads(settings["threads"])
    dist.init_process_group("gloo")
    ours = Ours.of_row(ROWS[settings["row"]], settings["resolution"], settings["spp"], **settings["renderer"])
    result: dict[str, Any] = {"steps": steps(ours, settings), "sums": sums(settings["rounds"])}
    # Processor time of one process with one thread, of as many rounds.
    torch.set_num_threads(1)
    by_samples: dict[int, list[float]] = {spp: [] for spp in SAMPLES}
    for number in range(settings["rounds"] + 1):
        for spp in SAMPLES:
            dist.barrier()
            if dist.get_rank() == 0:
                by_samples[spp].append(step(ours, None, number, spp)[1])
    if dist.get_rank() == 0:
        result["samples"] = [(spp, sorted(seconds[1:])[len(seconds) // 2 - 1]) for spp, seconds in by_samples.items()]
        print(json.dumps(result))
    dist.barrier()
    dist.destroy_process_group()


if __name__ == "__main__":
    main()
