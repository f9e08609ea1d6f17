"""Text files of curves, as Mitsuba reads them: a control point and its radius a line, empty lines between curves.

`numpy.loadtxt` skips empty lines, which are what separates curves.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch


def read_curves(path: Path) -> list[torch.Tensor]:
    """The curves of a file, each (N, 4) float64: positions and radii.

    Raises:
        ValueError: naming the line that is not four numbers, or a file without any.
    """
    curves: list[list[list[float]]] = [[]]
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            if not words:
                curves.append([])
                continue
            try:
                row = [float(word) for word in words]
            except ValueError:
                row = []
            if len(row) != 4:
                raise ValueError(f"{path}: line {number}: expected x, y, z and a radius, got {line.strip()[:40]!r}")
            curves[-1].append(row)
    found = [torch.tensor(rows, dtype=torch.float64) for rows in curves if rows]
    if not found:
        raise ValueError(f"{path}: has no control points")
    return found


def write_curves(path: Path, points: np.ndarray, radii: np.ndarray, segments: np.ndarray, order: int) -> None:
    """Write curves so that reading them gives these segments, `order` + 1 control points each.

    Segments that follow each other, each beginning at the next control point, make one curve.
    """
    starts = np.flatnonzero(np.diff(segments, prepend=segments[0] - 2) != 1)
    with path.open("w", encoding="utf-8") as out:
        for begin, end in zip(starts, [*starts[1:], len(segments)], strict=True):
            for k in range(segments[begin], segments[end - 1] + order + 1):
                out.write(" ".join(repr(float(x)) for x in (*points[k], radii[k])) + "\n")
            out.write("\n")
