"""What building the native modules takes: seconds of the compilers by file and by module, wall time, sizes.

Read from the log that Ninja keeps in a build folder, so that nothing is compiled. Of a file that was compiled several
times the last one counts; files that are no longer a part of the build do not. A compiler's seconds are those from its
start to its end: processor seconds, where no more compilers than processors ran at once.
"""

from __future__ import annotations

import argparse
import re
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .measured import Measured
from .report import ROOT, Result, Table

RENDERS = False  # none of the options about pictures
LOG = ".ninja_log"
APART = 0.5  # seconds between the starts of two runs, at least


@dataclass(frozen=True)
class Edge:
    """The last time that a target was made, in seconds since its run began; `run`: when that was, by the clock."""

    target: str
    start: float
    end: float
    run: float

    @property
    def seconds(self) -> float:
        return self.end - self.start

    @property
    def module(self) -> str:
        """The instruction set, which objects have as their first folder and linked files in their name."""
        if self.is_object:
            return self.target.partition("/")[0]
        return Path(self.target).name.partition(".")[0].removeprefix("_core_").removeprefix("native_tests_")

    @property
    def file(self) -> str:
        return self.target.partition("/")[2].removesuffix(".o").removesuffix(".gch")

    @property
    def is_object(self) -> bool:
        return self.target.endswith((".o", ".gch"))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    folder = ROOT / "build" / "native" / sysconfig.get_platform()
    parser.add_argument("--directory", type=Path, default=folder, help="a build folder (default %(default)s)")
    parser.add_argument("--only", default="", help="only files whose name contains this")


def read_log(directory: Path) -> list[Edge]:
    """What Ninja made in a folder; ends the program if it keeps no log there."""
    try:
        text = (directory / LOG).read_text()
    except OSError:
        raise SystemExit(
            f"--directory: expected a folder with Ninja's log, got {directory}; make build makes it"
        ) from None
    current = targets(directory)
    found: dict[str, Edge] = {}
    header, *lines = text.splitlines() or [""]
    tells_clock = int(header.rpartition("v")[2] or 0) >= 6
    run, previous = 0.0, 0.0
    for line in lines:
        fields = line.split("\t")
        if len(fields) < 5:
            continue
        start, end = (int(field) / 1000 for field in fields[:2])
        # The third number is by the clock when the command began, from Ninja 1.12 on. Older ones leave only that files
        # stand in the order of their ends, which begin again with a new run.
        run = int(fields[2]) / 1e9 - start if tells_clock else run + (end < previous)
        previous = end
        if not current or fields[3] in current:
            target = Path(fields[3])
            name = target.relative_to(directory) if target.is_relative_to(directory) else target
            found[fields[3]] = Edge(name.as_posix(), start, end, run)
    return list(found.values())


def targets(directory: Path) -> set[str]:
    """What the folder's build is made of, as its log names it; empty where that is not known."""
    script = directory / "build.ninja"
    text = script.read_text() if script.exists() else ""
    names = re.findall(r"^build ((?:\$.|[^:$])*):", text, re.MULTILINE)
    return {re.sub(r"\$(.)", r"\1", name) for name in names}


def newest_run(edges: Iterable[Edge]) -> list[Edge]:
    """What the last run of Ninja made that made anything."""
    ordered = sorted(edges, key=lambda edge: edge.run)
    first = len(ordered) - 1
    while first > 0 and ordered[first].run - ordered[first - 1].run < APART:
        first -= 1
    return ordered[max(first, 0) :]


def file_table(objects: list[Edge], only: str) -> Table:
    """Seconds of every file, the longest first."""
    modules = sorted({edge.module for edge in objects})
    by_file: dict[str, dict[str, float]] = {}
    for edge in objects:
        if only.lower() in edge.file.lower():
            by_file.setdefault(edge.file, {})[edge.module] = edge.seconds
    whole = sum(edge.seconds for edge in objects)
    rows: list[dict[str, Any]] = []
    for file, seconds in sorted(by_file.items(), key=lambda item: -sum(item[1].values())):
        row: dict[str, Any] = {"file": file}
        row |= {f"{module} s": seconds.get(module) for module in modules} if len(modules) > 1 else {}
        rows.append({**row, "sum s": Measured.of([sum(seconds.values())]), "%": 100 * sum(seconds.values()) / whole})
    return Table("Seconds of the compiler by file", ["file"], rows, part="files")


def module_table(edges: list[Edge], directory: Path) -> Table:
    """Seconds and sizes of every module, and of all of them."""
    rows: list[dict[str, Any]] = []
    modules = sorted({edge.module for edge in edges})
    for module in [*modules, "all"]:
        own = [edge for edge in edges if module in (edge.module, "all")]
        sizes = [(directory / edge.target).stat().st_size for edge in own if linked(edge, directory)]
        row: dict[str, Any] = {"module": module, "objects": sum(edge.is_object for edge in own)}
        row["compile s"] = Measured.of([sum(edge.seconds for edge in own if edge.is_object)])
        row["link s"] = sum(edge.seconds for edge in own if not edge.is_object)
        row["size MiB"] = Measured.of([sum(sizes) / 2**20]) if sizes else None
        rows.append(row)
    return Table("Seconds by module, linked size", ["module"], rows, part="modules")


def linked(edge: Edge, directory: Path) -> bool:
    """Whether this is a linked file that is there."""
    return not edge.is_object and (directory / edge.target).exists()


def run_table(edges: list[Edge]) -> Table:
    """The newest run."""
    made = newest_run(edges)
    wall = max(edge.end for edge in made) - min(edge.start for edge in made)
    seconds = sum(edge.seconds for edge in made)
    row = {"run": "newest", "made": len(made), "seconds of all s": seconds}
    row["wall s"] = Measured.of([wall])
    row["at once"] = seconds / wall if wall else None
    return Table("The newest run, from its first start to its last end", ["run"], [row], part="run")


def run(options: argparse.Namespace) -> Result:
    directory = options.directory.absolute()
    edges = read_log(directory)
    objects = [edge for edge in edges if edge.is_object]
    if not objects:
        raise SystemExit(f"--directory: expected a folder that something was compiled in, got {directory}")
    tables = [file_table(objects, options.only), module_table(edges, directory), run_table(edges)]
    total, newest = tables[1].rows[-1], tables[2].rows[0]
    size = "" if total["size MiB"] is None else f", {total['size MiB'].median:.1f} MiB linked"
    tables[-1].notes.append(
        f"sum: {total['objects']} objects, {total['compile s'].median:.0f} processor seconds{size}; newest run: "
        f"{newest['made']} files in {newest['wall s'].median:.0f} s"
    )
    return Result(tables)
