"""The time that Embree alone needs for the rays of a rendering: a limit for whatever else a renderer does.

The very rays of one image, or of one derivative, are recorded as they were queried, batch by batch, and traced again on
the same number of threads by a loop that does nothing else: it reads the rays, calls Embree and looks whether there is
a hit. (Reading them from main memory, 28 bytes each, costs it a little that a renderer need not pay.) Camera rays, rays
after a bounce and shadow rays of both are traced by themselves, each with the number of rays a query (1, 4, 8 or 16)
and the hint, that they are similar or not, with which they are fastest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torchrender import backends

from .ours import Ours

KINDS = ("camera", "bounce", "camera shadow", "bounce shadow")


@dataclass(frozen=True)
class Query:
    """How Embree is asked: rays a query, and whether it is told that they are similar."""

    width: int
    coherent: bool

    def __str__(self) -> str:
        return f"{self.width} coherent" if self.coherent else str(self.width)


QUERIES = (Query(1, False), *(Query(width, coherent) for width in (4, 8, 16) for coherent in (False, True)))
LIMIT = 1 << 23  # rays of a kind that are kept, 28 bytes each; the time of more is extrapolated


class EmbreeAlone:
    """The recorded rays of an image (`derivative` false) or of a derivative pass of a scene."""

    def __init__(self, ours: Ours, derivative: bool, threads: int, seed: int = 0, limit: int = LIMIT) -> None:
        self.threads = threads
        image = ours.renderer(seed=seed)  # makes the native scene, if there is none
        self.handle, self.record = ours.scene._native.handle, backends.core().RayRecord(limit)
        self.handle.record_rays(self.record)
        try:
            if derivative:
                image.square().mean().backward()
            else:
                ours.renderer(seed=seed)
        finally:
            self.handle.record_rays(None)
        self.counts: dict[str, dict[str, int]] = self.record.counts()
        self.kinds = [kind for kind in KINDS if self.counts[kind]["rays"]]
        self.rays = sum(self.count(kind) for kind in self.kinds)
        # Seconds by kind and query, best of three.
        self.trials = {kind: self._try(kind) for kind in self.kinds}
        self.queries = {kind: min(trial, key=trial.__getitem__) for kind, trial in self.trials.items()}

    def count(self, kind: str) -> int:
        """How many rays of a kind the rendering queries."""
        return self.counts[kind]["rays"] + self.counts[kind]["left_out"]

    def _try(self, kind: str) -> dict[Query, float]:
        found = {}
        for query in QUERIES:
            try:
                found[query] = min(self.replay(kind, query, 3))
            except ValueError:  # wider than what Embree has code for here
                break
        return found

    def replay(self, kind: str, query: Query, rounds: int) -> list[float]:
        """Seconds of each round for the rays of a kind, extrapolated to those that were not kept."""
        scale = self.count(kind) / self.counts[kind]["rays"]
        arguments = (self.record, kind, query.width, query.coherent, self.threads, rounds)
        replay: dict[str, Any] = self.handle.replay_rays(*arguments)
        return [seconds * scale for seconds in replay["seconds"]]

    def round(self) -> float:
        """Seconds for all rays, each kind with its best query."""
        return sum(self.replay(kind, self.queries[kind], 1)[0] for kind in self.kinds)

    def described(self) -> str:
        """Such as "camera 16 coherent, bounce 8, camera shadow 16, bounce shadow 8": rays a query."""
        return ", ".join(f"{kind} {self.queries[kind]}" for kind in self.kinds)


class Pair:
    """Embree alone for the image and for the derivative pass of a scene."""

    def __init__(self, ours: Ours, threads: int) -> None:
        self.image = EmbreeAlone(ours, False, threads)
        self.derivative = EmbreeAlone(ours, True, threads)
        self.rays = self.image.rays + self.derivative.rays

    def round(self, _number: int = 0) -> dict[str, float]:
        """Seconds of the image, and of both one after the other."""
        forward = self.image.round()
        return {"forward": forward, "sum": forward + self.derivative.round()}

    def described(self) -> str:
        return f"image: {self.image.described()}; derivative: {self.derivative.described()}"
