"""Pictures of results: bars by row, or lines over a column, as `Table.plot` describes them."""

from __future__ import annotations

import importlib.util
from typing import Any


def require_matplotlib() -> None:
    """ImportError says how to get it."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ImportError("--plot needs matplotlib: pip install matplotlib")


def _value(cell: Any) -> tuple[float, float, float]:
    """Value, distance down to the first quartile and up to the third, of a cell of a JSON table; NaN without one."""
    if isinstance(cell, dict):
        return cell["median"], cell["median"] - cell["q1"], cell["q3"] - cell["median"]
    return (float("nan"), 0.0, 0.0) if cell is None else (float(cell), 0.0, 0.0)


def _bars(axes: Any, table: dict[str, Any], plot: dict[str, Any]) -> None:
    rows, columns = table["rows"], plot["columns"]
    height = 0.8 / len(columns)
    for k, column in enumerate(columns):
        values = [_value(row.get(column)) for row in rows]
        places = [i + (k - (len(columns) - 1) / 2) * height for i in range(len(rows))]
        errors = [[low for _, low, _ in values], [high for _, _, high in values]]
        axes.barh(places, [value for value, _, _ in values], height, xerr=errors, label=column)
    names = [", ".join(str(row[label]) for label in table["labels"]) for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.invert_yaxis()
    axes.set_xlabel(plot["y"])


def _lines(axes: Any, table: dict[str, Any], plot: dict[str, Any]) -> None:
    by = plot.get("by", [])
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in table["rows"]:
        groups.setdefault(", ".join(str(row[label]) for label in by), []).append(row)
    for group, rows in groups.items():
        for column in plot["columns"]:
            present = [row for row in rows if row.get(column) is not None]
            if not present:
                continue
            values = [_value(row[column]) for row in present]
            errors = [[low for _, low, _ in values], [high for _, _, high in values]]
            name = ", ".join(text for text in (group, column if len(plot["columns"]) > 1 or not group else "") if text)
            x = [_value(row[plot["x"]])[0] for row in present]
            axes.errorbar(x, [value for value, _, _ in values], yerr=errors, marker="o", label=name)
    axes.set_xscale("log", base=plot.get("base", 2))
    axes.set_yscale(plot.get("scale", "linear"))
    axes.set_xlabel(plot["x"])
    axes.set_ylabel(plot["y"])


def draw(document: dict[str, Any], path: str) -> None:
    """Draw the tables of a JSON document that have a plot, one below the other, into an image file."""
    require_matplotlib()
    from matplotlib.figure import Figure

    tables = [table for table in document["tables"] if table["plot"]]
    heights = [
        1.5 + 0.25 * len(t["rows"]) * len(t["plot"]["columns"]) if t["plot"]["kind"] == "bars" else 4 for t in tables
    ]
    figure = Figure(figsize=(9, sum(heights) + 0.5), layout="constrained")
    all_axes = figure.subplots(len(tables), squeeze=False, height_ratios=heights)[:, 0]
    for axes, table in zip(all_axes, tables, strict=True):
        (_bars if table["plot"]["kind"] == "bars" else _lines)(axes, table, table["plot"])
        axes.set_title(table["title"], fontsize="small", wrap=True)
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    where = document["machine"]
    figure.supxlabel(f"{where['cpu']}; torchrender {document['versions']['torchrender']}", fontsize="x-small")
    figure.savefig(path)
