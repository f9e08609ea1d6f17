"""Results: tables in Markdown, JSON files, and what they were measured on."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .measured import Measured
from .peers import Peer

ROOT = Path(__file__).resolve().parent.parent


@dataclass
class Table:
    """One table. A row is a dict by column; it lacks a value where there is none.

    A column's name ends with its unit. `labels` are the columns that say which row it is. `plot` describes its picture:
    ``{"kind": "bars" | "lines", "columns": [...], "y": label}``, lines with ``"x"`` and, where every value of some
    labels has a line of its own, ``"by": [...]``.
    """

    title: str
    labels: list[str]
    rows: list[dict[str, Any]]
    notes: list[str] = field(default_factory=list)
    plot: dict[str, Any] | None = None
    part: str = ""  # tells the tables of one benchmark apart, where their rows may have the same labels
    shown: bool = True  # False: too long to be printed; it is there for its plot

    @property
    def columns(self) -> list[str]:
        """All columns, in the order in which rows bring them."""
        return list(dict.fromkeys(name for row in self.rows for name in row))


@dataclass
class Result:
    """What a benchmark returns."""

    tables: list[Table]
    versions: dict[str, str] = field(default_factory=dict)  # of peers


def cell(value: object) -> str:
    """A number with three significant digits, an empty string for None, anything else as it is."""
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def markdown(table: Table) -> str:
    """A Markdown table with its notes."""
    lines = ["| " + " | ".join(table.columns) + " |", "|" + "---|" * len(table.columns)]
    lines += ["| " + " | ".join(cell(row.get(column)) for column in table.columns) + " |" for row in table.rows]
    return "\n".join(lines + [""] * bool(table.notes) + table.notes)


def machine() -> dict[str, Any]:
    """What the figures are measured on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"cpu": model, "cores": cores, "system": platform.platform(), "load": os.getloadavg()[0]}


def versions(peers: Iterable[Peer] = ()) -> dict[str, str]:
    """Versions of everything that takes part."""
    import numpy
    import torch

    import torchrender
    from torchrender import backends

    found = {
        "torchrender": torchrender.__version__,
        "commit": commit_of(ROOT / "torchrender"),
        "instruction set": backends.isa(),
        "embree": str(backends.embree()["version"]),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": numpy.__version__,
    }
    return {**found, **{peer.key: peer.version for peer in peers}}


def commit_of(package: Path) -> str:
    """Which commit of a checkout a package's folder is from, "-dirty" with changes; "" for an installed copy."""
    tracked = ["git", "ls-files", "--error-unmatch", "__init__.py"]  # not by a repository that it only lies in
    described = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        found = [subprocess.run(c, cwd=package, capture_output=True, text=True) for c in (tracked, described)]
    except OSError:
        return ""
    return found[1].stdout.strip() if not any(done.returncode for done in found) else ""


def version_of(package: Any) -> str:
    """Version and commit of a torchrender that has been imported, and whether it is this very checkout's."""
    folder = Path(package.__file__).resolve().parent
    commit = commit_of(folder)
    same = "this checkout" if folder == ROOT / "torchrender" else ""
    more = ", ".join([*[f"commit {commit}"] * bool(commit), *[same] * bool(same)])
    return f"{package.__version__} ({more})" if more else package.__version__


def to_json(name: str, result: Result, settings: dict[str, Any], where: dict[str, Any]) -> dict[str, Any]:
    """What is written to a JSON file; figures with a spread become dicts of their four numbers."""
    tables = []
    for table in result.tables:
        rows = [{k: asdict(v) if isinstance(v, Measured) else v for k, v in row.items()} for row in table.rows]
        tables.append({**asdict(table), "columns": table.columns, "rows": rows})
    return {
        "benchmark": name,
        "settings": settings,
        "machine": where,
        "versions": {**versions(), **result.versions},
        "tables": tables,
    }


def save(path: str, document: dict[str, Any]) -> None:
    Path(path).write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def show(document: dict[str, Any], result: Result) -> None:
    """Print the tables, what they were measured on, and with which versions."""
    where = document["machine"]
    for table in result.tables:
        if not table.shown:
            continue
        print(f"\n{table.title}\n\n{markdown(table)}")
    threads = document["settings"].get("threads")
    used = "" if threads is None else f", {threads} threads"
    print(f"\n{where['cpu']}, {where['cores']} cores{used}; load at the start {where['load']:.2f}")
    print(", ".join(f"{name} {version}" for name, version in document["versions"].items() if version))
    cells = [value for table in result.tables for row in table.rows for value in row.values()]
    if any(isinstance(value, Measured) and value.n > 1 for value in cells):
        print("± is half the distance between the quartiles of the rounds, relative to their median")
