"""The native core's declaration of its models, as Python objects.

The core says once which models exist and which fields they have; classes, packing, names and checks are made from that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from .. import backends

CHILD_KINDS = ("bsdf", "emitter", "shape", "medium", "volume", "phase")
TENSOR_KINDS = ("spectrum", "float", "point", "vector", "transform", "transform2", "tensor")


@dataclass(frozen=True)
class Field:
    """One declared field of a model; see the native registry for the meaning of `kind`."""

    name: str
    kind: str
    default: float | None
    min: float | None
    max: float | None
    derivative: str
    doc: str
    choices: tuple[str, ...] | None = None  # of an "int": words for its values, from 0 on
    optional: bool = False  # absent unless given: the default applies natively
    scalar: bool = False  # of a "texture": its luminance counts
    traits: frozenset[str] = frozenset()  # flags of the model that hold only where this field is given

    @property
    def differentiable(self) -> bool:
        return self.derivative not in ("none", "")

    @property
    def boolean(self) -> bool:
        return self.choices == ("false", "true")


@dataclass(frozen=True)
class Model:
    """One declared model: a category, a type name, and its fields in packing order."""

    category: str
    type: str
    doc: str
    fields: tuple[Field, ...]
    flags: frozenset[str] = frozenset()
    class_name: str | None = None  # where that is not the type in capitals


def _number(value: float | None) -> float | None:
    """The core writes "none" as NaN."""
    return None if value is None or math.isnan(value) else float(value)


@lru_cache(maxsize=1)
def models() -> dict[tuple[str, str], Model]:
    """All models of the native core, by (category, type), in the core's order."""
    found = {}
    for entry in backends.core().models():
        fields = tuple(
            Field(
                name=f["name"],
                kind=f["kind"],
                default=_number(f.get("default")),
                min=_number(f.get("min")),
                max=_number(f.get("max")),
                derivative=f.get("derivative") or "none",
                doc=f.get("doc", ""),
                choices=None if f["choices"] is None else tuple(f["choices"]),
                optional=f["optional"],
                scalar=f["scalar"],
                traits=frozenset(f["traits"]),
            )
            for f in entry["fields"]
        )
        category, kind = entry["category"], entry["type"]
        flags = frozenset(entry["flags"])
        found[category, kind] = Model(category, kind, entry.get("doc", ""), fields, flags, entry["class_name"])
    return found


def categories() -> dict[str, list[str]]:
    """Type names by category, in the core's order."""
    found: dict[str, list[str]] = {}
    for category, kind in models():
        found.setdefault(category, []).append(kind)
    return found
