"""From what people write for a declared field to what an object holds: tensors, words, numbers and booleans."""

from __future__ import annotations

from typing import Any

import torch

from . import spectra, values
from .context import Context
from .declaration import Field


def tensor_of(field: Field, value: Any, ctx: Context) -> torch.Tensor:
    """`value` as a tensor of the field's shape; any shape where the kind of field has none."""
    if field.kind == "spectrum":
        return spectra.spectrum(value, ctx)
    if field.kind == "float":
        return values.number(value, ctx)
    if field.kind in ("point", "vector"):
        return values.vector(value, ctx)
    if field.kind == "transform":
        return values.matrix(value, 4, ctx)
    if field.kind == "transform2":
        return values.matrix(value, 3, ctx)
    return values.floating(value, ctx).contiguous()


def static_value(field: Field, value: Any, ctx: Context) -> bool | str | int:
    """The value of a static field, checked."""
    if field.boolean:
        return values.boolean(value, ctx)
    if field.choices:
        return field.choices[values.choice(value, field.choices, ctx)]
    return values.integer(value, ctx)


def encode(field: Field, value: Any) -> int:
    """The value of a static field as the integer that the core takes: the position of a word among the choices."""
    return field.choices.index(value) if field.choices and not field.boolean else int(value)


def decode(field: Field, number: int) -> bool | str | int:
    """The reverse."""
    if field.boolean:
        return bool(number)
    return field.choices[number] if field.choices else number
