"""How much two files of `same_program.py` differ."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np

HARDLY = 1e-2  # of the largest array of its kind: below that a difference is relative to this


@dataclass
class Comparison:
    """What one scene has in common with itself in another state.

    Attributes:
        sizes: relative difference by the name of the array, 0 being bit-equal.
        rounding: of arrays in single precision that differ, how far the other state's is from its own in double.
        refused: what is refused in one state only, or as another kind of error.
        reworded: refused in both, in other words.
        only_here, only_before: what the other state does not know.
    """

    sizes: dict[str, float] = field(default_factory=dict)
    rounding: dict[str, float] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)
    reworded: list[str] = field(default_factory=list)
    only_here: list[str] = field(default_factory=list)
    only_before: list[str] = field(default_factory=list)

    def worst(self, dtype: str, column: str) -> tuple[float, str] | None:
        """The largest difference of images, outputs, reverse or forward derivatives, and its name; None without any."""
        own = [(size, key) for key, size in self.sizes.items() if belongs(key, dtype, column)]
        return max(own, default=None)


def belongs(key: str, dtype: str, column: str) -> bool:
    """Whether an array, such as "float64/rgb/own/reverse all/ball.radius", is one of a column's."""
    kind, _, _, mode, _ = key.split("/", 4)
    return kind == dtype and mode.split(" ")[0] == column


def group(key: str) -> str:
    """What an array belongs to: one rendering call."""
    return "/".join(key.split("/", 4)[:4])


def largest(values: np.ndarray) -> float:
    """The largest absolute value that is finite."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def difference(now: np.ndarray, before: np.ndarray, least: float) -> float:
    """The largest difference, relative to the largest number before, which counts as at least `least`."""
    if now.shape != before.shape or now.dtype != before.dtype:
        return float("inf")
    if np.array_equal(now, before, equal_nan=before.dtype.kind == "f"):
        return 0.0
    if before.dtype.kind != "f":
        return float("inf")
    finite = np.isfinite(before)
    if not np.array_equal(now[~finite], before[~finite], equal_nan=True) or not np.isfinite(now[finite]).all():
        return float("inf")
    size, scale = float(np.abs(now[finite] - before[finite]).max()), max(largest(before), least)
    return size / scale if scale > 0 else float("inf")


def compare(
    now: dict[str, Any], before: dict[str, Any], said: dict[str, str], said_before: dict[str, str]
) -> Comparison:
    """Arrays and refusals by name, of this state and of the other."""
    found = Comparison()
    scales: dict[str, float] = {}
    for key, values in before.items():
        scales[group(key)] = max(scales.get(group(key), 0.0), largest(values))
    for key in now.keys() & before.keys():
        least = HARDLY * scales[group(key)]
        found.sizes[key] = difference(now[key], before[key], least)
        exact = before.get("float64" + key.removeprefix("float32"))
        if found.sizes[key] > 0 and key.startswith("float32") and exact is not None:
            found.rounding[key] = difference(before[key], exact.astype(before[key].dtype), least)
    for key, text in said.items():
        other = said_before.get(key)
        if other is None:
            covered = any(covers(key, k) for k in before)
            (found.refused if covered else found.only_here).append(f"{key}, here: {text}" if covered else key)
        elif other.partition(":")[0] != text.partition(":")[0]:
            found.refused.append(f"{key}, here: {text}; before: {other}")
        elif other != text:
            found.reworded.append(f"{key}, here: {text}; before: {other}")
    for key, text in said_before.items():
        if key not in said:
            covered = any(covers(key, k) for k in now)
            (found.refused if covered else found.only_before).append(f"{key}, before: {text}" if covered else key)
    # What is missing because it was refused has been said; the rest is not known there.
    for mine, theirs, words, result in ((now, before, said_before, "only_here"), (before, now, said, "only_before")):
        names = [k for k in mine if k not in theirs and not any(covers(refusal, k) for refusal in words)]
        getattr(found, result).extend(sorted(names))
    return found


def covers(refusal: str, key: str) -> bool:
    """Whether an array is missing where this was refused: a scene, a call, or a parameter in a call's derivatives."""
    if refusal == "scene":
        return True
    *call, mode, name = refusal.split("/", 4) if refusal.count("/") > 3 else (*refusal.split("/", 3), "")
    if mode == "parameter":
        return key.split("/", 4)[:3] == call and key.split("/", 4)[3].startswith("reverse") and key.endswith(f"/{name}")
    return group(key) == refusal or (mode == "image" and key.split("/", 4)[:3] == call)


def compare_files(now: str, before: str) -> Comparison:
    """Of two files."""
    arrays, said = [], []
    for file in (now, before):
        with np.load(file) as stored:
            arrays.append({name: stored[name] for name in stored.files if name != "said"})
            said.append(json.loads(str(stored["said"])))
    if "scene" in said[0] or "scene" in said[1]:
        return of_scenes(said[0].get("scene"), said[1].get("scene"))
    return compare(*arrays, *said)


def of_scenes(here: str | None, before: str | None) -> Comparison:
    """Of a scene that at least one state does not load: what is said then."""
    if here is None:
        return Comparison(only_here=[f"the scene; before: {before}"])
    if before is None:
        return Comparison(only_before=[f"the scene; here: {here}"])
    return Comparison(reworded=[f"here: {here}; before: {before}"] * (here != before))
