"""Rays through a medium whose index varies: time of a step, memory, PyTorch alone beside it, and error against time.

A cube of glass, `--size` voxels along a side, and parallel rays, `--spp` for each of `--resolution` squared pixels.

step       nanoseconds a ray, step and core of the calls of the core alone, forward, and forward with adjoint
iteration  seconds and memory of 128^3 voxels, two views of 128x128 pixels, 10 samples, rays and adjoint: the example of
           the slides of Teh, O'Toole and Gkioulekas, "Adjoint nonlinear ray tracing", SIGGRAPH 2022, which give 5 s and
           12 GB for automatic differentiation on a GPU
light      seconds of two pictures that the cube throws by light tracing (`scenes/make_grin.py`), `--resolution` squared
           pixels in `--passes` of `--spp` samples and the derivative with `--spp-grad`, and memory that this adds
memory     at 100 and 10 000 steps a ray
autograd   the same rays by PyTorch alone, which keeps every step, with 32^3 voxels and 64x64 pixels
error      of where rays come out, at several lengths of a step, against an eighth of a voxel, beside the time
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import torch

import torchrender as tr

from .arguments import positive
from .bent_rays import INDEX, beam, cube, in_torch, index_of, iteration, light, loss_of, pictures
from .fresh import measure
from .measured import Measured, rounds
from .report import Result, Table

PARTS = ("step", "iteration", "light", "memory", "autograd", "error")
INTERPOLATIONS = ("cubic", "quadratic")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--size", type=positive, default=160, help="voxels along a side (default %(default)s)")
    parser.add_argument("--spp-grad", type=positive, help="samples of derivatives of `light` (default: half of --spp)")
    parser.add_argument("--passes", type=positive, default=1, help="passes of `light` (default %(default)s)")
    parser.add_argument("--part", choices=PARTS, nargs="+", default=list(PARTS), help="only these (default: all)")
    parser.add_argument("--quick", action="store_true", help="64^3 voxels, 64x64 pixels, 2 rounds")
    parser.set_defaults(threads=torch.get_num_threads(), rounds=5, warmup=1)


def step_table(options: argparse.Namespace) -> Table:
    index = index_of(options.size)
    views = [beam(options.resolution, options.spp)]
    programs = {}
    for name in INTERPOLATIONS:
        scene, leaf = cube(index, interpolation=name), index.clone().requires_grad_()
        programs[name] = lambda _, scene=scene, leaf=leaf: iteration(scene, leaf, views)
    rows: list[dict[str, Any]] = []
    for name, found in rounds(programs, options).items():
        scale = [1e9 * options.threads / n for n in found["steps"]]
        both = [a + b for a, b in zip(found["core forward"], found["core backward"], strict=True)]
        row: dict[str, Any] = {"interpolation": name, "steps a ray": found["steps"][0] / len(views[0][0])}
        row["forward, a step and core, ns"] = _scaled(found["core forward"], scale)
        row["with adjoint, a step and core, ns"] = _scaled(both, scale)
        row["forward, whole call, s"] = Measured.of(found["forward"])
        row["with adjoint, whole calls, s"] = Measured.of(
            a + b for a, b in zip(found["forward"], found["backward"], strict=True)
        )
        rows.append(row)
    title = (
        f"A step of a ray, {options.size}^3 voxels, {options.resolution}x{options.resolution}, {options.spp} rays a "
        f"pixel, {options.threads} threads, medians of {options.rounds} rounds"
    )
    notes = ["Nanoseconds are of the calls of the core alone; whole calls have what PyTorch does besides."]
    return Table(title, ["interpolation"], rows, notes, part="step")


def _scaled(seconds: list[float], scale: list[float]) -> Measured:
    return Measured.of(a * b for a, b in zip(seconds, scale, strict=True))


def _processes(options: argparse.Namespace) -> int:
    return 1 if options.quick else min(options.rounds, 3)


def iteration_table(options: argparse.Namespace) -> Table:
    size, resolution, spp = (32, 16, 2) if options.quick else (128, 128, 10)
    title = f"Rays and adjoint, {size}^3 voxels, 2 views of {resolution}x{resolution}, {spp} samples"
    return _two_views(options, title, "iteration", size, resolution, spp, "rays")


def light_table(options: argparse.Namespace) -> Table:
    size, resolution, spp = options.size, options.resolution, options.spp
    spp_grad = options.spp_grad or max(1, spp // 2)
    title = (
        f"Light tracing and its derivative, {size}^3 voxels, 2 views of {resolution}x{resolution}, "
        f"{options.passes} x ({spp} + {spp_grad}) samples"
    )
    samples = {"spp_grad": spp_grad, "passes": options.passes}
    return _two_views(options, title, "light", size, resolution, spp, "light", **samples)


def _two_views(
    options: argparse.Namespace,
    title: str,
    part: str,
    size: int,
    resolution: int,
    spp: int,
    program: str,
    **more: int,
) -> Table:
    rows: list[dict[str, Any]] = []
    for name in INTERPOLATIONS:
        settings: dict[str, Any] = {"size": size, "resolution": resolution, "spp": spp, "threads": options.threads}
        settings |= {"views": 2, "interpolation": name, "program": program, **more}
        runs = [measure("bent_rays", **settings) for _ in range(_processes(options))]
        row: dict[str, Any] = {"interpolation": name, "one iteration s": Measured.of(r["seconds"] for r in runs)}
        row["peak above the state before MiB"] = Measured.of(r["peak"] for r in runs)
        row["of that, the gradient MiB"] = runs[0]["gradient"]
        rows.append(row | {"gradient, norm": runs[0]["norm"]})
    notes = ["In fresh processes; seconds are of the second iteration, memory that of both at its peak."]
    return Table(f"{title}, {options.threads} threads", ["interpolation"], rows, notes, part=part)


def memory_table(options: argparse.Namespace) -> Table:
    rows: list[dict[str, Any]] = []
    counts = (100, 1000) if options.quick else (100, 10_000)
    for steps in counts:
        # rays cross 100 voxels, of few across, so that the memory is that of rays
        settings: dict[str, Any] = {"size": 100, "across": 10, "resolution": 64, "spp": 1, "views": 1}
        settings |= {"threads": options.threads, "step": 100 / steps}
        runs = [measure("bent_rays", **settings) for _ in range(_processes(options))]
        row: dict[str, Any] = {"steps, about": steps, "steps a ray": runs[0]["steps"] / 64**2}
        row["peak above the state before MiB"] = min(r["peak"] for r in runs)
        rows.append(row | {"one iteration s": Measured.of(r["seconds"] for r in runs)})
    title = f"Memory of rays and adjoint, 100x10x10 voxels, 64x64 rays, {options.threads} threads"
    return Table(
        title,
        ["steps, about"],
        rows,
        ["In fresh processes; memory is that of the one that took the least: allocators add some MiB, or do not."],
        part="memory",
    )


def autograd_table(options: argparse.Namespace) -> Table:
    rows: list[dict[str, Any]] = []
    for size, resolution in [(16, 16)] if options.quick else [(32, 64), (64, 128)]:
        settings: dict[str, Any] = {"size": size, "resolution": resolution, "spp": 1, "threads": options.threads}
        ours, plain = (measure("bent_rays", **settings, views=1, program=by) for by in ("rays", "plain"))
        for who, found in (("ours", ours), ("PyTorch alone", plain)):
            row: dict[str, Any] = {"case": f"{size}^3, {resolution}^2 rays", "program": who}
            row |= {"one iteration s": found["seconds"], "peak above the state before MiB": found["peak"]}
            row |= {"time / ours": found["seconds"] / ours["seconds"]}
            row |= {"memory / ours": found["peak"] / ours["peak"] if ours["peak"] else None}
            rows.append(row | {"gradient, norm": found["norm"]})
    title = f"Beside automatic differentiation, {options.threads} threads"
    notes = ["Fresh processes; seconds are of the fastest of several iterations after the first."]
    return Table(title, ["case", "program"], rows, notes, part="autograd")


def error_table(options: argparse.Namespace) -> Table:
    index = index_of(options.size)
    few = beam(min(options.resolution, 32), 1)
    many = beam(options.resolution, options.spp)
    exact = tuple(x.double() for x in few)
    rows: list[dict[str, Any]] = []
    for name in INTERPOLATIONS:

        def found(step: float, name: str = name) -> tr.gradientindex.BentRays:
            scene = cube(index.double(), torch.float64, interpolation=name, step=step)
            return tr.gradientindex.trace(scene, "cube", *exact)

        reference = found(1 / 8)
        for step in (2.0, 1.0, 0.5):
            rays = found(step)
            both = rays.valid & reference.valid
            off = (rays.position - reference.position)[both].norm(dim=1) * options.size / 2
            turned = (rays.direction - reference.direction)[both].norm(dim=1)
            scene, leaf = cube(index, interpolation=name, step=step), index.clone().requires_grad_()
            seconds = []
            for _ in range(min(options.rounds, 3)):
                times = iteration(scene, leaf, [many])
                seconds.append(times["forward"] + times["backward"])
            row: dict[str, Any] = {"interpolation": name, "step, voxels": step}
            row |= {"position, rms, voxels": off.square().mean().sqrt().item(), "at most, voxels": off.max().item()}
            row["direction, rms, rad"] = turned.square().mean().sqrt().item()
            rows.append(row | {"rays and adjoint s": Measured.of(seconds)})
    title = (
        f"Error against steps of an eighth of a voxel, {options.size}^3 voxels, and time of "
        f"{options.resolution}x{options.resolution} pixels, {options.spp} rays each, {options.threads} threads"
    )
    notes = ["Errors in float64, of the steps alone; time in float32, of whole calls."]
    return Table(title, ["interpolation", "step, voxels"], rows, notes, part="error")


def fresh(
    size: int,
    resolution: int,
    spp: int,
    threads: int,
    views: int,
    interpolation: str = "cubic",
    step: float = 1.0,
    program: str = "rays",
    across: int | None = None,
    spp_grad: int = 1,
    passes: int = 1,
) -> dict[str, float]:
    """In a process of its own: seconds of an iteration, the first one not counted, and MiB that iterations add.

    `program`: "rays", "light" (pictures by light tracing), or "plain" (rays by PyTorch alone); `across`: voxels along x
    and y, if not `size`; `spp_grad`, `passes`: of light tracing.
    """
    from .serving import memory, settled_memory

    torch.set_num_threads(threads)
    torch.ones(3, requires_grad=True).square().sum().backward()
    index = index_of(size)[:, :across, :across].contiguous()
    scene, leaf = cube(index, interpolation=interpolation, step=step), index.clone().requires_grad_()
    beams = [beam(resolution, spp, view) for view in range(views)] if program != "light" else []
    lit = pictures(index, resolution, interpolation)[:views] if program == "light" else []

    def run() -> float:
        if program == "rays":
            return iteration(scene, leaf, beams)["steps"]
        if program == "light":
            light(lit, leaf, spp, spp_grad, passes)
            return 0.0
        leaf.grad = None
        position, direction, steps = in_torch(leaf, *beams[0], step, interpolation)
        loss_of(position, direction).backward()
        return float(steps * len(position))

    with torch.no_grad():  # what is made once: the scene in the core, threads, code that PyTorch loads
        few = tuple(x[:16] for x in beam(4, 1))
        tr.gradientindex.trace(scene, "cube", few[0], few[1], params={INDEX: leaf})
        in_torch(index_of(4), few[0], few[1])
        for other in lit:
            tr.render(other, spp=1, seed=0)
    before = settled_memory()
    seconds, steps = [], 0.0
    for _ in range(4 if resolution <= 64 and step == 1.0 else 2):
        start = time.perf_counter()
        steps = run()
        seconds.append(time.perf_counter() - start)
    peak = max(0.0, memory("VmHWM") - before)
    gradient = leaf.grad
    if gradient is None:
        raise RuntimeError("there is no gradient")
    found = {"seconds": min(seconds[1:]), "peak": peak, "steps": steps, "norm": float(gradient.norm())}
    return {**found, "gradient": gradient.numel() * 4 / 2**20}


def run(options: argparse.Namespace) -> Result:
    if options.renderer or options.only:
        raise SystemExit("gradient_index: there is one scene, which is not rendered: --only and --set have no meaning")
    if options.quick:
        options.size, options.resolution, options.rounds = min(options.size, 64), min(options.resolution, 64), 2
    torch.set_num_threads(options.threads)
    tables = {
        "step": step_table,
        "iteration": iteration_table,
        "light": light_table,
        "memory": memory_table,
        "autograd": autograd_table,
        "error": error_table,
    }
    return Result([tables[part](options) for part in PARTS if part in options.part])
