"""Markdown tables and JSON files of results."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path


def cell(value: object) -> str:
    """A number with three significant digits, "not measured" for None, anything else as it is."""
    if value is None:
        return "not measured"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def markdown(columns: list[str], rows: list[dict]) -> str:
    """A Markdown table of the given columns; a row lacks a value where it was not measured."""
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(cell(row.get(column)) for column in columns) + " |" for row in rows]
    return "\n".join(lines)


def machine() -> dict:
    """What the figures were measured on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    return {"cpu": model, "cores": os.cpu_count(), "python": platform.python_version()}


def save(path: str, result: dict) -> None:
    Path(path).write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
