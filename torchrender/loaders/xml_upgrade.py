"""Brings scene files of Mitsuba 0.x (written before version 2.0) to today's names, in place.

Facts: Mitsuba 2's documentation, "Scene format": property names changed from camelCase to under_scores, and the
texture parameters uscale, vscale, uoffset and voffset became a `to_uv` transform. The manual of 0.6: filters of bitmaps
were "ewa", "trilinear" and "nearest", black bodies had a tag and films of 8 bits a type of their own, as
had sky and sun, in whose frame +y was up; in 0.3 sensors were called cameras and emitters luminaires.
"""

from __future__ import annotations

import re

from .xml_tree import Element

_UV = ("uscale", "vscale", "uoffset", "voffset")
_TAGS = {"lookAt": "lookat", "camera": "sensor", "luminaire": "emitter"}
_NAMED = ("integer", "float", "boolean", "string", "point", "vector", "rgb", "spectrum", "srgb", "transform", "texture")
_NAMED += ("volume", "medium", "phase")


def snake_case(name: str) -> str:
    """``toWorld`` -> ``to_world``, ``intIOR`` -> ``int_ior``, ``rrDepth`` -> ``rr_depth``."""
    name = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    return re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1_\2", name).lower()


def upgrade(element: Element) -> None:
    """Rewrite `element` and everything in it."""
    element.tag = _TAGS.get(element.tag, element.tag)
    if element.attributes.get("type") == "ldrfilm" and element.tag == "film":
        element.attributes["type"] = "hdrfilm"
    if element.tag == "blackbody":
        _upgrade_blackbody(element)
    if "name" in element.attributes and (element.tag in _NAMED or element.tag == "ref"):
        element.attributes["name"] = snake_case(element.attributes["name"])
    if element.tag == "texture":
        _upgrade_uv(element)
    if element.attributes.get("name") == "filter_type" and element.attributes.get("value") in ("ewa", "trilinear"):
        element.attributes["value"] = "bilinear"
    if element.tag == "spectrum" and _is_triple(element.attributes.get("value", "")):
        element.tag = "rgb"
    for child in element.children:
        upgrade(child)
    if element.tag == "emitter" and element.attributes.get("type") in ("sunsky", "sky", "sun"):
        _upgrade_sky(element)


def _upgrade_sky(emitter: Element) -> None:
    """One type for three, in whose frame +z is up and not +y."""
    kind, place = emitter.attributes["type"], (emitter.file, emitter.line)
    emitter.attributes["type"] = "sunsky"
    if kind != "sunsky":
        ours, other = ("sky_scale", "sun_scale") if kind == "sky" else ("sun_scale", "sky_scale")
        for child in emitter.children:
            if child.attributes.get("name") == "scale":
                child.attributes["name"] = ours
        emitter.children.append(Element("float", {"name": other, "value": "0"}, *place))
    transforms = [c for c in emitter.children if c.attributes.get("name") == "to_world"]
    if not transforms:
        transforms = [Element("transform", {"name": "to_world"}, *place)]
        emitter.children += transforms
    transforms[0].children.insert(0, Element("rotate", {"x": "1", "angle": "-90"}, *place))


def _is_triple(text: str) -> bool:
    return ":" not in text and len(text.replace(",", " ").split()) == 3


def _upgrade_blackbody(element: Element) -> None:
    """``<blackbody temperature="5000K">`` as a spectrum of that type. Its factor `scale` has no counterpart today."""
    given = element.attributes
    if given.get("scale", "1") not in ("1", "1.0"):
        raise element.error("scale: a black body's spectrum has no factor any more; give an rgb value in its place")
    element.tag = "spectrum"
    kelvin = given.pop("temperature", "").strip().rstrip("kK")
    given.pop("scale", None)
    given["type"] = "blackbody"
    child = Element("float", {"name": "temperature", "value": kelvin}, element.file, element.line)
    element.children.append(child)


def _upgrade_uv(texture: Element) -> None:
    given = {c.attributes.get("name"): c for c in texture.children if c.tag == "float"}
    given = {name: child for name, child in given.items() if name in _UV}
    if not given:
        return
    texture.children = [c for c in texture.children if not any(c is used for used in given.values())]
    value = {name: child.attributes.get("value", "") for name, child in given.items()}
    first = next(iter(given.values()))

    def step(tag: str, x: str, y: str) -> Element:
        return Element(tag, {"x": x, "y": y}, first.file, first.line)

    transform = Element("transform", {"name": "to_uv"}, first.file, first.line)
    transform.children = [
        step("scale", value.get("uscale", "1"), value.get("vscale", "1")),
        step("translate", value.get("uoffset", "0"), value.get("voffset", "0")),
    ]
    texture.children.append(transform)
