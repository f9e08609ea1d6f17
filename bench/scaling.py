"""How time grows: with samples, pixels, threads, triangles, and the size of a texture with a gradient at every texel.

Times are those of one forward and one backward pass. Over samples and pixels a straight line is fitted: its offset is
the fixed cost of a call, its slope the marginal cost of a sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch.nn.functional import interpolate

import torchrender as tr

from .arguments import counts_argument, peer_argument
from .embree_alone import Pair
from .measured import Measured, fit_line, rounds
from .meshes import bumpy_sphere
from .ours import Ours, chosen
from .peers import Peer, Peers
from .report import Result, Table
from .rows import ROWS, Row
from .scene_arrays import load_peer

PARTS = ("samples", "pixels", "threads", "triangles", "texture")
DISTINCT = (ROWS[0], ROWS[1], ROWS[3])  # the rows with different geometry
SMALLEST = 64  # pixels along a side where the number of samples varies


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--part", choices=PARTS, action="append", help="only this part; several may be given")
    counts_argument(parser, "--samples", [1, 4, 16, 64, 256, 1024], f"samples of each of {SMALLEST}x{SMALLEST} pixels")
    counts_argument(parser, "--sides", [64, 128, 256, 512, 1024], "pixels along a side")
    counts_argument(parser, "--triangles", [10**3, 10**4, 10**5, 10**6], "triangles of a mesh")
    parser.add_argument("--largest", action="store_true", help="10^7 triangles as well (several GB of memory)")
    counts_argument(parser, "--texels", [256, 512, 1024, 2048, 4096], "texels along a side of a texture")
    peer_argument(parser)  # over samples and pixels
    parser.set_defaults(rounds=5, warmup=1)


def scenes(options: argparse.Namespace) -> list[Row]:
    """The rows asked for; without `--only` one of each geometry."""
    return [row for row in chosen(options) if options.only or row in DISTINCT]


def timed_step(ours: Ours, seed: int) -> dict[str, float]:
    return {"step": sum(ours.step(seed).values())}


def timings(programs: dict[Any, Callable[[int], dict[str, float]]], options: argparse.Namespace) -> dict[Any, Measured]:
    """Seconds of a step of every program, in alternating rounds."""
    return {who: Measured.of(times["step"]) for who, times in rounds(programs, options).items()}


def sample_rows(
    row: Row, points: list[tuple[int, int]], peers: list[Peer], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Time over the number of samples; `points` are (pixels along a side, samples a pixel)."""
    programs = {point: partial(timed_step, Ours.of_row(row, *point, **dict(options.renderer))) for point in points}
    rows = fitted(row, "ours", timings(programs, options))
    for peer in peers:  # one point after the other: it has one scene at a time
        measured = {}
        for point in points:
            load_peer(peer, row, *point)
            measured |= timings({point: lambda n, p=peer: {"step": sum(p.ask("step", seed=n).values())}}, options)
        rows += fitted(row, peer.title, measured)
    return rows


def fitted(row: Row, who: str, measured: dict[tuple[int, int], Measured]) -> list[dict[str, Any]]:
    """Table rows of one program and scene: its times and what a straight line through them says."""
    points = list(measured)
    counts = {(side, spp): side * side * spp for side, spp in points}
    fixed, slope = 0.0, 0.0
    if len(set(counts.values())) > 1:
        fixed, slope = fit_line([counts[p] for p in points], [measured[p].median for p in points])
    rows = []
    for point in points:
        marginal = (measured[point].median - fixed) / counts[point]
        rows.append(
            {
                "scene": row.name,
                "program": who,
                "pixels": f"{point[0]}²",
                "spp": point[1],
                "samples": counts[point],
                "step ms": measured[point].scaled(1e3),
                "without the fixed cost, a sample, in ns": 1e9 * marginal,
                "of the fit's slope": marginal / slope if slope else None,
                "fixed cost, in ms": 1e3 * fixed,
            }
        )
    return rows


def sample_table(part: str, peers: list[Peer], options: argparse.Namespace) -> Table:
    points = [(SMALLEST, spp) for spp in options.samples]
    title = f"Samples: {SMALLEST}x{SMALLEST} pixels"
    if part == "pixels":
        points = [(side, options.spp) for side in options.sides]
        title = f"Pixels: {options.spp} spp"
    rows = [entry for row in scenes(options) for entry in sample_rows(row, points, peers, options)]
    columns = ["without the fixed cost, a sample, in ns"]
    plot = {"kind": "lines", "x": "samples", "columns": columns, "by": ["scene", "program"], "y": "ns a sample"}
    title = f"{title}, {options.threads} threads, forward and backward"
    return Table(title, ["scene", "program", "pixels", "spp"], rows, [], plot, part)


def thread_table(options: argparse.Namespace) -> Table:
    """Time over the number of threads."""
    numbers = sorted({*(1 << k for k in range(options.threads.bit_length())), options.threads})
    rows = []
    for row in scenes(options):
        ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))

        def step(threads: int, seed: int, ours: Ours = ours) -> dict[str, float]:
            torch.set_num_threads(threads)
            return timed_step(ours, seed)

        measured = timings({n: partial(step, n) for n in numbers if n <= options.threads}, options)
        torch.set_num_threads(options.threads)
        for n, seconds in measured.items():
            speedup = measured[1].median / seconds.median
            rows.append({"scene": row.name, "number": n, "step ms": seconds.scaled(1e3), "faster than one": speedup})
    title = f"Threads: {options.resolution}x{options.resolution}, {options.spp} spp, forward and backward"
    plot = {
        "kind": "lines",
        "x": "number",
        "columns": ["faster than one"],
        "by": ["scene"],
        "y": "faster than one thread",
    }
    return Table(title, ["scene", "number"], rows, [], plot, "threads")


