"""What the core bends light by, from an index of refraction, and its derivative: in few passes over large grids."""

from __future__ import annotations

from typing import Any

import torch

from ..functions import DerivativeFunction, UnbatchedFunction, refuse_batches

PADDING = 2  # voxels beyond every border, see csrc/core/medium/bend.h
_SLICES = 16  # at a time


def bending_field(index: torch.Tensor, base: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    """What the core bends light by, (Z + 4, Y + 4, X + 4): n^2 / 2 of the control values but for a constant.

    Those at the border once more behind it. The constant is that of an index near all others, so that differences stay
    as small as they are given.
    """
    return _BendingField.apply(reference_index(base), index, base, scale)


def reference_index(base: torch.Tensor) -> float:
    """The index of refraction whose half square is that constant."""
    number = float(base.detach())
    return number if number > 0 else 1.0


class _BendingField(UnbatchedFunction):
    @staticmethod
    def forward(reference: float, index: torch.Tensor, base: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
        padded = index.new_empty([n + 2 * PADDING for n in index.shape])
        for given, inner in _slabs(index, _inside(padded)):
            difference = _difference(reference, given, base, scale)
            torch.mul(difference, difference / 2 + reference, out=inner)
        return _pad(padded)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.reference, *tensors = inputs
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Any:
        needed = ctx.needs_input_grad[1:]
        if adjoints[0] is None or not any(needed):
            return (None,) * 4
        return (None, *_Reverse.apply(ctx.reference, needed, adjoints[0], *ctx.saved_tensors))

    @staticmethod
    def jvp(ctx: Any, _reference: Any, *tangents: torch.Tensor | None) -> Any:
        return _Forward.apply(ctx.reference, *tangents, *ctx.saved_tensors)


class _Reverse(DerivativeFunction):
    @staticmethod
    def forward(
        reference: float,
        needed: tuple[bool, ...],
        adjoint: torch.Tensor,
        index: torch.Tensor,
        base: torch.Tensor,
        scale: torch.Tensor,
    ) -> Any:
        refuse_batches(adjoint)
        index_bar = torch.empty_like(index) if needed[0] else None
        base_bar, scale_bar = torch.zeros_like(base, dtype=torch.float64), torch.zeros_like(scale, dtype=torch.float64)
        for k in range(0, len(index), _SLICES):
            given = index[k : k + _SLICES]
            difference = _difference(reference, given, base, scale)
            bar = _folded(adjoint, k, len(given))
            bar = bar * (difference / 2 + reference) + bar * difference / 2
            if index_bar is not None:
                torch.mul(bar, scale, out=index_bar[k : k + _SLICES])
            if needed[1] or needed[2]:
                base_bar += bar.sum(dtype=torch.float64)
                scale_bar += (bar * given).sum(dtype=torch.float64)
        sums = (base_bar.to(base.dtype) if needed[1] else None, scale_bar.to(scale.dtype) if needed[2] else None)
        return index_bar, *sums


class _Forward(DerivativeFunction):
    @staticmethod
    def forward(reference: float, *tensors: torch.Tensor | None) -> torch.Tensor:
        d_index, d_base, d_scale, *primals = tensors
        index, base, scale = (t for t in primals if t is not None)
        padded = index.new_empty([n + 2 * PADDING for n in index.shape])
        changes = torch.zeros_like(index) if d_index is None else d_index.expand_as(index)
        for given, change, inner in _slabs(index, changes, _inside(padded)):
            change = change * scale
            if d_base is not None:
                change = change + d_base
            if d_scale is not None:
                change = change + given * d_scale
            torch.mul(change, _difference(reference, given, base, scale) + reference, out=inner)
        return _pad(padded)


def _slabs(*grids: torch.Tensor) -> Any:
    return zip(*(grid.split(_SLICES) for grid in grids), strict=True)


def _inside(padded: torch.Tensor) -> torch.Tensor:
    for axis in range(3):
        padded = padded.narrow(axis, PADDING, padded.shape[axis] - 2 * PADDING)
    return padded


def _difference(reference: float, index: torch.Tensor, base: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
    return (base - reference) + scale * index


def _pad(padded: torch.Tensor) -> torch.Tensor:
    """Fills what is beyond the borders, in place."""
    whole = padded
    for axis in (2, 1, 0):
        for other in range(axis):
            padded = padded.narrow(other, PADDING, whole.shape[other] - 2 * PADDING)
        end = whole.shape[axis] - PADDING
        padded.narrow(axis, 0, PADDING).copy_(padded.narrow(axis, PADDING, 1))
        padded.narrow(axis, end, PADDING).copy_(padded.narrow(axis, end - 1, 1))
        padded = whole
    return whole


def _folded(adjoint: torch.Tensor, begin: int, count: int) -> torch.Tensor:
    """Of the slices from `begin` on the adjoints of values (count, Y, X), from those of padded ones."""
    depth = adjoint.shape[0] - 2 * PADDING
    slab = adjoint[PADDING + begin : PADDING + begin + count].clone()
    if begin == 0:
        slab[0] += adjoint[:PADDING].sum(0)
    if begin + count == depth:
        slab[-1] += adjoint[-PADDING:].sum(0)
    for axis in (1, 2):
        n = slab.shape[axis]
        inner = slab.narrow(axis, PADDING, n - 2 * PADDING)
        inner.narrow(axis, 0, 1).add_(slab.narrow(axis, 0, PADDING).sum(axis, keepdim=True))
        inner.narrow(axis, -1, 1).add_(slab.narrow(axis, n - PADDING, PADDING).sum(axis, keepdim=True))
        slab = inner
    return slab
