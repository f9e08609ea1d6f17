"""From what people write for a declared field to what an object holds: tensors, words, numbers and booleans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from . import spectra, values
from .context import Context
from .declaration import Field

BOOLEANS = frozenset("flip_normals face_normals per_face nonlinear flip_invalid_normals use_shadowing_function".split())
ENUMERATIONS: dict[str, tuple[str, ...]] = {
    "filter_type": ("bilinear", "nearest"),
    "wrap_mode": ("repeat", "mirror", "clamp"),
    "distribution": ("beckmann", "ggx"),
}
"""Fields that are integers natively and words here, by name; the position of a word is its integer."""


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


def static_value(name: str, value: Any, enumerations: Mapping[str, Sequence[str]], ctx: Context) -> bool | str | int:
    """The value of a static field, checked."""
    if name in BOOLEANS:
        return values.boolean(value, ctx)
    if name in enumerations:
        return enumerations[name][values.choice(value, enumerations[name], ctx)]
    return values.integer(value, ctx)


def encode(name: str, value: Any, enumerations: Mapping[str, Sequence[str]]) -> int:
    """The value of a static field as the integer that the core takes."""
    return enumerations[name].index(value) if name in enumerations else int(value)


def decode(name: str, number: int, enumerations: Mapping[str, Sequence[str]]) -> bool | str | int:
    """The reverse."""
    if name in BOOLEANS:
        return bool(number)
    return enumerations[name][number] if name in enumerations else number
