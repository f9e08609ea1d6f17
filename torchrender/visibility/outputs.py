"""What the motion of outlines adds to outputs besides radiance: csrc/cpu/boundary_outputs.h.

An output is an average O = N / D over the samples that hit something, so its derivative is (dN - O dD) / D: of sums of
values, and of what is covered.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ..autograd import dense_tangents, zero_gradient
from ..first_hit_call import FirstHitCall
from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches
from .boundary import few_threads
from .boundary_call import BoundaryCall, all_placing_slots, boundary_of
from .film_sums import FilmPlaces
from .outlines import outlines_of


def add_outlines(found: dict[str, torch.Tensor], first: FirstHitCall, params: Sequence[torch.Tensor]) -> None:
    """Adds the term to outputs by name, if something that moves outlines may be differentiated."""
    names = list(first.core_names().values())
    boundary = boundary_of(first.render, params, first) if names else None
    if boundary is None:
        return
    for name, term in zip(names, OutputsFunction.apply(boundary, *params), strict=True):
        found[name] = found[name] + term


class OutputsFunction(UnbatchedFunction):
    """Zeros for each of the outputs, in the core's order, with the term as their derivative."""

    @staticmethod
    def forward(boundary: BoundaryCall, *params: torch.Tensor) -> Any:
        first = _first(boundary)
        return tuple(torch.zeros_like(first.empty(name)) for name in first.core_names().values())

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
        return (None, *_Vjp.apply(ctx.boundary, needed, *adjoints, *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _boundary: Any, *tangents: torch.Tensor | None) -> Any:
        found = _Jvp.apply(ctx.boundary, *ctx.saved_tensors, *tangents)
        return found if isinstance(found, tuple) else (found,)


def _first(boundary: BoundaryCall) -> FirstHitCall:
    assert boundary.outputs is not None
    return boundary.outputs


class _Averages:
    """The averages that the term is the derivative of, over the derivative's samples, and the film that it is on."""

    def __init__(self, first: FirstHitCall, params: Sequence[torch.Tensor]) -> None:
        call, self.first = first.render, first
        self.names = list(first.core_names().values())
        real = {name: first.empty(name) for name in self.names}
        covered = torch.empty(call.size, dtype=call.native.dtype)
        addresses = {**first.addresses(real), "covered": covered.data_ptr()}
        call.native.call("render_aov", list(params), first.config(True), addresses)
        pixels = covered.numel()
        self.sizes = [t.numel() // pixels if pixels else 1 for t in real.values()]
        self.film = FilmPlaces(call, sum(self.sizes) + 1, not first.zero_at_misses)
        self.covered = covered.reshape(-1, 1).double()
        if first.zero_at_misses:  # all samples count, wherever things are
            self.covered = torch.ones_like(self.covered)
        flat = torch.cat([t.reshape(pixels, size) for t, size in zip(real.values(), self.sizes, strict=True)], 1)
        self.value = torch.where(self.covered > 0, flat.double(), 0.0)
        if first.zero_at_misses:
            self.value = torch.zeros_like(self.value)

    def adjoint(self, adjoints: Sequence[torch.Tensor | None]) -> torch.Tensor:
        """Of the film's sums, for those of the outputs."""
        rows = len(self.value)
        wanted = torch.cat(
            [
                self.value.new_zeros(rows, size) if a is None else a.detach().double().reshape(rows, size)
                for a, size in zip(adjoints, self.sizes, strict=True)
            ],
            1,
        )
        of_cover = -(wanted * self.value).sum(1, keepdim=True)
        columns = torch.where(self.covered > 0, torch.cat([wanted, of_cover], 1) / self.covered, 0.0)
        film = self.film.empty()
        self.film.add(film, columns, slice(None))
        return film / self.film.normal

    def tangents(self, total: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Those of the outputs, for those of the film's sums."""
        found = self.film.results(total / self.film.normal)
        change = found[:, :-1] - self.value * found[:, -1:]
        change = torch.where(self.covered > 0, change / self.covered, 0.0).split(self.sizes, 1)
        to = [self.first.empty(name) for name in self.names]
        return tuple(part.reshape(t.shape).to(t.dtype) for part, t in zip(change, to, strict=True))


class _Vjp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, needed: tuple[bool, ...], *tensors: torch.Tensor | None) -> Any:
        call, first = boundary.call, _first(boundary)
        count = len(first.core_names())
        adjoints, params = tensors[:count], [t for t in tensors[count:] if t is not None]
        for adjoint in adjoints:
            refuse_batches(adjoint)
        call.check_indices()
        averages = _Averages(first, params)
        with few_threads() as threads:
            placing = all_placing_slots(call.layout)
            grads = [zero_gradient(p) if needed[i] and i in placing else None for i, p in enumerate(params)]
            with outlines_of(boundary, params, averages.film, threads) as outlines:
                outlines.reverse(averages.adjoint(adjoints), grads)
        return tuple(grads)


class _Jvp(DerivativeFunction):
    @staticmethod
    def forward(boundary: BoundaryCall, *tensors: torch.Tensor | None) -> Any:
        call, count = boundary.call, len(tensors) // 2
        params, tangents = [t for t in tensors[:count] if t is not None], tensors[count:]
        averages = _Averages(_first(boundary), params)
        with few_threads() as threads:
            total = averages.film.empty()
            dense = dense_tangents(params, tangents, call.native.dtype)
            placing = all_placing_slots(call.layout)
            dense = [t if i in placing else None for i, t in enumerate(dense)]
            with outlines_of(boundary, params, averages.film, threads) as outlines:
                outlines.forward(total, dense)
        return averages.tangents(total)
