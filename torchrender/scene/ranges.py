"""Parameters that leave their physical range while they are optimised: looked at in every rendering, cheaply.

Objects are checked when they are built and when something is assigned to them (`validation`). What optimisers write in
place nobody is told of; here the tensors that changed since the last rendering are compared with their ranges.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import torch

from ..errors import RangeWarning, warn_once
from ..functions import functorch
from .declaration import Field
from .packing import Layout
from .plugin import Plugin
from .validation import values_of

if TYPE_CHECKING:
    from .scene import Scene

MODES = ("warn", "raise", "ignore")
SMALL = 64  # numbers: tensors of at most so many are compared together
EAGER, SELDOM = 8, 16  # so many changes are looked at, then one of so many
SLACK = 1e-6  # relative to the range: what rounding does to an albedo of 1


class RangeWatch:
    """The ranges of a packed scene's parameters, and which of their values were looked at."""

    def __init__(self, scene: Scene, layout: Layout) -> None:
        self.layout = layout
        slots = {id(slot.tensor()): i for i, slot in enumerate(layout.slots)}
        self.fields: dict[int, list[Field]] = {}
        for module in scene.modules():
            for _, tensor, field in values_of(module) if isinstance(module, Plugin) else ():
                if id(tensor) in slots:
                    self.fields.setdefault(slots[id(tensor)], []).append(field)
        inf = float("inf")
        self.low = {i: max(-inf if f.min is None else f.min for f in fields) for i, fields in self.fields.items()}
        self.high = {i: min(inf if f.max is None else f.max for f in fields) for i, fields in self.fields.items()}
        self.watched = [i for i in self.fields if self.low[i] > -inf or self.high[i] < inf]
        self.seen: list[tuple[int, int]] = []
        self.changes = [0] * len(self.watched)  # how often they have changed
        self.limits: dict[tuple[int, ...], tuple[torch.Tensor, torch.Tensor]] = {}  # of small ones, by their slots

    def changed(self, tensors: list[torch.Tensor], always: bool) -> list[int]:
        """Slots to look at: those that may have changed since the last call, after a while only some of the times.

        A step of an optimiser should not wait for a look at all texels.
        """
        if always:
            return [i for i in self.watched if not functorch.is_functorch_wrapped_tensor(tensors[i])]
        try:
            state = [(tensor.data_ptr(), tensor._version) for tensor in map(tensors.__getitem__, self.watched)]
        except RuntimeError:  # within function transforms, in inference mode
            return []
        if state == self.seen:
            return []
        before = self.seen or [(0, -1)] * len(state)
        found = []
        for k, (old, new) in enumerate(zip(before, state, strict=True)):
            if old != new:
                self.changes[k] += 1
                if self.changes[k] < EAGER or self.changes[k] % SELDOM == 0:
                    found.append(self.watched[k])
        self.seen = state
        return found

    def outside(self, tensors: list[torch.Tensor], always: bool) -> Iterator[tuple[str, float, float, float, str]]:
        """Of changed parameters that are out of range: name, the worst value, the range, the field's name."""
        changed = self.changed(tensors, always)
        small = [i for i in changed if 0 < tensors[i].numel() <= SMALL]
        suspects: Iterable[int] = [i for i in changed if tensors[i].numel() > SMALL]
        if small and self._any_outside(small, tensors):
            suspects = [*suspects, *small]
        for i in suspects:
            low, high = (float(x) for x in torch.aminmax(tensors[i].detach()))
            least, most = self._bounds(i)
            value = low if low < least else high
            if not least <= value <= most and abs(value) < float("inf"):  # what is not finite is refused elsewhere
                yield self.layout.slots[i].name, value, self.low[i], self.high[i], self.fields[i][0].name

    def _bounds(self, i: int) -> tuple[float, float]:
        size = max(1.0, abs(self.high[i]) if self.high[i] < float("inf") else 1.0)
        return self.low[i] - SLACK * size, self.high[i] + SLACK * size

    def _any_outside(self, slots: list[int], tensors: list[torch.Tensor]) -> bool:
        values = torch.cat([tensors[i].detach().reshape(-1) for i in slots])
        key = tuple(slots)
        if key not in self.limits or self.limits[key][0].shape != values.shape:
            bounds = [self._bounds(i) for i in slots for _ in range(tensors[i].numel())]
            low, high = values.new_tensor(bounds).T.contiguous()
            self.limits[key] = (low, high)
        low, high = self.limits[key]
        return not bool(torch.equal(values.clamp(low, high), values))


def check_ranges(scene: Scene, layout: Layout, tensors: list[torch.Tensor], mode: str) -> None:
    """Warn once for each parameter that has left its range, or raise ValueError, as `mode` (one of MODES) says."""
    if mode == "ignore":
        return
    watch: Any = scene.__dict__.get("_watch")
    if watch is None or watch.layout is not layout:
        watch = scene.__dict__["_watch"] = RangeWatch(scene, layout)
    with torch.no_grad():
        for name, value, low, high, field in watch.outside(tensors, mode == "raise"):
            bounds = f"{low:g}, {high:g}" if high < float("inf") else f"min={low:g}"
            constraint = f"ScaledSigmoid({low:g}, {high:g})" if high < float("inf") else f"Positive({low:g})"
            text = (
                f"{name}: {value:.4g} is outside of [{low:g}, {high:g}], the range of {field}. Keep it inside with "
                f"`parameter.clamp_({bounds})` under torch.no_grad() after every step, or optimise what "
                f"tr.constraints.{constraint} maps into it (see tr.constraints)"
            )
            if mode == "raise":
                raise ValueError(f"render: {text}")
            warn_once(scene.warned, f"{name}: range", text, RangeWarning)