def triangle_table(options: argparse.Namespace) -> Table:
    """Time a ray over the number of triangles, beside Embree alone with the same rays."""
    rows: list[dict[str, Any]] = []
    for count in [*options.triangles, *([10**7] if options.largest else [])]:
        vertices, faces, normals = bumpy_sphere(count)
        scene = tr.load_file(DISTINCT[1].path, resolution=options.resolution, spp=options.spp)
        scene["sphere"] = tr.Mesh(
            vertices,
            faces,
            vertex_normals=normals,
            bsdf={"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}},
        )
        ours = Ours(scene, ("sphere.bsdf.brdf_0.reflectance.value",), options.spp, **dict(options.renderer))
        alone = Pair(ours, options.threads)
        programs = {"ours": partial(timed_step, ours), "Embree": lambda n, a=alone: {"step": a.round(n)["sum"]}}
        measured = timings(programs, options)
        result: dict[str, Any] = {"triangles": len(faces), "rays M": alone.rays / 1e6}
        result["ours, a ray ns"] = measured["ours"].scaled(1e9 / alone.rays)
        result["Embree alone, a ray ns"] = measured["Embree"].scaled(1e9 / alone.rays)
        first = rows[0] if rows else result
        growth = {
            name: result[f"{name}, a ray ns"].median / first[f"{name}, a ray ns"].median
            for name in ("ours", "Embree alone")
        }
        result |= {"our growth": growth["ours"], "Embree's growth": growth["Embree alone"]}
        result["ours / Embree's"] = growth["ours"] / growth["Embree alone"]
        rows.append(result)
        del ours, alone, programs, scene  # ten million triangles take gigabytes
    title = (
        f"Triangles: a sphere with bumps, {options.resolution}x{options.resolution}, {options.spp} spp, "
        f"{options.threads} threads, forward and backward"
    )
    columns = ["ours, a ray ns", "Embree alone, a ray ns"]
    plot = {"kind": "lines", "x": "triangles", "columns": columns, "y": "ns a ray", "base": 10}
    return Table(title, ["triangles"], rows, [], plot, "triangles")


def clear_and_sum(buffers: list[torch.Tensor], _: int) -> dict[str, float]:
    """Seconds of making a gradient of zeros, clearing a buffer a thread, and adding those up in it."""
    start = time.perf_counter()
    gradient = torch.zeros_like(buffers[0])
    for buffer in buffers:
        buffer.zero_()
    for buffer in buffers:
        gradient += buffer
    return {"step": time.perf_counter() - start}


def texture_table(options: argparse.Namespace) -> Table:
    """Time over the size of a texture with a gradient at every texel, beside clearing and summing its buffers."""
    rows: list[dict[str, Any]] = []
    for row in [row for row in scenes(options) if row.arguments]:
        (name,) = row.parameters
        first: dict[str, Any] | None = None
        for side in options.texels:
            scene = tr.load_file(row.path, resolution=options.resolution, spp=options.spp, **row.arguments)
            texture = scene.get_submodule(name.rpartition(".")[0])
            texels = texture.data.detach().movedim(-1, 0)[None]
            texture.data = interpolate(texels, size=(side, side))[0].movedim(0, -1).contiguous()
            ours = Ours(scene, (name,), options.spp, **dict(options.renderer))
            buffers = [torch.empty(side, side, 3) for _ in range(options.threads)]
            programs = {
                "step": partial(timed_step, ours),
                "clear": partial(clear_and_sum, buffers),
            }
            measured = {who: value.scaled(1e3) for who, value in timings(programs, options).items()}
            result: dict[str, Any] = {"scene": row.file.removesuffix(".xml"), "texels": side}
            result |= {"step ms": measured["step"], "clearing and summing ms": measured["clear"]}
            first = first or result
            grown = {column: result[column].median - first[column].median for column in list(result)[2:]}
            result["growth of a step, in ms"] = grown["step ms"]
            result["growth of clearing and summing, in ms"] = grown["clearing and summing ms"]
            rows.append(result)
    title = (
        f"Texture: texels along a side, a gradient at each; {options.resolution}x{options.resolution}, "
        f"{options.spp} spp, {options.threads} threads, forward and backward"
    )
    notes = ["Clearing and summing: of a new gradient and one buffer a thread, by torch."]
    columns = ["step ms", "clearing and summing ms"]
    plot = {"kind": "lines", "x": "texels", "columns": columns, "by": ["scene"], "y": "ms"}
    return Table(title, ["scene", "texels"], rows, notes, plot, "texture")


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    makers = {"threads": thread_table, "triangles": triangle_table, "texture": texture_table}
    tables = []
    with Peers(options.peer, options.threads, options.renderer) as peers:
        for part in PARTS:
            if not options.part or part in options.part:
                tables.append(makers[part](options) if part in makers else sample_table(part, peers, options))
        versions = {peer.key: peer.version for peer in peers}
    tables = [table for table in tables if table.rows]
    if not tables:
        raise SystemExit(f"--only: no scene whose name contains {options.only!r} has a texture, which --part asks for")
    return Result(tables, versions)
