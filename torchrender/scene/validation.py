"""Checks of values against the ranges that the native core declares for its fields."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from .context import Context
from .declaration import Field

if TYPE_CHECKING:
    from .plugin import Plugin


def check_fields(plugin: Plugin, ctx: Context) -> None:
    """`check_range` for all values of an object: its own parameters, and what its textures and volumes can be."""
    for path, tensor, field in values_of(plugin):
        # Images may go too far here and there; a medium of negative density has no tracking at all.
        fatal = tensor.ndim <= 1 or field.kind == "volume"
        check_range(tensor, field, replace(ctx, path=(*ctx.path, *path)), constant=fatal)


def values_of(plugin: Plugin) -> Iterator[tuple[tuple[str, ...], torch.Tensor, Field]]:
    """What fields of an object take their values from, with the path to it: own parameters, texels and voxels."""
    for name, field in plugin.fields().items():
        if plugin._holds(field):
            tensor = plugin._parameters.get(name)
            if tensor is not None:
                yield (name,), tensor, field
        elif field.kind in ("texture", "spectrum", "volume"):
            child = plugin._child(name)
            if child is not None:
                yield from (((name, leaf), tensor, field) for leaf, tensor in child.texels())


def check_range(tensor: torch.Tensor, field: Field, ctx: Context, constant: bool) -> None:
    """ValueError for values that are not finite, or, for constants, out of the field's range; a warning for images."""
    with torch.no_grad():
        low, high = torch.aminmax(tensor) if tensor.numel() else (torch.zeros(()), torch.zeros(()))
    low, high = float(low), float(high)
    if not (abs(low) < float("inf") and abs(high) < float("inf")):
        ctx.error("has values that are not finite")
    minimum = -float("inf") if field.min is None else field.min
    maximum = float("inf") if field.max is None else field.max
    if field.kind == "vector" and float(tensor.detach().norm()) > maximum + 1e-6:  # of vectors it bounds the length
        ctx.error(f"expected a vector of length {maximum:g} at most, got {tensor.tolist()}")
    slack = 0.0 if field.kind == "volume" else 1e-6 * max(1.0, abs(maximum) if maximum < float("inf") else 1.0)
    if low >= minimum and high <= maximum + slack:
        return
    value = low if low < minimum else high
    text = f"{value:.6g} is outside the range [{minimum:g}, {maximum:g}] of {field.name}"
    if constant:
        ctx.error(text)
    warnings.warn(f"{ctx.where}: {text}", stacklevel=2)
