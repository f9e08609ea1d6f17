"""The tables: forward and backward time of five scenes in alternating rounds, fresh processes, and gradients."""

from __future__ import annotations

import argparse
from statistics import fmean, median, pvariance

import torch

from . import processes
from .mitsuba_peer import Peer, connect
from .ours import Ours
from .rows import ROWS, Row
from .table import machine, markdown, save


def load_peer(peer: Peer, row: Row, options: argparse.Namespace) -> None:
    """Let the peer load a row's scene."""
    settings = {"resolution": options.resolution, "spp": options.spp}
    peer.ask("load", path=row.path, arguments=row.arguments, parameters=list(row.parameters), **settings)


def measure_row(index: int, peer: Peer | None, options: argparse.Namespace) -> dict:
    """Median seconds of row `index`; every round runs each program once, so that both see the same machine."""
    row = ROWS[index]
    ours = Ours(row, options.resolution, options.spp)
    if peer is not None:
        load_peer(peer, row, options)
    mine, theirs = [], []
    for seed in range(options.warmup + options.rounds):
        mine.append(ours.step(seed))
        if peer is not None:
            theirs.append(peer.ask("step", seed=seed))
    result = {"scene": row.name}
    for prefix, samples in (("", mine[options.warmup :]), ("Mitsuba ", theirs[options.warmup :])):
        if samples:
            result[prefix + "forward s"] = median(sample["forward"] for sample in samples)
            result[prefix + "backward s"] = median(sample["backward"] for sample in samples)
            result[prefix + "sum s"] = median(sample["forward"] + sample["backward"] for sample in samples)
    if theirs:
        result["Mitsuba / ours"] = result["Mitsuba sum s"] / result["sum s"]
    result["Embree alone s"] = ours.embree_seconds(options.rounds)
    return result


COLUMNS = ["scene", "forward s", "backward s", "sum s", "Embree alone s"]
COLUMNS += ["Mitsuba forward s", "Mitsuba backward s", "Mitsuba sum s", "Mitsuba / ours"]
PROCESS_COLUMNS = ["scene", "import s", "load s", "first gradient s", "peak MiB above torch"]
PROCESS_COLUMNS += ["Mitsuba import s", "Mitsuba load s", "Mitsuba first gradient s", "Mitsuba peak MiB"]


def process_row(index: int, options: argparse.Namespace, with_peer: bool) -> dict:
    """Start-up time and peak memory of row `index`, each program in a fresh process."""
    arguments = (index, options.threads, options.resolution, options.spp, 3)
    result = {"scene": ROWS[index].name}
    measured = [("", processes.ours(*arguments))]
    if with_peer:
        measured.append(("Mitsuba ", processes.mitsuba(*arguments, options.mitsuba_python)))
    for prefix, values in measured:
        if values is not None:
            for name in ("import", "load", "first_gradient"):
                result[f"{prefix}{name.replace('_', ' ')} s"] = values[name]
            result[prefix + ("peak MiB" if prefix else "peak MiB above torch")] = round(values["memory"])
    return result


GRADIENT_COLUMNS = ["scene", "parameter", "ours", "Mitsuba", "z", "our deviation", "Mitsuba deviation"]
GRADIENT_COLUMNS += ["our seconds", "Mitsuba seconds", "efficiency ratio"]


def gradient_rows(index: int, peer: Peer | None, options: argparse.Namespace) -> list[dict]:
    """Do both programs find the same gradient, and how noisy is one estimate of it?

    The scalar is mean(image * weight); compared are sums over the entries of each parameter. Efficiency is
    1 / (variance x time).
    """
    row, ours = ROWS[index], Ours(ROWS[index], options.resolution, options.spp)
    seeds = range(options.warmup + options.rounds)
    runs = {"ours": [ours.gradient(seed) for seed in seeds][options.warmup :]}
    if peer is not None:
        load_peer(peer, row, options)
        runs["Mitsuba"] = [peer.ask("gradient", seed=seed) for seed in seeds][options.warmup :]
    rows = []
    for i, parameter in enumerate(row.parameters):
        result, variance = {"scene": row.name, "parameter": parameter}, {}
        for who, samples in runs.items():
            sums = [sample["sums"][i] for sample in samples]
            prefix = "our" if who == "ours" else who
            result[who], variance[who] = fmean(sums), max(pvariance(sums), 1e-300)
            result[f"{prefix} deviation"] = variance[who] ** 0.5
            result[f"{prefix} seconds"] = median(sample["seconds"] for sample in samples)
        if peer is not None:
            error = ((variance["ours"] + variance["Mitsuba"]) / max(options.rounds - 1, 1)) ** 0.5
            result["z"] = (result["ours"] - result["Mitsuba"]) / error
            cost = variance["Mitsuba"] * result["Mitsuba seconds"]
            result["efficiency ratio"] = cost / (variance["ours"] * result["our seconds"])
        rows.append(result)
    return rows


def run_gradients(options: argparse.Namespace) -> dict:
    torch.set_num_threads(options.threads)
    peer = connect(options.mitsuba_python, options.threads)
    try:
        rows = [entry for index in chosen(options) for entry in gradient_rows(index, peer, options)]
    finally:
        if peer is not None:
            peer.close()
    title = f"Gradients at {options.resolution}x{options.resolution}, {options.spp} spp, {options.rounds} runs of each"
    return {"title": title, "columns": GRADIENT_COLUMNS, "rows": rows}


def chosen(options: argparse.Namespace) -> list[int]:
    return [index for index, row in enumerate(ROWS) if options.only in row.name]


def run_table2(options: argparse.Namespace) -> dict:
    torch.set_num_threads(options.threads)
    peer = connect(options.mitsuba_python, options.threads)
    try:
        rows = [measure_row(index, peer, options) for index in chosen(options)]
    finally:
        if peer is not None:
            peer.close()
    return {
        "title": f"{options.resolution}x{options.resolution}, {options.spp} spp, depth 5, {options.threads} threads, "
        f"median of {options.rounds} alternating rounds",
        "columns": COLUMNS,
        "rows": rows,
    }


def run_startup(options: argparse.Namespace) -> dict:
    peer = connect(options.mitsuba_python, options.threads)
    if peer is not None:
        peer.close()
    rows = [process_row(index, options, peer is not None) for index in chosen(options)]
    title = "Fresh processes: seconds until the first gradient, and peak memory after three steps"
    return {"title": title, "columns": PROCESS_COLUMNS, "rows": rows}


def report(result: dict, path: str | None) -> None:
    """Print the table and write it to `path` as JSON if one is given."""
    where = machine()
    print(f"\n{result['title']}; {where['cpu']}, {where['cores']} cores\n")
    print(markdown(result["columns"], result["rows"]))
    if path:
        save(path, {**result, "machine": where})
