"""Resident memory over many steps of one optimisation with changing textures, vertices and scene edits.

Each step is an image of 16x16 pixels, its derivative and a step of Adam; vertices move in every second step, the
texture is replaced by one of another size in every 50th, a mesh by one of another number of vertices in every 100th,
and a light is taken out and put back in every 200th. A tenth of the steps does not count for the curve.
"""

from __future__ import annotations

import argparse
import os
import time
from statistics import fmean

import torch

import torchrender as tr

from .arguments import positive
from .report import Result, Table

RENDERS = False  # no common options
POINTS = 20  # of the curve
LIMIT = 5.0  # MB that memory may grow by
LAMP = {"type": "point", "position": [0.5, 0.5, 2.0], "intensity": 3.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--steps", type=positive, default=1_000_000, help="default 1000000")
    parser.add_argument("--seconds", type=positive, help="end after so many seconds")


def sheet(n: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Vertices, faces and texture coordinates of n x n squares."""
    line = torch.linspace(0, 1, n + 1)
    v, u = (grid.reshape(-1) for grid in torch.meshgrid(line, line, indexing="ij"))
    corner = (torch.arange(n)[:, None] * (n + 1) + torch.arange(n)).reshape(-1, 1)
    faces = torch.cat([corner + torch.tensor([[0, 1, n + 2]]), corner + torch.tensor([[0, n + 2, n + 1]])])
    return torch.stack([2 * u - 1, 2 * v - 1, torch.zeros_like(u)], 1), faces, torch.stack([u, v], 1)


def make_scene() -> tr.Scene:
    vertices, faces, texcoords = sheet(6)
    paper = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": grey(8)}}}
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 40, "to_world": tr.Transform.look_at([0, -1, 3], [0, 0, 0], [0, 1, 0])}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "camera": {**camera, "film": film},
            "sky": {"type": "constant", "radiance": 0.5},
            "lamp": LAMP,
            "sheet": tr.Mesh(vertices, faces, vertex_texcoords=texcoords, bsdf=paper),
        }
    )


def grey(size: int) -> torch.Tensor:
    return torch.full((size, size + 1, 3), 0.5)


def edit(scene: tr.Scene, step: int) -> bool:
    """The edits of a step; whether parameters are new."""
    new = False
    if step % 100 == 0:
        vertices, faces, texcoords = sheet(4 + step // 100 % 5)
        scene["sheet"] = tr.Mesh(vertices, faces, vertex_texcoords=texcoords, bsdf=scene.sheet.bsdf)
        new = True
    if step % 50 == 0:
        scene.sheet.bsdf.brdf_0.reflectance.data = grey(4 + step // 50 % 9)
        new = True
    if step % 200 == 0:
        del scene["lamp"]
    elif step % 200 == 10:
        scene["lamp"] = LAMP
    if step % 2:
        with torch.no_grad():
            scene.sheet.vertex_positions[:, 2] = 0.1 * torch.sin(0.1 * step + 4 * scene.sheet.vertex_positions[:, 0])
    return new


def resident() -> float:
    """MB of this process that are in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(1)
    scene = make_scene()
    start = time.monotonic()
    curve: list[tuple[int, float]] = []
    optimiser: torch.optim.Optimizer | None = None
    every = max(1, options.steps // 1000)
    step = 0
    while step < options.steps and time.monotonic() - start < (options.seconds or 1e9):
        if edit(scene, step) or optimiser is None:
            optimiser = torch.optim.Adam(scene.train_only("sheet.bsdf.*.data"), lr=1e-3)
        optimiser.zero_grad()
        (tr.render(scene, spp=1, seed=step, range="ignore") - 0.4).square().mean().backward()
        optimiser.step()
        step += 1
        if step % every == 0:
            curve.append((step, resident()))
    counted = [point for point in curve if point[0] > step / 10]
    if len(counted) < POINTS:
        raise SystemExit(f"--steps: {step} steps are too few for a curve of {POINTS} points")
    rows = []
    for i in range(POINTS):  # means over parts of the curve, so that single pages do not show
        part = counted[len(counted) * i // POINTS : len(counted) * (i + 1) // POINTS]
        rows.append({"steps": part[-1][0], "resident MB": fmean(mb for _, mb in part)})
    grown = rows[-1]["resident MB"] - rows[0]["resident MB"]
    verdict = "flat" if grown < LIMIT else "GROWN"
    notes = [f"{verdict}: {grown:+.2f} MB over {step} steps (limit {LIMIT:g} MB), {time.monotonic() - start:.0f} s"]
    plot = {"kind": "lines", "x": "steps", "columns": ["resident MB"], "y": "MB"}
    return Result([Table(f"Resident memory over {step} steps", ["steps"], rows, notes, plot)])
