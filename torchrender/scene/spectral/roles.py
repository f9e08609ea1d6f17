"""What the colours of a packed scene stand for, which decides the spectra that they become."""

from __future__ import annotations

from collections.abc import Iterator

from ..declaration import Field, models
from ..packing import Layout, Record, record, records

BOUNDED = "bounded"  # a factor such as a reflectance, which is at most 1
UNBOUNDED = "unbounded"  # a factor such as an index of refraction
LIGHT = "light"  # radiance, which the core has relative to daylight
NUMBER = "number"  # the luminance counts
VECTOR = "vector"  # three numbers that are no colour

_NAMES = {
    BOUNDED: "a reflectance or another factor of at most 1",
    UNBOUNDED: "a factor without limits",
    LIGHT: "light",
    NUMBER: "a plain number",
    VECTOR: "a map of normals",
}


def roles_of(layout: Layout) -> list[str | None]:
    """By slot one of these, or None for what is no colour; ValueError for one that is used as two of them."""
    if layout.roles is None:
        layout.roles = _find(layout)
    return layout.roles


def _find(layout: Layout) -> list[str | None]:
    found: list[str | None] = [None] * len(layout.slots)
    places = [""] * len(layout.slots)

    def give(slot: int, role: str, where: str) -> None:
        if slot < 0:
            return
        if found[slot] not in (None, role):
            raise ValueError(
                f"{layout.slots[slot].name}: in a spectral scene one colour cannot stand for {_NAMES[role]} "
                f"(in {where}) and for {_NAMES[str(found[slot])]} (in {places[slot]}); give each place one of its own"
            )
        found[slot], places[slot] = role, where

    def give_texture(row: int, role: str, where: str) -> None:
        texture = record(layout, "texture", row)
        for name, number in texture.field.items():
            kind = _field(texture, "texture", name).kind
            if kind in ("spectrum", "tensor"):
                give(number, role, where)
            elif kind == "texture" and number >= 0:
                give_texture(number, role, where)
            elif kind == "volume" and number >= 0:
                give_volume(number, role, where)
        if texture.type == "mesh_attribute":
            for attribute in records(layout, "attribute"):
                if attribute.field["name"] == texture.field["name"]:
                    give(attribute.field["data"], role, where)

    def give_volume(row: int, role: str, where: str) -> None:
        volume = record(layout, "volume", row)
        for name, number in volume.field.items():
            if _field(volume, "volume", name).kind in ("spectrum", "tensor"):
                give(number, role, where)

    for category in ("bsdf", "emitter", "medium", "phase"):
        for owner, name, field, number in _fields(layout, category):
            role, where = _role(category, owner, field), f"{owner.path}.{name}"
            if number < 0 or not role:
                continue
            if field.kind in ("spectrum", "tensor"):
                give(number, role, where)
            elif field.kind == "texture":
                give_texture(number, role, where)
            elif field.kind == "volume":
                give_volume(number, role, where)
    # what nothing refers to, and colours of meshes that are outputs alone
    for category in ("texture", "volume", "attribute"):
        for owner, name, field, number in _fields(layout, category):
            if number >= 0 and field.kind in ("spectrum", "tensor") and found[number] is None:
                give(number, BOUNDED, f"{owner.path}.{name}")
    return found


def _fields(layout: Layout, category: str) -> Iterator[tuple[Record, str, Field, int]]:
    for owner in records(layout, category):
        if owner.type == "torch":
            continue
        for name, number in owner.field.items():
            yield owner, name, _field(owner, category, name), number


def _field(owner: Record, category: str, name: str) -> Field:
    return next(f for f in models()[category, owner.type].fields if f.name == name)


def _role(category: str, owner: Record, field: Field) -> str | None:
    if owner.type == "normalmap" and field.kind == "texture":
        return VECTOR
    if category == "medium":
        roles = {"albedo": BOUNDED, "emission": LIGHT, "sigma_t": UNBOUNDED}
        return roles.get(field.name)
    if category == "phase":
        return NUMBER if field.kind == "volume" else None
    if field.scalar:
        return NUMBER
    if category == "emitter" and (owner.type, field.name) != ("spot", "texture"):
        return LIGHT
    return BOUNDED if field.max == 1 else UNBOUNDED
