"""The derivative of one view's outlines, in both modes; see the package's docstring."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import torch

from ..autograd import dense_tangents, zero_gradient
from ..first_hit_call import FirstHitCall
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from ..render_call import RenderCall
from .boundary_call import BoundaryCall, all_placing_slots, boundary_of
from .on_film import Averages, Radiance
from .outlines import outlines_of


def outline_terms(
    call: RenderCall, params: Sequence[torch.Tensor], outputs: FirstHitCall | None = None
) -> tuple[torch.Tensor, ...] | None:
    """Zeros with the motion of outlines as their derivative; None if nothing that moves them may be differentiated.

    They are of the image and, where it is wanted, alpha, or of `outputs` in the core's order.
    """
    boundary = boundary_of(call, params, outputs)
    return None if boundary is None else BoundaryFunction.apply(boundary, *params)


class BoundaryFunction(UnbatchedFunction):
    """``terms = BoundaryFunction.apply(boundary, *parameters)``, see `outline_terms`."""

    @staticmethod
    def forward(boundary: BoundaryCall, *params: torch.Tensor) -> Any:
        return Radiance.zeros(boundary.call) if boundary.outputs is None else Averages.zeros(boundary.outputs)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.boundary, *params = inputs
        ctx.save_for_backward(*params)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if all(a is None for a in adjoints) or not any(needed):
            return (None,) * (1 + len(needed))
        return (None, *_Vjp.apply(ctx.boundary, needed, len(adjoints), *adjoints, *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _boundary: Any, *tangents: torch.Tensor | None) -> Any:
        found = _Jvp.apply(ctx.boundary, *ctx.saved_tensors, *tangents)
        return found if isinstance(found, tuple) else (found,)


@contextlib.contextmanager
def few_threads() -> Iterator[int]:
    """One thread for PyTorch's own operations; gives the number for the core.

    They are too small here for more: beside other programs threads that wait for each other take many times as long.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield threads
    finally:
        torch.set_num_threads(threads)


def _on_film(boundary: BoundaryCall, params: Sequence[torch.Tensor], threads: int) -> Radiance | Averages:
    return Radiance(boundary.call) if boundary.outputs is None else Averages(boundary.outputs, params, threads)


class _Vjp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, needed: tuple[bool, ...], count: int, *tensors: torch.Tensor | None) -> Any:
        call = boundary.call
        adjoints, params = tensors[:count], [t for t in tensors[count:] if t is not None]
        for adjoint in adjoints:
            refuse_batches(adjoint)
        call.check_indices()
        with few_threads() as threads:
            seen = _on_film(boundary, params, threads)
            placing = all_placing_slots(call.layout)
            grads = [zero_gradient(p) if needed[i] and i in placing else None for i, p in enumerate(params)]
            with outlines_of(boundary, params, seen.film, threads) as outlines:
                outlines.reverse(seen.adjoint(adjoints), grads)
        return tuple(grads)


class _Jvp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, *tensors: torch.Tensor | None) -> Any:
        call, count = boundary.call, len(tensors) // 2
        params, tangents = [t for t in tensors[:count] if t is not None], tensors[count:]
        with few_threads() as threads:
            seen = _on_film(boundary, params, threads)
            total = seen.film.empty()
            placing = all_placing_slots(call.layout)
            dense = dense_tangents(params, tangents, call.native.dtype)
            dense = [t.to("cpu") if t is not None and i in placing else None for i, t in enumerate(dense)]
            with outlines_of(boundary, params, seen.film, threads) as outlines:
                outlines.forward(total, dense)
            return seen.tangents(total)
