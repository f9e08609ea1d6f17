"""The outlines of a scene as the core knows them, and samples of their motion: csrc/cpu/render_boundary.cpp."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch

from ..seeds import mix
from .allotment import LEAST, factors
from .boundary_call import BoundaryCall
from .film_sums import FilmPlaces

# Tell the seeds of samples from those of paths.
STREAMS = {
    "silhouettes": 0x766973,
    "outputs": 0x6F7574,
    "reflections": 0x7665727478,
    "shadows": 0x6C69676874,
    "pilot": 0x70696C6F74,
}
LENGTHWISE = 4  # samples for each pixel of an outline's length, in those of a pixel
NEAR = 0.02  # what is close, in sizes of the scene
BLOCK = 1 << 18  # samples whose places and values forward mode keeps at a time
BATCH = 1024  # samples that the core works on together, of which each may depend on the others
FEW = 256  # samples that tell how much the camera sees of what lights find
LOOKS = 128  # samples that tell how much each part brings, where there are eight times as many


@contextlib.contextmanager
def outlines_of(
    boundary: BoundaryCall, params: Sequence[torch.Tensor], film: FilmPlaces, threads: int
) -> Iterator[Outlines]:
    """Those of a scene. The core's are kept from call to call, and brought up to date: one thread at a time has them.

    Args:
        params: by slot, without derivatives.
        threads: of the core.
    """
    layout, core = boundary.call.layout, boundary.call.native.core
    key, known = (layout.index_key(), core), layout.edges
    if known is None or known[0] != key:
        layout.edges = known = key, core.Outlines(), threading.Lock()
    _, handle, lock = known
    with lock:
        yield Outlines(boundary, params, film, threads, handle)


class Outlines:
    """A scene's outlines as one camera sees them."""

    def __init__(
        self, boundary: BoundaryCall, params: Sequence[torch.Tensor], film: FilmPlaces, threads: int, handle: Any
    ) -> None:
        self.boundary, self.film, self.params = boundary, film, list(params)
        self.call = call = boundary.call
        outputs = boundary.outputs
        settings = {} if outputs is None else outputs.settings()
        self.names = {} if outputs is None else dict.fromkeys(outputs.core_names(), 1)
        settings |= {"threads": threads, "fixed_sums": torch.are_deterministic_algorithms_enabled()}
        self.configs = [{**c, **settings} for c in call.configs(derivative=True)]
        self.statistics: dict[str, dict[str, float]] = {}
        call.statistics["visibility" if outputs is None else "visibility_outputs"] = self.statistics
        self.moves = boundary.moves.to(torch.uint8).contiguous()
        self.handle = handle
        self.length = call.native.call(
            "find_outlines", self.params, self.configs[0], self.moves.data_ptr(), self.handle
        )
        self.cells = film.cells(call.config["window"]).contiguous()
        box = call.native.handle.bounding_box()
        near = NEAR * math.dist(box[:3], box[3:])
        self.numbers = {"cells": len(self.cells), "near": near, "in_view": 1.0, "weighs": 0}
        self.parts: list[str] = []
        self.factors: dict[str, float] = {}  # of the usual numbers of samples, by part, where they are not those
        if not len(self.cells):  # no pixel is wanted
            return
        moves = bool(boundary.moves.any())
        if boundary.spp[0] > 0 and self.length > 0 and (moves or not boundary.glued):
            self.parts.append("silhouettes" if outputs is None else "outputs")
        if boundary.spp[1] > 0:
            self.numbers["in_view"] = self._share_in_view()
            self.parts += ["shadows", "reflections"] if moves else ["shadows"]
        if boundary.by_length and "reflections" in self.parts:
            self._share_out()

    def _share_in_view(self) -> float:
        """About which share of the edges that lights find the camera sees, in the wanted pixels: of a few samples.

        With lights in view of which it sees few, those are left to the vertices. A function of the seed alone.
        """
        place = torch.zeros(FEW, 2, dtype=torch.float64)
        value = torch.zeros(FEW, dtype=torch.float64)
        out = {"place": place.data_ptr(), "value": value.data_ptr()}
        numbers = {"first": 0, "count": FEW, "total": 1, "samples": 1}
        self._look("pilot", numbers, out)
        edges, seen = float(value.sum()), place[torch.isfinite(place).all(1)]
        return min(1.0, max(float(self.film.wanted(seen).sum()) / edges, 1e-3)) if edges else 1.0

    def _share_out(self) -> None:
        """Finds the factors of the usual numbers of samples, from a few of each part: a function of the seed alone."""
        usual = {part: float(self._count(part)) for part in self.parts}
        if usual["reflections"] <= max(8 * LOOKS, LEAST):  # looking would take too long
            return
        value = torch.zeros(LOOKS, dtype=torch.float64)
        numbers = {"first": 0, "count": LOOKS, "total": LOOKS, "samples": LOOKS, "weighs": 1}
        brought, rays = {}, 0.0
        for part in self.parts:
            rays = self._look(part, numbers, {"value": value.zero_().data_ptr()}) / LOOKS
            brought[part] = float(value.sqrt().sum())
        self.factors = factors(usual, brought, rays)

    def reverse(self, adjoint: torch.Tensor, grads: Sequence[torch.Tensor | None]) -> None:
        """Adds to the gradients, by slot; `adjoint` (H, W, channels) is that of the film, see `FilmPlaces`."""
        adjoint = adjoint.contiguous()
        addresses = [0 if g is None else g.data_ptr() for g in grads]
        self._call(list(self._blocks(1 << 62)), {"adjoint": adjoint.data_ptr()}, addresses, False)

    def forward(self, total: torch.Tensor, tangents: Sequence[torch.Tensor | None]) -> None:
        """Adds to the sums of the film, for tangents by slot."""
        addresses = [0 if t is None else t.data_ptr() for t in tangents]
        for part, config, numbers in self._blocks(BLOCK):
            rows = int(numbers["count"]) * (2 if part == "shadows" else 1)
            place = torch.zeros(rows, 2, dtype=torch.float64)
            value = torch.zeros(rows, self.film.channels, dtype=torch.float64)
            out = {"place": place.data_ptr(), "value": value.data_ptr()}
            self._call([(part, config, numbers)], out, addresses, True)
            some = (value != 0).any(1)
            self.film.splat(total, place[some], value[some])

    def _blocks(self, size: int) -> Iterator[tuple[str, dict[str, Any], dict[str, float]]]:
        """Parts, their passes' settings, and which samples to take."""
        for part in self.parts:
            count = self._count(part)
            for number, config in enumerate(self.configs):
                numbers = {"total": count * len(self.configs), "samples": count}
                own, end = self.call.share.part(count, BATCH)
                for begin in range(own, end, size):
                    yield part, config, {**numbers, "first": number * count + begin, "count": min(size, end - begin)}

    def _count(self, part: str) -> int:
        """Samples of a part in a pass: fewer for short silhouettes, a power of two for shadows (shadows.h)."""
        seen, shadows, reflections = self.boundary.spp
        usual = self.boundary.by_length
        if part in ("silhouettes", "outputs"):
            count = seen * math.prod(self.call.size)
            count = min(count, LENGTHWISE * self.call.spp_grad * self.length) if usual else count
        else:
            count = (shadows if part == "shadows" else reflections) * len(self.cells)
        count = math.ceil(max(self.factors.get(part, 1.0) * count, LEAST if usual else 0))
        return 2 ** round(math.log2(count)) if part == "shadows" and count else count

    def _look(self, part: str, numbers: Mapping[str, float], out: dict[str, int]) -> int:
        """Few samples of a part, which tell how the others are to be taken; returns how many rays they had."""
        config = {**self.configs[0], "seed": mix(self.configs[0]["seed"], STREAMS["pilot"])}
        return self._call([(part, config, numbers)], out, [0] * len(self.params), True)

    def _call(
        self,
        requests: Sequence[tuple[str, dict[str, Any], Mapping[str, float]]],
        out: dict[str, int],
        addresses: list[int],
        forward: bool,
    ) -> int:
        """What `_blocks` gives, in one call of the core, which makes gradients of a large mesh once for all; rays."""
        arrays = {"cells": self.cells.data_ptr(), "moves": self.moves.data_ptr()} | out
        configs = [{**config, "seed": mix(config["seed"], STREAMS[part])} for part, config, _ in requests]
        given = [{name: float(x) for name, x in {**self.numbers, **numbers}.items()} for *_, numbers in requests]
        read = configs, [part for part, *_ in requests], given
        rest = arrays, self.names, self.handle, addresses, forward
        results = self.call.native.call("boundary", self.params, read, *rest)
        for (part, _, numbers), found in zip(requests, results, strict=True):
            name = "pilot" if numbers.get("weighs") else part
            so_far = self.statistics.setdefault(name, {"samples": 0, "rays": 0, "seconds": 0.0})
            so_far["samples"] += int(numbers["count"])
            so_far["rays"] += found["closest_rays"] + found["shadow_rays"]
            so_far["seconds"] += found["seconds"]
        return sum(found["closest_rays"] + found["shadow_rays"] for found in results)
