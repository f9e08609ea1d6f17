"""The derivative of one view's outlines, in both modes; see the package's docstring."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import torch

from ..autograd import dense_tangents, zero_gradient
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from .boundary_call import BoundaryCall, all_placing_slots
from .film_sums import FilmPlaces
from .outlines import outlines_of


class BoundaryFunction(UnbatchedFunction):
    """``image[, alpha] = BoundaryFunction.apply(boundary, *parameters)``: zeros, with the term as their derivative."""

    @staticmethod
    def forward(boundary: BoundaryCall, *params: torch.Tensor) -> Any:
        call = boundary.call
        image = torch.zeros(call.shape(), dtype=call.native.dtype)
        return (image, torch.zeros(call.size, dtype=call.native.dtype)) if call.alpha else image

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        boundary, *params = inputs
        ctx.boundary = boundary
        ctx.save_for_backward(*params)
        ctx.save_for_forward(*params)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if all(a is None for a in adjoints) or not any(needed):
            return (None,) * (1 + len(needed))
        image, alpha = (*adjoints, None)[:2]
        return (None, *_Vjp.apply(ctx.boundary, needed, image, alpha, *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _boundary: Any, *tangents: torch.Tensor | None) -> Any:
        found = _Jvp.apply(ctx.boundary, *ctx.saved_tensors, *tangents)
        return found if ctx.boundary.call.alpha else found[0]


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


class _Vjp(DerivativeFunction):
    @staticmethod
    def forward(
        boundary: BoundaryCall,
        needed: tuple[bool, ...],
        image: torch.Tensor | None,
        alpha: torch.Tensor | None,
        *params: torch.Tensor,
    ) -> Any:
        call = boundary.call
        for adjoint in (image, alpha):
            refuse_batches(adjoint)
        call.check_indices()
        with few_threads() as threads:
            film = FilmPlaces(call)
            adjoint = film.empty()
            if image is not None:
                film.add(adjoint, image.detach().reshape(-1, call.native.channels), slice(None, -1))
            if alpha is not None:
                film.add(adjoint, alpha.detach().reshape(-1, 1), slice(-1, None))
            adjoint /= film.normal
            placing = all_placing_slots(call.layout)
            grads = [zero_gradient(p) if needed[i] and i in placing else None for i, p in enumerate(params)]
            with outlines_of(boundary, params, film, threads) as outlines:
                outlines.reverse(adjoint, grads)
        return tuple(grads)


class _Jvp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, *tensors: torch.Tensor | None) -> Any:
        call, count = boundary.call, len(tensors) // 2
        params, tangents = [t for t in tensors[:count] if t is not None], tensors[count:]
        with few_threads() as threads:
            film = FilmPlaces(call)
            total = film.empty()
            dense = dense_tangents(params, tangents, call.native.dtype)
            placing = all_placing_slots(call.layout)
            dense = [t if i in placing else None for i, t in enumerate(dense)]
            with outlines_of(boundary, params, film, threads) as outlines:
                outlines.forward(total, dense)
            total /= film.normal
            values = film.results(total)
        image = values[:, :-1].reshape(call.shape()).to(call.native.dtype)
        return image, values[:, -1].reshape(call.size).to(call.native.dtype)
