"""Flights of rays through a field, by the core: autograd functions of its control values and of the rays.

All is in voxels here: positions q, velocities u in voxels a step, and the symmetric matrix G (as xx, yy, zz, xy, xz,
yz) of a kick u += G grad Phi. What of the world they come from, and what becomes of them there, is PyTorch's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from ..autograd import dense_tangents, zero_gradient
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from ..scene.native import NativeScene

TOO_LONG, TOO_FAR = -1, -2  # in place of a shape: rays that were given up


@dataclass
class Bending:
    """What the core is asked with, but for tensors: `torch.func` unwraps those of a function's arguments alone.

    `size` is (X, Y, Z), `constant` the part of Phi that the control values do not have.
    """

    native: NativeScene
    size: tuple[int, int, int]
    constant: float
    quadratic: bool
    medium: int  # its number
    threads: int = field(default_factory=torch.get_num_threads)

    def call(
        self, what: str, n: int, arrays: Mapping[str, torch.Tensor | None], params: list[torch.Tensor] | None = None
    ) -> None:
        """`params`: of the scene, which tracing meets."""
        numbers = dict(zip("xyz", map(float, self.size), strict=True))
        numbers |= {"constant": self.constant, "quadratic": float(self.quadratic), "threads": float(self.threads)}
        numbers |= {"medium": float(self.medium)}
        given = {name: t.data_ptr() for name, t in arrays.items() if t is not None}
        if params is None:
            self.native.handle.bend(what, n, numbers, given, [], [])
        else:
            self.native.call("bend", params, what, n, numbers, given)

    def empty(self, *shape: int) -> torch.Tensor:
        return torch.empty(shape, dtype=self.native.dtype)

    def ends(self, n: int) -> dict[str, torch.Tensor]:
        """Room for where flights end, or for its tangents."""
        return {"last_q": self.empty(n, 3), "last_u": self.empty(n, 3), "sums": self.empty(n, 2)}


def _dense(*tensors: torch.Tensor) -> list[torch.Tensor]:
    return [t.detach().contiguous() for t in tensors]


def _like(tangents: tuple[torch.Tensor | None, ...], primals: list[torch.Tensor]) -> list[torch.Tensor]:
    """Tangents, zero where there are none."""
    dense = dense_tangents(primals, tangents, primals[0].dtype)
    return [torch.zeros_like(p) if t is None else t for t, p in zip(dense, primals, strict=True)]


class Flights(UnbatchedFunction):
    """``last_q, last_u, sums, state, steps, shape, primitive, t = Flights.apply(bending, values, kick, q, u, ...)``.

    To the last kick before a surface; the first three are differentiable, by the first four tensors. The others are
    where surfaces count from (N, 3), relative to where rays begin, and the scene's parameters.
    """

    @staticmethod
    def forward(bending: Bending, *inputs: torch.Tensor) -> Any:
        values, kick, q, u, offset, *params = _dense(*inputs)
        n = len(q)
        state = torch.empty(n, 6, dtype=torch.int64 if q.dtype == torch.float64 else torch.int32)
        out = bending.ends(n)
        out |= {"state": state, "steps": torch.empty(n, dtype=torch.int32)}
        out |= {
            "shape_id": torch.empty(n, dtype=torch.int32),
            "prim_id": torch.empty(n, dtype=torch.int32),
            "t": bending.empty(n),
        }
        given = {"values": values, "kick": kick, "q": q, "u": u, "offset": offset}
        bending.call("trace", n, {**given, **out}, params)
        return tuple(out.values())

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.bending, *tensors = inputs
        ctx.others = len(tensors) - 4
        tensors = tensors[:4]
        ctx.save_for_backward(*tensors, *output[3:5])
        ctx.save_for_forward(*tensors, *output[3:5])
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(*output[3:])

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:5]
        if not any(needed) or all(a is None for a in adjoints[:3]):
            return (None,) * (5 + ctx.others)
        found = FlightsReverse.apply(ctx.bending, needed, *adjoints[:3], *ctx.saved_tensors)
        return (None, *found, *(None,) * ctx.others)

    @staticmethod
    def jvp(ctx: Any, _bending: Any, *tangents: torch.Tensor | None) -> Any:
        return (*FlightsForward.apply(ctx.bending, *tangents[:4], *ctx.saved_tensors), *(None,) * 5)


class FlightsReverse(DerivativeFunction):
    """Adjoints of values, kick, q and u from those of the end, by the same steps backwards."""

    @staticmethod
    def forward(bending: Bending, needed: tuple[bool, ...], *tensors: torch.Tensor | None) -> Any:
        adjoints = tensors[:3]
        values, kick, q, u, state, steps = [t for t in tensors[3:] if t is not None]
        for adjoint in adjoints:
            if adjoint is not None:
                refuse_batches(adjoint)
        n = len(q)
        last = _like(adjoints, [q, u, bending.empty(n, 2)])
        q_bar, u_bar = bending.empty(n, 3), bending.empty(n, 3)
        values_bar = zero_gradient(values) if needed[0] else None
        kick_bar = torch.zeros(6, dtype=torch.float64)
        found = {"q_bar": q_bar, "u_bar": u_bar, "values_bar": values_bar, "kick_bar": kick_bar}
        given = dict(zip(("values", "kick", "q", "u"), _dense(values, kick, q, u), strict=True))
        given |= {"state": state, "steps": steps}
        bending.call("reverse", n, {**given, **dict(zip(("last_q", "last_u", "sums"), last, strict=True)), **found})
        return values_bar, kick_bar.to(q.dtype), q_bar, u_bar


class FlightsForward(DerivativeFunction):
    """Tangents of the end from those of values, kick, q and u, by the same steps once more."""

    @staticmethod
    def forward(bending: Bending, *tensors: torch.Tensor | None) -> Any:
        tangents = tensors[:4]
        values, kick, q, u, _, steps = [t for t in tensors[4:] if t is not None]
        primals = _dense(values, kick, q, u)
        dense = dense_tangents(primals[:1], tangents[:1], values.dtype) + _like(tangents[1:], primals[1:])
        n = len(q)
        out = bending.ends(n)
        names = ("values", "kick", "q", "u")
        given = dict(zip(names, primals, strict=True))
        given |= {f"{name}_tangent": t for name, t in zip(names, dense, strict=True)}
        bending.call("forward", n, {**given, "steps": steps, **out})
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
        q_bar, values_bar = bending.empty(len(q), 3), zero_gradient(values) if needed[0] else None
        given = {"values": values, "q": q, "value": value, "slope": slope}
        bending.call("field_reverse", len(q), {**given, "q_bar": q_bar, "values_bar": values_bar})
        return values_bar, q_bar


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
