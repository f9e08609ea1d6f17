"""Do two states of torchrender render and differentiate alike? The gate of every change that is to change nothing.

All scenes of the tests are rendered by this state and by another one with the same random numbers: image, coverage,
variance and outputs of first hits; gradients by all parameters that have one, and by values or geometry alone; the
derivative along a fixed direction; by all integrators, in both variants and precisions, in packets and in numbers.

A difference is that of two arrays, relative to the largest number of the other state's; where that array is hardly
there, to a hundredth of the largest one of its kind, since what is left of sums that cancel is rounding. "=" says that
all arrays are equal bit for bit. Ends with status 1 if a difference is beyond its limit, or if something else is
refused than before. What one state does not know is listed as "only here" or "only before". Samples at the edges of
what is defined (grazing angles, chains of glass) magnify rounding: in single precision a difference counts as beyond
its limit if it is also larger than the other state's own distance from its result in double precision.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any

from .arguments import peer_argument
from .peers import KNOWN
from .report import ROOT
from .same_arrays import Comparison, compare_files

PROGRAM = Path(__file__).resolve().parent / "same_program.py"
LIMITS = {"float64": 1e-12, "float32": 1e-5}
COLUMNS = ("image", "outputs", "reverse", "forward")
SHOWN = 20  # of a list


class Program:
    """One of the two running programs; its lines are read as they come, so that it never waits."""

    def __init__(self, python: str, path: str | None, options: dict[str, Any]) -> None:
        variables = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"OMP_NUM_THREADS": "1"}
        variables |= {"PYTHONPATH": path} if path else {}
        self.python, self.said = python, tempfile.TemporaryFile()
        command = [python, str(PROGRAM), json.dumps(options)]
        try:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.said, text=True, env=variables)
        except OSError as error:
            raise SystemExit(f"--peer: {python}: {error.strerror}") from error
        self.lines: Queue[str] = Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put("")

    def next(self) -> dict[str, Any]:
        """Its next line; ends this program with its last words if there is none."""
        line = self.lines.get()
        if line:
            return json.loads(line)
        status = self.process.wait()
        self.said.seek(0)
        words = self.said.read().decode(errors="replace").strip()
        raise SystemExit(f"{self.python} ended with status {status}:\n{words[-2000:]}")

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()
        self.said.close()


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bench same", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    peer_argument(parser)
    parser.add_argument("--only", default="", help="only scenes whose name contains this")
    parser.add_argument("--dtype", choices=list(LIMITS), nargs="+", default=list(LIMITS), help="only these")
    parser.add_argument("--quick", action="store_true", help="only rgb, in packets, by each scene's own integrator")
    for dtype, limit in LIMITS.items():
        parser.add_argument(f"--{dtype}", type=float, default=limit, metavar="LIMIT", help="(default %(default)s)")
    parser.add_argument("--tests", default=str(ROOT / "tests"), help="folder of the scenes (default %(default)s)")
    return parser


def pairs(programs: list[Program], names: list[str]) -> Iterator[tuple[str, Comparison]]:
    """The scenes that both programs have, as soon as both are done with them."""
    for name in names:
        files = []
        for program in programs:
            line = program.next()
            while line["scene"] != name:
                line = program.next()
            files.append(line["file"])
        before, now = files
        yield name, compare_files(now, before)
        for file in files:
            os.remove(file)


def row(name: str, found: Comparison, dtypes: list[str]) -> str:
    """One line of the table."""
    cells = [name]
    for dtype in dtypes:
        for column in COLUMNS:
            worst = found.worst(dtype, column)
            cells.append("" if worst is None else "=" if worst[0] == 0 else f"{worst[0]:.1e}")
    said = {"refused": found.refused, "only here": found.only_here, "only before": found.only_before}
    cells.append(", ".join(f"{len(keys)} {what}" for what, keys in said.items() if keys))
    return "| " + " | ".join(cells) + " |"


def listed(title: str, lines: list[str]) -> None:
    """A part of the end of the report, if there is anything to say."""
    if lines:
        print(f"\n{title}:")
        for line in lines[:SHOWN]:
            print(f"    {line}")
        if len(lines) > SHOWN:
            print(f"    and {len(lines) - SHOWN} more")


def report(found: dict[str, Comparison], limits: dict[str, float]) -> bool:
    """Print what is to be said about all scenes; whether the two states are alike."""
    every = [
        (size, key.partition("/")[0], f"{name}: {key}") for name, c in found.items() for key, size in c.sizes.items()
    ]
    every.sort(key=lambda entry: -entry[0])
    equal = sum(not any(c.sizes.values()) for c in found.values())
    print(
        f"\n{len(found)} scenes, {len(every)} arrays; bit-equal: {equal} scenes, {sum(not e[0] for e in every)} arrays"
    )
    for dtype, limit in limits.items():
        worst = next((entry for entry in every if entry[1] == dtype), None)
        if worst and worst[0]:
            print(f"largest difference in {dtype}: {worst[0]:.2e} (limit {limit:.0e}), {worst[2]}")
    rounding = {f"{name}: {key}": size for name, c in found.items() for key, size in c.rounding.items()}
    large = [entry for entry in every if entry[0] > limits[entry[1]]]
    beyond = [f"{size:.2e} {what}" for size, _, what in large if size > rounding.get(what, 0)]
    if len(beyond) < len(large):
        near = len(large) - len(beyond)
        print(f"beyond its limit, but nearer to the other state than that is to double precision: {near}")
    refused = [f"{name}: {text}" for name, c in found.items() for text in c.refused]
    listed("Beyond the limits", beyond)
    listed("Refused in one state alone, or for another reason", refused)
    listed("Refused in other words", [f"{name}: {text}" for name, c in found.items() for text in c.reworded])
    listed("Only here", [f"{name}: {key}" for name, c in found.items() for key in c.only_here])
    listed("Only before", [f"{name}: {key}" for name, c in found.items() for key in c.only_before])
    return not beyond and not refused


def main(argv: list[str]) -> int:
    """Exit status 1 if the states differ."""
    import torchrender

    parser = arguments()
    options = parser.parse_args(argv)
    others = [python for name, python in options.peer if KNOWN[name].ourselves]
    if len(others) != 1 or len(options.peer) != 1:
        parser.error("--peer: expected torchrender=PYTHON, once")
    limits = {dtype: getattr(options, dtype) for dtype in options.dtype}
    here = str(Path(torchrender.__file__).resolve().parent.parent)
    programs: list[Program] = []
    found: dict[str, Comparison] = {}
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        try:
            for number, (python, path) in enumerate([(others[0], None), (sys.executable, here)]):
                own = Path(folder) / str(number)
                own.mkdir()
                asked = {"folder": str(own), "tests": options.tests, "dtypes": options.dtype}
                programs.append(Program(python, path, {**asked, "only": options.only, "quick": options.quick}))
            before, now = (program.next() for program in programs)  # the other first: it may not start
            print(f"here: {now['version']}; before: {before['version']}\n")
            names = [name for name in now["scenes"] if name in set(before["scenes"])]
            if not names:
                lost = f"; not found: {', '.join(now['lost'])}" if now["lost"] else ""
                parser.error(f"--only: no scene's name contains {options.only!r}{lost}")
            head = [f"{dtype} {column}" for dtype in options.dtype for column in COLUMNS]
            print("| " + " | ".join(["scene", *head, ""]) + " |\n" + "|---" * (len(head) + 2) + "|")
            for name, comparison in pairs(programs, names):
                found[name] = comparison
                print(row(name, comparison, options.dtype), flush=True)
        finally:
            for program in programs:
                program.stop()
    alike = report(found, limits)
    listed("Only here", [name for name in now["scenes"] if name not in found])
    listed("Only before", [name for name in before["scenes"] if name not in found])
    listed("Scenes that were not found here", now["lost"])
    listed("Scenes that were not found before", before["lost"])
    print("\nalike" if alike else "\nnot alike")
    return 0 if alike and not now["lost"] else 1
