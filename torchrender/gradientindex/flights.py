"""Flights of rays through a field, by the core: autograd functions of its control values and of the rays.

All is in voxels here: positions q, velocities u in voxels a step, and the symmetric matrix G (as xx, yy, zz, xy, xz,
yz) of a kick u += G grad Phi. What of the world they come from, and what becomes of them there, is PyTorch's.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from ..autograd import dense_tangents, zero_gradient
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from ..scene.native import NativeScene

TOO_LONG, TOO_FAR = -1, -2  # in place of a shape: rays that were given up
GRIDS = ("extinction", "emission")  # of what a medium does to light


@dataclass
class Bending:
    """What the core is asked with, but for tensors: `torch.func` unwraps those of a function's arguments alone.

    `size` is (X, Y, Z), `constant` the part of Phi that the control values do not have; `look_up`: of each grid the
    numbers of its filter and of what is beyond its cube. `known`: what `Flights` has found for these rays before, which
    are not followed again then. `partials` (threads, Z, Y, X): where derivatives by control values are added, in place
    of being returned.
    """

    native: NativeScene
    size: tuple[int, int, int]
    constant: float
    quadratic: bool
    medium: int  # its number
    step: float
    look_up: dict[str, tuple[int, int]]
    known: tuple[torch.Tensor, ...] | None = None
    partials: torch.Tensor | None = None
    threads: int = field(default_factory=torch.get_num_threads)

    def call(
        self,
        what: str,
        n: int,
        arrays: Mapping[str, torch.Tensor | None],
        params: list[torch.Tensor] | None = None,
        partials: bool = False,
    ) -> None:
        """`params`: of the scene, which tracing meets; `partials`: each thread has derivatives by values of its own."""
        numbers = dict(zip("xyz", map(float, self.size), strict=True))
        threads = len(self.partials) if partials and self.partials is not None else self.threads
        numbers |= {"constant": self.constant, "quadratic": float(self.quadratic), "threads": float(threads)}
        numbers |= {"medium": float(self.medium), "step": self.step, "partials": float(partials)}
        for name in GRIDS:
            grid = arrays.get(name)
            if grid is not None:
                sizes = zip(("z", "y", "x", "channels"), grid.shape, strict=True)
                numbers |= {f"{name}_{axis}": float(size) for axis, size in sizes}
                of = dict(zip(("filter", "wrap"), self.look_up[name], strict=True))
                numbers |= {f"{name}_{what}": float(value) for what, value in of.items()}
        given = {name: t.data_ptr() for name, t in arrays.items() if t is not None}
        if params is None:
            self.native.handle.bend(what, n, numbers, given, [], [])
        else:
            self.native.call("bend", params, what, n, numbers, given)

    def empty(self, *shape: int) -> torch.Tensor:
        return torch.empty(shape, dtype=self.native.dtype)

    def ends(self, n: int) -> dict[str, torch.Tensor]:
        """Room for where flights end, or for its tangents."""
        colours = 3 if self.look_up else 0
        sums = {"sums": self.empty(n, 2), "depth": self.empty(n, colours), "emitted": self.empty(n, colours)}
        return {"last_q": self.empty(n, 3), "last_u": self.empty(n, 3), **sums}

    def reverse(
        self, what: str, n: int, values: torch.Tensor | None, arrays: Mapping[str, torch.Tensor | None]
    ) -> torch.Tensor | None:
        """Calls the core for adjoints, of `values` too unless they are None, and returns these."""
        if values is None or self.partials is None:
            values_bar = None if values is None else zero_gradient(values)
            self.call(what, n, {**arrays, "values_bar": values_bar})
            return values_bar
        self.call(what, n, {**arrays, "values_bar": self.partials}, partials=True)
        return None


def _dense(*tensors: torch.Tensor) -> list[torch.Tensor]:
    return [t.detach().contiguous() for t in tensors]


def _like(tangents: tuple[torch.Tensor | None, ...], primals: list[torch.Tensor]) -> list[torch.Tensor]:
    """Tangents, zero where there are none."""
    dense = dense_tangents(primals, tangents, primals[0].dtype)
    return [torch.zeros_like(p) if t is None else t for t, p in zip(dense, primals, strict=True)]


_INPUTS = ("values", "kick", "q", "u", "extinction", "extinction_map", "emission", "emission_map")
_ENDS = 5  # outputs that are differentiable


def _named(tensors: Iterable[torch.Tensor]) -> dict[str, torch.Tensor]:
    """Tensors in the order of `_INPUTS` by their names, those of grids that are not there left out."""
    named = dict(zip(_INPUTS, tensors, strict=True))
    return {name: t for name, t in named.items() if not (name.startswith(GRIDS) and t.numel() == 0)}


class Flights(UnbatchedFunction):
    """``last_q, last_u, sums, depth, emitted, state, steps, shape, primitive, t = Flights.apply(bending, *inputs)``.

    To the last kick before a surface; the first five are differentiable, by the first eight inputs: values, kick, q, u,
    and grids (Z, Y, X, C) of extinction and emission with the maps (3, 4) from voxels of the field to their unit cubes,
    without an element where there is no such grid. The others are where surfaces count from (N, 3), relative to where
    rays begin, and the scene's parameters. `depth` and `emitted` (N, 3) are of grids; (N, 0) without them.
    """

    @staticmethod
    def forward(bending: Bending, *inputs: torch.Tensor) -> Any:
        if bending.known is not None:
            return tuple(t.detach() for t in bending.known)
        tensors = _dense(*inputs)
        given, offset, params = tensors[: len(_INPUTS)], tensors[len(_INPUTS)], tensors[len(_INPUTS) + 1 :]
        q = given[2]
        n = len(q)
        state = torch.empty(n, 6, dtype=torch.int64 if q.dtype == torch.float64 else torch.int32)
        out = bending.ends(n)
        out |= {"state": state, "steps": torch.empty(n, dtype=torch.int32)}
        out |= {
            "shape_id": torch.empty(n, dtype=torch.int32),
            "prim_id": torch.empty(n, dtype=torch.int32),
            "t": bending.empty(n),
        }
        bending.call("trace", n, {**_named(given), "offset": offset, **out}, params)
        return tuple(out.values())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.bending, *tensors = inputs
        ctx.others = len(tensors) - len(_INPUTS)
        kept = *tensors[: len(_INPUTS)], output[3], *output[_ENDS : _ENDS + 2]  # and depth, state, steps
        ctx.save_for_backward(*kept)
        ctx.save_for_forward(*kept)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(*output[_ENDS:])

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1 : 1 + len(_INPUTS)]
        if not any(needed) or all(a is None for a in adjoints[:_ENDS]):
            return (None,) * (1 + len(_INPUTS) + ctx.others)
        found = FlightsReverse.apply(ctx.bending, needed, *adjoints[:_ENDS], *ctx.saved_tensors)
        return (None, *found, *(None,) * ctx.others)

    @staticmethod
    def jvp(ctx: Any, _bending: Any, *tangents: torch.Tensor | None) -> Any:
        ends = FlightsForward.apply(ctx.bending, *tangents[: len(_INPUTS)], *ctx.saved_tensors)
        return (*ends, *(None,) * 5)


class FlightsReverse(DerivativeFunction):
    """Adjoints of the inputs from those of the end, by the same steps backwards."""

    @staticmethod
    def forward(bending: Bending, needed: tuple[bool, ...], *tensors: torch.Tensor | None) -> Any:
        adjoints = tensors[:_ENDS]
        *inputs, depth, state, steps = [t for t in tensors[_ENDS:] if t is not None]
        inputs = _dense(*inputs)
        for adjoint in adjoints:
            if adjoint is not None:
                refuse_batches(adjoint)
        n = len(inputs[2])
        names = ("last_q", "last_u", "sums", "depth_bar", "emitted_bar")
        given = dict(zip(names, _like(adjoints, list(bending.ends(n).values())), strict=True))
        found: dict[str, torch.Tensor | None] = {
            "kick_bar": torch.zeros(6, dtype=torch.float64),
            "q_bar": bending.empty(n, 3),
            "u_bar": bending.empty(n, 3),
        }
        for k in (4, 6):
            there = inputs[k].numel() > 0
            found[f"{_INPUTS[k]}_bar"] = zero_gradient(inputs[k]) if there and needed[k] else None
            found[f"{_INPUTS[k + 1]}_bar"] = torch.zeros(3, 4, dtype=torch.float64) if there else None
        arrays = {**_named(inputs), "depth": depth, "state": state, "steps": steps, **given, **found}
        values_bar = bending.reverse("reverse", n, inputs[0] if needed[0] else None, arrays)
        return values_bar, *(t if t is None else t.to(inputs[0].dtype) for t in found.values())


class FlightsForward(DerivativeFunction):
    """Tangents of the end from those of the inputs, by the same steps once more."""

    @staticmethod
    def forward(bending: Bending, *tensors: torch.Tensor | None) -> Any:
        tangents = tensors[: len(_INPUTS)]
        *inputs, _, _, steps = [t for t in tensors[len(_INPUTS) :] if t is not None]
        primals = _dense(*inputs)
        dense = dense_tangents(primals, tangents, primals[0].dtype)
        large = (0, 4, 6)  # may be missing
        dense = [t if k in large or t is not None else torch.zeros_like(primals[k]) for k, t in enumerate(dense)]
        n = len(primals[2])
        out = bending.ends(n)
        changes = {f"{name}_tangent": t for name, t in zip(_INPUTS, dense, strict=True) if t is not None}
        bending.call("forward", n, {**_named(primals), **changes, "steps": steps, **out})
        return tuple(out.values())


class Field(UnbatchedFunction):
    """``value, slope = Field.apply(bending, values, q)``: Phi without its constant (N,), its gradient (N, 3)."""

    @staticmethod
    def forward(bending: Bending, *inputs: torch.Tensor) -> Any:
        values, q = _dense(*inputs)
        value, slope = bending.empty(len(q)), bending.empty(len(q), 3)
        bending.call("field", len(q), {"values": values, "q": q, "value": value, "slope": slope})
        return value, slope

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.bending, *tensors = inputs
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if not any(needed) or all(a is None for a in adjoints):
            return None, None, None
        return (None, *FieldReverse.apply(ctx.bending, needed, *adjoints, *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _bending: Any, *tangents: torch.Tensor | None) -> Any:
        return FieldForward.apply(ctx.bending, *tangents, *ctx.saved_tensors)


class FieldReverse(DerivativeFunction):
    """Adjoints of values and points."""

    @staticmethod
    def forward(bending: Bending, needed: tuple[bool, ...], *tensors: torch.Tensor | None) -> Any:
        values, q = _dense(*[t for t in tensors[2:] if t is not None])
        for adjoint in tensors[:2]:
            if adjoint is not None:
                refuse_batches(adjoint)
        value, slope = _like(tensors[:2], [bending.empty(len(q)), q])
        q_bar = bending.empty(len(q), 3)
        arrays = {"values": values, "q": q, "value": value, "slope": slope, "q_bar": q_bar}
        return bending.reverse("field_reverse", len(q), values if needed[0] else None, arrays), q_bar


class FieldForward(DerivativeFunction):
    """Tangents of value and gradient."""

    @staticmethod
    def forward(bending: Bending, *tensors: torch.Tensor | None) -> Any:
        values, q = _dense(*[t for t in tensors[2:] if t is not None])
        value, slope = bending.empty(len(q)), bending.empty(len(q), 3)
        tangents = {"values_tangent": dense_tangents([values], tensors[:1], values.dtype)[0]}
        tangents["q_tangent"] = _like(tensors[1:2], [q])[0]
        bending.call("field_forward", len(q), {"values": values, "q": q, "value": value, "slope": slope, **tangents})
        return value, slope
