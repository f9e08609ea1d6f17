"""Damaged files of every kind: no crash, no hang, bounded memory, and errors that name the file.

Loaders run in processes of their own (`bench.fuzz_worker`). What is found is listed and, with --keep, kept: an input
that crashed its process or took more than 2 s of processor time or, resident, more memory than 4 times its size plus
64 MB; an exception that is no ValueError or OSError; a message without the file's name. Inputs are functions of kind
and number: ``--only ply --first 17 --count 1`` reads one again. ``dict`` is a nested dict, whose errors may be
TypeErrors.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .arguments import natural, positive
from .report import ROOT, Result, Table

RENDERS = False  # no common options
SECONDS = 2.0  # of processor time, for one input
MEMORY = (4, 64 << 20)  # bytes that reading may take: times the input's, and more
DICT_KIND = "dict"
MEMORY_FILES = Path("/dev/shm")  # files on disks that are written anew wait for the disk


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=positive, default=100_000, help="inputs of each kind (default 100000)")
    parser.add_argument("--first", type=natural, default=0, help="number of the first one (default 0)")
    parser.add_argument("--seconds", type=positive, help="end a kind after so many seconds")
    parser.add_argument("--only", default="", help="only kinds whose name contains this")
    parser.add_argument("--processes", type=positive, default=1, help="kinds that are read at a time (default 1)")
    parser.add_argument("--keep", help="folder for inputs that found something")


def hunt(kind: str, first: int, last: int, seconds: float | None, keep: Path | None, worker: Sequence[str]) -> Any:
    """Inputs `first` to before `last` of a kind; returns counts and what was found, each with its number."""
    found: list[dict[str, Any]] = []
    total: Counter[str] = Counter()
    most = {"MB": 0.0, "ms": 0.0}
    end = time.monotonic() + (seconds or 1e9)
    with tempfile.TemporaryDirectory(dir=MEMORY_FILES if MEMORY_FILES.is_dir() else None) as name:
        folder = Path(name)
        while first < last and time.monotonic() < end:
            (folder / "summary").unlink(missing_ok=True)
            (folder / "progress").write_text(str(first))
            left = max(0.0, end - time.monotonic())
            command = [*worker, kind, str(first), str(last), f"{left:.1f}", name]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace")
            reports = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
            at = int((folder / "progress").read_text())
            if done.returncode > 0 or (done.returncode == 0 and not (folder / "summary").exists()):
                print(f"the worker for {kind!r} failed at {at}:\n{done.stderr.strip()[-4000:]}", file=sys.stderr)
                reports.append({"number": at, "what": f"the worker failed, and the rest from {at} was not read"})
                total.update({"inputs": at - first})
                first = last
            elif done.returncode < 0:
                ended = signal.Signals(-done.returncode)
                what = f"more than {SECONDS:g} s" if ended == signal.SIGPROF else f"crash: {ended.name}"
                reports.append({"number": at, "what": what})
                if keep:
                    _keep(folder, kind, at, keep)
                total.update({"inputs": at + 1 - first})
                first = at + 1
            else:
                summary = json.loads((folder / "summary").read_text())
                total.update(summary["counts"])
                most = {key: max(most[key], summary["most"][key]) for key in most}
                first = last
            found += reports
            if keep:
                for file in folder.glob("kept_*"):
                    keep.mkdir(parents=True, exist_ok=True)
                    shutil.move(file, keep / f"{kind.replace(' ', '_')}_{file.name.removeprefix('kept_')}")
    return {"counts": dict(total), "most": most, "found": found}


def _keep(folder: Path, kind: str, number: int, keep: Path) -> None:
    keep.mkdir(parents=True, exist_ok=True)
    for file in folder.iterdir():
        if file.name not in ("progress", "summary") and not file.name.startswith("kept_"):
            (keep / f"{kind.replace(' ', '_')}_{number}_{file.name}").write_bytes(file.read_bytes())


def run(options: argparse.Namespace) -> Result:
    from .fuzz_inputs import KINDS

    kinds = [name for name in (*KINDS, DICT_KIND) if options.only.lower() in name]
    if not kinds:
        raise SystemExit(f"--only: no kind's name contains {options.only!r}: {', '.join((*KINDS, DICT_KIND))}")
    keep = None if options.keep is None else Path(options.keep)
    worker = [sys.executable, "-m", "bench.fuzz_worker"]

    def hunted(kind: str) -> Any:
        return hunt(kind, options.first, options.first + options.count, options.seconds, keep, worker)

    with ThreadPoolExecutor(options.processes) as pool:  # each waits for a process
        results = list(pool.map(hunted, kinds))
    rows, notes = [], []
    for kind, result in zip(kinds, results, strict=True):
        counts = result["counts"]
        rows.append(
            {
                "kind": kind,
                "inputs": counts.get("inputs", 0),
                "refused": counts.get("refused", 0),
                "most memory MB": result["most"]["MB"],
                "longest ms": result["most"]["ms"],
                "found": len(result["found"]),
            }
        )
        grouped: dict[str, list[int]] = {}
        for report in result["found"]:
            grouped.setdefault(report["what"], []).append(report["number"])
        notes += [f"{kind}: {what}: {len(n)} inputs, the first is {n[0]}" for what, n in grouped.items()]
    return Result([Table("Damaged inputs by kind", ["kind"], rows, notes)])
