"""Rates of Embree alone: the rays of the five scenes' images by kind, single and in packets."""

from __future__ import annotations

import argparse
from typing import Any

import torch

from .embree_alone import QUERIES, EmbreeAlone
from .measured import Measured
from .ours import Ours, chosen
from .report import Result, Table
from .rows import Row

ASKS = {"camera": "closest", "bounce": "closest", "camera shadow": "any", "bounce shadow": "any"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Nothing besides the common options."""


def ray_rows(row: Row, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each kind of ray of a scene's image."""
    ours = Ours.of_row(row, options.resolution, options.spp, **dict(options.renderer))
    alone = EmbreeAlone(ours, False, options.threads)
    rows = []
    for kind in alone.kinds:
        count, rays = alone.counts[kind], alone.count(kind)
        result = {"scene": row.name, "rays": kind, "hit": ASKS[kind], "number M": rays / 1e6}
        result["hits %"] = 100 * count["hits"] / count["rays"]
        costs = {}
        for query in alone.trials[kind]:
            seconds = alone.replay(kind, query, options.warmup + options.rounds)[options.warmup :]
            result[f"{query} ns"] = Measured.of(seconds).scaled(1e9 / rays)
            costs[str(query)] = result[f"{query} ns"].median
        best = min(costs, key=costs.__getitem__)
        result["best"] = best
        result["best Mrays/s"] = 1e3 / costs[best]
        rows.append(result)
    return rows


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    rows = [entry for row in chosen(options) for entry in ray_rows(row, options)]
    title = (
        f"Nanoseconds a ray of Embree alone, {options.threads} threads together, rays of an image of "
        f"{options.resolution}x{options.resolution}, {options.spp} spp, depth 5"
    )
    columns = [f"{query} ns" for query in QUERIES if any(f"{query} ns" in row for row in rows)]
    notes = ["By rays a query; coherent: Embree is told that they are similar."]
    return Result(
        [Table(title, ["scene", "rays", "hit"], rows, notes, {"kind": "bars", "columns": columns, "y": "ns"})]
    )
