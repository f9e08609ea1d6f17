"""Regressions: what became slower, or takes more memory, from one JSON file to another by more than its spread.

Compared are the medians of all figures that have a spread. A figure counts as worse if it has grown by more than the
threshold and by more than three standard errors of the ratio of the medians, which come from the quartiles of both
files. Columns and rows of peers are shown, as a sign of how equal the machines were, but do not count.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .measured import Measured
from .peers import KNOWN
from .report import Table, markdown

ERRORS = 3.0
# What columns begin with, or rows are labelled with, that are not this renderer's figures.
OTHERS = (*(known.title for known in KNOWN.values()), "Embree alone", "clearing and summing")


def load(path: str) -> dict[str, Any]:
    """A result; ValueError if the file holds none."""
    try:
        document = json.loads(Path(path).read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: not a readable JSON file: {error}") from error
    if not isinstance(document, dict) or not {"benchmark", "tables"} <= document.keys():
        raise ValueError(f"{path}: not a result of python -m bench NAME --json")
    return document


def figures(document: dict[str, Any]) -> Iterator[tuple[tuple[tuple[str, ...], str], Measured]]:
    """All figures with a spread, by the part and the values of the labels of their row, and their column."""
    for table in document["tables"]:
        for row in table["rows"]:
            for column in table["columns"]:
                value = row.get(column)
                if isinstance(value, dict):
                    labels = [table["part"]] * bool(table["part"]) + [str(row[label]) for label in table["labels"]]
                    yield (tuple(labels), column), Measured(**value)


def compare(before: dict[str, Any], after: dict[str, Any], threshold: float) -> list[dict[str, Any]]:
    """A row for each figure that both have. ValueError if they are of different benchmarks or share no figure."""
    if before["benchmark"] != after["benchmark"]:
        raise ValueError(f"different benchmarks: {before['benchmark']} and {after['benchmark']}")
    old = dict(figures(before))
    rows = []
    for key, new in figures(after):
        if key not in old or not old[key].median > 0:
            continue
        ratio = new.median / old[key].median
        error = ratio * (old[key].error ** 2 + new.error**2) ** 0.5
        limit = max(threshold, ERRORS * error)
        verdict = "worse" if ratio > 1 + limit else "better" if ratio < 1 - limit else ""
        labels, column = key
        if column.startswith(OTHERS) or any(label in OTHERS for label in labels):
            verdict = "(not ours)"
        rows.append(
            {
                "row": ", ".join(labels),
                "figure": column,
                "before": old[key],
                "after": new,
                "after / before": ratio,
                "standard error": error,
                "verdict": verdict,
            }
        )
    if not rows:
        raise ValueError("the two files share no figure")
    return rows


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What was not the same in both measurements besides the program."""
    found = []
    for part in ("settings", "machine", "versions"):
        names = before.get(part, {}).keys() | after.get(part, {}).keys()
        for name in sorted(names - {"load"}):
            a, b = before.get(part, {}).get(name), after.get(part, {}).get(name)
            if a != b:
                found.append(f"{name}: {a} before, {b} after")
    return found


def main(argv: list[str]) -> int:
    """Exit status 1 if something is worse, 2 if the files cannot be compared."""
    parser = argparse.ArgumentParser(prog="python -m bench compare", description=__doc__)
    parser.add_argument("before", metavar="A.json")
    parser.add_argument("after", metavar="B.json")
    parser.add_argument("--threshold", type=float, default=0.05, help="growth that is always allowed (default 0.05)")
    options = parser.parse_args(argv)
    try:
        before, after = load(options.before), load(options.after)
        rows = compare(before, after, options.threshold)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    worse = [row for row in rows if row["verdict"] == "worse"]
    table = Table("", ["row", "figure"], rows, differences(before, after))
    print(markdown(table))
    print(
        f"\n{len(worse)} of {len(rows)} figures are worse by more than {options.threshold:.0%} and {ERRORS:.0f} errors"
    )
    return 1 if worse else 0
