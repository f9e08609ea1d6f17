"""Sums and gathers over the processes of a group, with their derivatives in both modes.

Parameters and images are replicated: every process has them. Parameters enter what is shared by `Replicate`, the
identity whose adjoint is a sum, and images leave it by a sum whose adjoint is the identity, so that every process has
the whole image and the whole gradient (the pair f and g of Shoeybi et al., "Megatron-LM", 2019, section 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
import torch.distributed as dist

from ..functions import DerivativeFunction, UnbatchedFunction
from ..scene.gather import has_derivative
from ..scene.values import has_tangent

plain = torch._C._DisableFuncTorch


class Group:
    """The processes that share a rendering, and what they send each other.

    Attributes:
        rank, size: number of this process among them, and how many they are.
        statistics: ``"collectives"`` and ``"bytes"`` that this process has put into them.
    """

    def __init__(self, group: dist.ProcessGroup) -> None:
        self.group = group
        self.rank, self.size = dist.get_rank(group), dist.get_world_size(group)
        self.statistics = {"collectives": 0, "bytes": 0}

    def _count(self, buffer: torch.Tensor) -> None:
        self.statistics["collectives"] += 1
        self.statistics["bytes"] += buffer.nbytes

    def sum(self, tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """The sums over all processes of tensors that are replaced: one collective operation a dtype."""
        found: list[torch.Tensor] = [torch.empty(0)] * len(tensors)
        for places, packed in _packed(tensors):
            if self.size > 1 and packed.numel():
                self._count(packed)
                dist.all_reduce(packed, group=self.group)
            for place, part in zip(places, packed.split([tensors[i].numel() for i in places]), strict=True):
                found[place] = part.view(tensors[place].shape)
        return found

    def rows(self, tensors: Sequence[torch.Tensor], to: int | None) -> list[list[torch.Tensor]] | None:
        """The tensors of every process in order, which have equal shapes; for `to` alone, None for others."""
        found = [list(tensors) for _ in range(self.size)]
        for places, packed in _packed(tensors):
            self._count(packed)
            parts = [torch.empty_like(packed) for _ in range(self.size)]
            if to is None:
                dist.all_gather(parts, packed, group=self.group)
            else:
                destination = dist.get_global_rank(self.group, to)
                dist.gather(packed, parts if self.rank == to else None, destination, group=self.group)
            for own, part in zip(found, parts, strict=True):
                pieces = part.split([tensors[i].numel() for i in places])
                for place, piece in zip(places, pieces, strict=True):
                    own[place] = piece.view(tensors[place].shape)
        return found if to in (None, self.rank) else None

    def numbers(self, own: Sequence[int]) -> list[list[int]]:
        """Whole numbers of 64 bits of every process in order."""
        mine = torch.tensor(own, dtype=torch.int64)
        found = [torch.empty_like(mine) for _ in range(self.size)]
        self._count(mine)
        dist.all_gather(found, mine, group=self.group)
        return [numbers.tolist() for numbers in found]


def _packed(tensors: Sequence[torch.Tensor]) -> list[tuple[list[int], torch.Tensor]]:
    """Copies in one row for each dtype, with the numbers of the tensors that it has."""
    by_dtype: dict[torch.dtype, list[int]] = {}
    for i, tensor in enumerate(tensors):
        by_dtype.setdefault(tensor.dtype, []).append(i)
    return [(places, torch.cat([tensors[i].detach().reshape(-1) for i in places])) for places in by_dtype.values()]


def by_derivative(
    tensors: Sequence[torch.Tensor],
    function: Callable[[Sequence[torch.Tensor], tuple[bool, bool]], Sequence[torch.Tensor]],
) -> list[torch.Tensor]:
    """What a function makes of those tensors that have a derivative, of those that have a tangent, too, and of others.

    Results of an autograd function all have a derivative if one of its inputs has, and all of its inputs have a tangent
    if one has. The function is told what the tensors have.
    """
    has = [(has_derivative(tensor), has_tangent(tensor)) for tensor in tensors]
    found = list(tensors)
    for known in sorted(set(has)):
        places = [i for i, own in enumerate(has) if own == known]
        for place, result in zip(places, function([tensors[i] for i in places], known), strict=True):
            found[place] = result
    return found


class SumFunction(DerivativeFunction):
    """``sums = SumFunction.apply(group, *tensors)``, where None stays None; without a derivative."""

    @staticmethod
    def forward(group: Group, *tensors: torch.Tensor | None) -> Any:
        sums = iter(group.sum([t for t in tensors if t is not None]))
        return tuple(None if t is None else next(sums) for t in tensors)


class Replicate(UnbatchedFunction):
    """``tensors = Replicate.apply(group, *tensors)``: as they are; gradients are summed over all processes."""

    @staticmethod
    def forward(group: Group, *tensors: torch.Tensor) -> Any:
        return tensors

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.group = inputs[0]

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> Any:  # zeros where this process has none: others may have some
        return (None, *SumFunction.apply(ctx.group, *grads))

    @staticmethod
    def jvp(ctx: Any, _group: Any, *tangents: torch.Tensor | None) -> Any:
        return tuple(t if t is None else t.view_as(t) for t in tangents)


class Attach(UnbatchedFunction):
    """``values = Attach.apply(count, *values, *parameters)``: `count` values, with derivatives that are zero."""

    @staticmethod
    def forward(count: int, *tensors: torch.Tensor) -> Any:
        return tuple(tensor.view_as(tensor) for tensor in tensors[:count])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.parameters = len(inputs) - 1 - int(inputs[0])
        ctx.zeros = [torch.zeros_like(value) for value in output]

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> Any:
        return (None, *grads, *(None,) * ctx.parameters)

    @staticmethod
    def jvp(ctx: Any, *_: Any) -> Any:
        return tuple(ctx.zeros)


class Total(UnbatchedFunction):
    """``totals = Total.apply(group, ratios, zero, *values)``: sums of values times what ``ratios(derivative)`` gives.

    That has one factor for each value, a number or a tensor. With `zero` values are zeros, which nobody sends.
    """

    @staticmethod
    def forward(group: Group, ratios: Callable[[bool], list[Any]], zero: bool, *values: torch.Tensor) -> Any:
        if zero:
            return tuple(value.clone() for value in values)
        return tuple(group.sum([times(v, f) for v, f in zip(values, ratios(False), strict=True)]))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.group, ctx.ratios = inputs[:2]
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor | None) -> Any:
        if all(g is None for g in grads):
            return (None,) * (3 + len(grads))
        with plain():
            factors = ctx.ratios(True)
        return (None, None, None, *(None if g is None else g * f for g, f in zip(grads, factors, strict=True)))

    @staticmethod
    def jvp(ctx: Any, _group: Any, _ratios: Any, _zero: Any, *tangents: torch.Tensor | None) -> Any:
        with plain():
            factors = ctx.ratios(True)
        own = (None if t is None else times(t, f) for t, f in zip(tangents, factors, strict=True))
        return SumFunction.apply(ctx.group, *own)


def times(value: torch.Tensor, factor: Any) -> torch.Tensor:
    """The product; zero where the factor is, also of what is infinite there."""
    if not isinstance(factor, torch.Tensor):
        return value * factor if factor else torch.zeros_like(value)
    return torch.where(factor == 0, 0.0, value * factor)


class Gather(UnbatchedFunction):
    """``wholes = Gather.apply(group, places, count, to, *bands)``: bands of rows of all processes, one below the other.

    `places` are the first row of this process' band and the row after its last one, in wholes of `count` rows; a band
    without rows comes with one that does not count. Other processes than `to` have what they brought.
    """

    @staticmethod
    def forward(group: Group, places: tuple[int, int], count: int, to: int | None, *bands: torch.Tensor) -> Any:
        begin, end = places
        height = -(-count // group.size)
        padded = [band.new_zeros((height, *band.shape[1:])) for band in bands]
        for whole, band in zip(padded, bands, strict=True):
            whole[: end - begin] = band[: end - begin]
        found = group.rows(padded, to)
        if found is None:
            return tuple(band.clone() for band in bands)
        return tuple(torch.cat(parts)[:count] for parts in zip(*found, strict=True))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.group, ctx.places, ctx.count, ctx.to, *bands = inputs
        ctx.rows = [len(band) for band in bands]

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> Any:
        begin, end = ctx.places
        own = (
            grad[begin:end] if begin < end else grad.new_zeros((rows, *grad.shape[1:]))
            for grad, rows in zip(grads, ctx.rows, strict=True)
        )
        return (None, None, None, None, *own)

    @staticmethod
    def jvp(ctx: Any, _group: Any, _places: Any, _count: Any, _to: Any, *tangents: torch.Tensor | None) -> Any:
        given = [t for t in tangents if t is not None]
        found = iter(GatherTangents.apply(ctx.group, ctx.places, ctx.count, ctx.to, *given) if given else ())
        return tuple(None if t is None else next(found) for t in tangents)


class GatherTangents(DerivativeFunction):
    """The same of tangents."""

    forward = Gather.forward
