"""Which tensors of a scene stay where it lies, when that is the memory of the device that computes: large ones.

Their gradients are made there. Copies of their numbers are in the host's memory, too (host_memory.py), unless nothing
there reads them.
"""

from __future__ import annotations

from collections.abc import Iterator

from .declaration import models
from .packing import Layout

OWNERS = ("texture", "volume", "emitter", "attribute")
FEW = 64
"""Numbers that are not worth it, which are compared with their ranges together (ranges.py)."""


def staying(layout: Layout) -> dict[int, bool]:
    """Slots of texels, voxels, skies and colours of meshes, and whether devices alone read them.

    Those are texels of textures that BSDFs alone have: of lights and media the host makes tables.
    """
    if layout.staying is None:
        read = _read_on_the_host(layout)
        layout.staying = {
            slot: category == "texture" and row not in read
            for category in OWNERS
            for row, slot in _numbers(layout, category, "tensor")
        }
    return layout.staying


def _numbers(layout: Layout, category: str, kind: str) -> Iterator[tuple[int, int]]:
    """Of all fields of this kind the object's row and the number that it has."""
    for row, (model, numbers, _) in enumerate(layout.objects[category]):
        for field, number in zip(models()[category, model].fields, numbers, strict=True):
            if field.kind == kind and number >= 0:
                yield row, number


def _read_on_the_host(layout: Layout) -> set[int]:
    """Rows of textures that something else than a BSDF has, also by way of another texture."""
    read = {t for c in layout.objects if c not in ("bsdf", "texture") for _, t in _numbers(layout, c, "texture")}
    nested = list(_numbers(layout, "texture", "texture"))
    while more := {child for row, child in nested if row in read} - read:
        read |= more
    return read
