"""Inverse problems from start to result: seconds until pictures that were not fitted are right.

Each problem has a scene, pictures of it, and unknowns that are found from these, by torch.optim.Adam or (with a
"damping" in the setting) tr.optim.LeastSquares here and mi.ad.Adam in Mitsuba, each in a process of its own with the
program's own derivatives. Every second, while the clock stands, this renderer renders pictures that nobody was given
with what was found after some numbers of steps; the run ends when their error, relative to the true pictures, is at the
problem's target. Programs make their steps in turn.

Then each that came to the target makes as many steps again, from the start and in one go. Seconds are those of these
steps: rendering, derivatives, the optimiser. (Those of the race, which the error over time has, are more where steps
are short: threads sleep while the judge renders, and caches have its data.) What starting takes (loading, the first
steps, in which Mitsuba compiles or loads kernels) has a column of its own.

Settings come from `inverse_settings.json`, where `--search` puts each program's best at each problem: samples of
picture and derivative, learning rate and its decay, sampler. Where there is none, both programs have the problem's own.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import torch

import torchrender as tr

from .arguments import peer_argument, positive
from .inverse_problems import PROBLEMS, Problem
from .inverse_race import Run, loaded, race
from .inverse_search import Search, Setting
from .inverse_task import Task
from .measured import Measured
from .peers import Peer, PeerError
from .report import Result, Table

RENDERS = False  # sizes and samples are the problems' own
SEARCH_SEED = 1 << 10  # far from the rounds'
SETTINGS = Path(__file__).with_name("inverse_settings.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    names = [problem.name for problem in PROBLEMS]
    usual = [problem.name for problem in PROBLEMS if not problem.optional]
    parser.add_argument("--threads", type=positive, default=2, help="threads of every program (default %(default)s)")
    text = f"only these of {', '.join(names)} (default: {' '.join(usual)})"
    parser.add_argument("--problem", nargs="+", choices=names, default=usual, metavar="NAME", help=text)
    parser.add_argument("--quick", action="store_true", help="every problem small")
    parser.add_argument(
        "--rounds", type=positive, default=1, help="runs, each with other samples (default %(default)s)"
    )
    parser.add_argument("--cap", type=float, default=120.0, help="seconds after which a run ends (default %(default)s)")
    parser.add_argument("--search", action="store_true", help="search for the best settings first")
    parser.add_argument(
        "--search-runs", type=positive, default=3, help="runs of each setting that is tried (default %(default)s)"
    )
    parser.add_argument(
        "--by-cpu", action="store_true", help="search by seconds of the processor: where other work runs beside"
    )
    parser.add_argument("--settings", default=str(SETTINGS), metavar="FILE", help="settings; --search writes to it")
    parser.add_argument("--folder", help="where pictures of the results are left (default: nowhere)")


def ours(threads: int) -> Peer:
    """This renderer in a process of its own, as the others are."""
    peer = Peer("torchrender", sys.executable, threads)
    peer.title = "ours"
    return peer


def start_of(settings: dict[str, Any], problem: Problem, peer: Peer) -> Setting:
    """The stored setting of a program, else the problem's own."""
    return {**problem.setting, **problem.own.get(peer.name, {}), **settings.get(problem.name, {}).get(peer.name, {})}


def search(problem: Problem, task: Task, peers: list[Peer], folder: Path, settings: dict, options) -> list[dict]:
    """Puts the best setting of every program into `settings`; rows of all that was tried."""
    rows, goal = [], problem.goal(options.quick)
    for peer in peers:
        searched = Search(
            lambda setting, seed, peer=peer: Run(peer, task, setting, folder, SEARCH_SEED + seed),
            goal,
            options.cap,
            options.by_cpu,
            options.search_runs,
        )
        others = problem.others.get(peer.name, [])
        try:
            best = searched.search(start_of(settings, problem, peer), peer.name, others)
        except PeerError as error:  # the race says so in its row
            print(error, file=sys.stderr)
            continue
        settings.setdefault(problem.name, {})[peer.name] = best
        for trial in searched.trials:
            row: dict[str, Any] = {"problem": problem.name, "program": peer.title, "setting": words(trial.setting)}
            row |= {"reached": "yes" if trial.reached else "no", "iterations": trial.iterations}
            row |= {"seconds": trial.seconds, "compared": trial.cost, "error %": 100 * trial.error}
            row["best"] = "*" if trial.setting == best else ""
            rows.append(row)
    return rows


def words(setting: Setting) -> str:
    """A setting as a cell of a table."""
    text = f"{setting['spp']} + {setting['spp_grad']} spp, rate {setting['rate']:.3g} / {setting['halving']}"
    known = ("spp", "spp_grad", "rate", "halving", "sampler", "renderer", "integrator")
    own = {name: value for name, value in setting.items() if name not in known}
    more = {**own, **setting.get("renderer", {}), **setting.get("integrator", {})}
    return ", ".join([text, setting["sampler"], *(f"{name}={value}" for name, value in more.items())])


def row_of(problem: Problem, goal: float, runs: list[Run], memory: float, difference: float) -> dict[str, Any]:
    """What the runs of one program came to."""
    peer = runs[0].peer
    outcomes = [run.outcome(goal) for run in runs]
    row: dict[str, Any] = {"problem": problem.name, "program": peer.title}
    row["s"] = Measured.of(run.seconds for run in runs)
    row["target reached"] = next((outcome for outcome in outcomes if outcome != "yes"), "yes")
    row["iterations"] = Measured.of(run.last.iterations for run in runs)
    row["s an iteration"] = Measured.of(run.seconds / max(1, run.last.iterations) for run in runs)
    row["processor s"] = Measured.of(run.cpu for run in runs)
    row["first steps s"] = runs[0].first
    row["peak memory MiB"] = memory
    row["error at the start %"] = 100 * runs[0].points[0].error
    row["target %"] = 100 * goal
    row["error %"] = 100 * max(run.last.error for run in runs)
    row["first picture differs %"] = 100 * difference
    row["setting"] = words(runs[0].setting)
    return row


def peak_of(peer: Peer) -> float:
    """Its peak memory in MiB; NaN where its process has ended."""
    try:
        return peer.ask("memory")["peak"]
    except PeerError:
        return math.nan


def curves(problem: Problem, goal: float, runs: list[Run]) -> Table:
    """Error over time of the first round."""
    rows = [
        {"program": run.peer.title, "seconds": p.seconds, "iterations": p.iterations, "error": p.error}
        for run in runs
        for p in run.points[1:]
    ]
    plot = {"kind": "lines", "columns": ["error"], "x": "seconds", "y": "error", "by": ["program"], "scale": "log"}
    title = f"{problem.title}: error of held-out pictures over time, target {goal}"
    return Table(title, ["program", "iterations"], rows, [], plot, part=problem.name, shown=False)


def solve(problem: Problem, settings: dict[str, Any], options: argparse.Namespace, versions: dict[str, str]):
    """The rows of the programs, the error over time, and rows of a search."""
    task, goal = problem.make(options.quick), problem.goal(options.quick)
    peers = [ours(options.threads)]
    tried: list[dict[str, Any]] = []
    try:
        peers += [Peer(name, python, options.threads) for name, python in options.peer]
        versions |= {peer.key: peer.version for peer in peers[1:]}
        with tempfile.TemporaryDirectory(prefix="bench-") as made:
            folder = Path(made)
            task.write(folder)
            differences = [loaded(peer, folder) for peer in peers]
            if options.search:
                tried = search(problem, task, peers, folder, settings, options)
            by_program: list[list[Run]] = [[] for _ in peers]
            for seed in range(1, options.rounds + 1):
                runs = [Run(peer, task, start_of(settings, problem, peer), folder, seed) for peer in peers]
                race(runs, goal, options.cap)
                for mine, run in zip(by_program, runs, strict=True):
                    mine.append(run)
            memory = [peak_of(peer) for peer in peers]
    finally:
        for peer in peers:
            peer.close()
    rows = [row_of(problem, goal, *each) for each in zip(by_program, memory, differences, strict=True)]
    for row, runs in zip(rows[1:], by_program[1:], strict=True):
        pairs = [(theirs, mine) for theirs, mine in zip(runs, by_program[0], strict=True) if not theirs.failed]
        # where one did not come to the target, both have the time of the race
        whole = [bool(theirs.whole and mine.whole) for theirs, mine in pairs]
        both = [(a, b) if once else (a.last, b.last) for once, (a, b) in zip(whole, pairs, strict=True)]
        seconds = [(theirs.seconds, mine.seconds) for theirs, mine in both if mine.seconds]
        row["seconds / ours"] = Measured.of(theirs / mine for theirs, mine in seconds) if seconds else None
    for row in rows:
        print(f"{row['problem']}, {row['program']}: {row['s']} s, error {row['error %']:.3g} %", file=sys.stderr)
    if options.folder:
        pictures = task.shown([runs[0].found for runs in by_program])
        tr.io.write_image(Path(options.folder) / f"{problem.name}.png", pictures)
    return rows, curves(problem, goal, [runs[0] for runs in by_program]), tried


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    if options.threads < 2 and any(name == "mitsuba" for name, _ in options.peer):
        raise PeerError("Mitsuba needs two threads: with one, 3.9.1 waits for ever where a scene has pictures to load")
    if options.folder:
        Path(options.folder).mkdir(parents=True, exist_ok=True)
    file = Path(options.settings)
    settings = json.loads(file.read_text()) if file.exists() else {}
    rows: list[dict[str, Any]] = []
    tried: list[dict[str, Any]] = []
    plots: list[Table] = []
    versions: dict[str, str] = {}
    for problem in (p for p in PROBLEMS if p.name in options.problem):
        found, plot, trials = solve(problem, settings, options, versions)
        rows += found
        tried += trials
        plots.append(plot)
        if options.search:
            file.write_text(json.dumps(settings, indent=1) + "\n")
    columns = {name: None for row in rows for name in row}
    title = f"Inverse problems to their target, {options.threads} threads, {options.rounds} rounds"
    notes = [
        "Error: root mean square difference of held-out pictures, relative to them; of a pose that of the places of "
        "vertices, relative to the body's diagonal; of a mesh 1 - intersection / union of held-out masks. Ratios: "
        "where one program did not reach the target in its time they are bounds. Settings with a damping are those of "
        "tr.optim.LeastSquares, which then moves what light is linear in, and with signs everything else, too; what "
        "it does not move is moved by Adam.",
    ]
    tables = [Table(title, ["problem", "program"], [{c: row.get(c) for c in columns} for row in rows], notes)]
    if tried:
        compared = "seconds of the processor" if options.by_cpu else "seconds"
        tables.append(
            Table(f"Settings that were tried, compared by {compared}", ["problem", "program", "setting"], tried)
        )
    return Result(tables + plots, versions)
