"""The values that elements of a scene file spell: numbers, colours, vectors, transforms."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

from ..errors import nearest
from ..image import srgb_to_linear
from ..transform import Transform
from .xml_tree import Element


def check_attributes(element: Element, required: Iterable[str], optional: Iterable[str] = ()) -> None:
    """Raise unless the element has all required attributes and none but the listed ones."""
    required, known = set(required), {*required, *optional}
    for name in element.attributes:
        if name not in known:
            raise element.error(f"unexpected attribute {name!r}; {nearest(name, known)}")
    for name in sorted(required - set(element.attributes)):
        raise element.error(f"the attribute {name!r} is missing")


def no_children(element: Element) -> None:
    """Raise if the element holds others."""
    for child in element.children:
        raise child.error(f"unexpected inside <{element.tag}>")


def number(element: Element, attribute: str) -> float:
    """The attribute as a float."""
    text = element.attributes[attribute]
    try:
        return float(text)
    except ValueError:
        raise element.error(f"{attribute}: expected a number, got {text!r}") from None


def numbers(element: Element, attribute: str, counts: tuple[int, ...]) -> list[float]:
    """The attribute as a list of floats, separated by commas or spaces; its length is one of `counts`."""
    text = element.attributes[attribute]
    try:
        values = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        values = None
    if values is None or len(values) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise element.error(f"{attribute}: expected {wanted} number{'s' if counts != (1,) else ''}, got {text!r}")
    return values


def integer(element: Element) -> int:
    """The value of ``<integer value="...">``."""
    text = element.attributes["value"]
    try:
        return int(text)
    except ValueError:
        raise element.error(f"value: expected an integer, got {text!r}") from None


def boolean(element: Element) -> bool:
    """The value of ``<boolean value="true|false">``."""
    text = element.attributes["value"].strip().lower()
    if text not in ("true", "false"):
        raise element.error(f"value: expected 'true' or 'false', got {element.attributes['value']!r}")
    return text == "true"


def colour(element: Element) -> dict[str, Any]:
    """``<rgb value="r, g, b">``, one number for grey; as a load_dict colour."""
    values = numbers(element, "value", (1, 3))
    return {"type": "rgb", "value": values * 3 if len(values) == 1 else values}


def srgb_colour(element: Element) -> dict[str, Any]:
    """``<srgb value="r, g, b">`` or ``"#rrggbb"`` of old files: sRGB-encoded, returned linear."""
    text = element.attributes["value"].strip()
    if text.startswith("#") and len(text) == 7:
        try:
            values = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        except ValueError:
            raise element.error(f"value: expected '#rrggbb', got {text!r}") from None
    else:
        values = numbers(element, "value", (1, 3))
    linear = srgb_to_linear(torch.tensor(values, dtype=torch.float64)).tolist()
    return {"type": "rgb", "value": linear * 3 if len(linear) == 1 else linear}


def spectrum(element: Element) -> dict[str, Any]:
    """``<spectrum value="0.5">`` or ``"400:0.1, 700:0.9"`` (wavelength in nm : value); as a load_dict spectrum."""
    text = element.attributes["value"]
    if ":" not in text:
        return {"type": "spectrum", "value": numbers(element, "value", (1,))[0]}
    pairs = []
    for part in text.replace(",", " ").split():
        try:
            wavelength, value = (float(side) for side in part.split(":"))
        except ValueError:
            raise element.error(f"value: expected pairs such as '400:0.1, 700:0.9', got {part!r}") from None
        pairs.append((wavelength, value))
    return {"type": "spectrum", "value": pairs}


def vector(element: Element, default: float | None = None) -> list[float]:
    """``value="x, y, z"``, one number for all three, or ``x="" y="" z=""``.

    Of the latter, components that are left out are `default`, or an error if that is None.
    """
    given = element.attributes
    if "value" in given:
        if {"x", "y", "z"} & set(given):
            raise element.error("expected either 'value' or 'x', 'y' and 'z', got both")
        values = numbers(element, "value", (1, 3))
        return values * 3 if len(values) == 1 else values
    missing = [axis for axis in "xyz" if axis not in given]
    if missing and (default is None or len(missing) == 3):
        raise element.error(f"the attribute {missing[0]!r} is missing")
    return [number(element, axis) if axis in given else float(default or 0.0) for axis in "xyz"]


def transform(element: Element) -> np.ndarray:
    """The product of a transform's steps as a 4x4 float64 matrix; each step is multiplied from the left."""
    matrix = np.eye(4)
    for step in element.children:
        if step.tag not in _STEPS:
            raise step.error(f"unexpected inside <transform>; {nearest(step.tag, _STEPS)}")
        no_children(step)
        try:
            matrix = _STEPS[step.tag](step) @ matrix
        except ValueError as error:
            if str(error).startswith(step.file):
                raise
            raise step.error(str(error)) from None
    return matrix


def _translate(step: Element) -> np.ndarray:
    check_attributes(step, (), ("value", "x", "y", "z"))
    return np.asarray(Transform.translate(vector(step, 0.0)))


def _scale(step: Element) -> np.ndarray:
    check_attributes(step, (), ("value", "x", "y", "z"))
    if "value" in step.attributes and len(step.attributes) == 1:
        values = numbers(step, "value", (1, 3))
        return np.asarray(Transform.scale(values[0] if len(values) == 1 else values))
    return np.asarray(Transform.scale(vector(step, 1.0)))


def _rotate(step: Element) -> np.ndarray:
    check_attributes(step, ("angle",), ("value", "x", "y", "z"))
    return np.asarray(Transform.rotate(vector(step, 0.0), number(step, "angle")))


def _matrix(step: Element) -> np.ndarray:
    check_attributes(step, ("value",))
    values = np.array(numbers(step, "value", (9, 16)))
    if values.size == 16:
        return values.reshape(4, 4)
    matrix = np.eye(4)  # nine numbers are the linear part
    matrix[:3, :3] = values.reshape(3, 3)
    return matrix


def _lookat(step: Element) -> np.ndarray:
    check_attributes(step, ("origin", "target"), ("up",))
    origin, target = numbers(step, "origin", (3,)), numbers(step, "target", (3,))
    if "up" in step.attributes:
        up = numbers(step, "up", (3,))
    else:
        # Any direction across the view will do: the axis along which the view points least.
        view = np.abs(np.subtract(target, origin))
        up = np.eye(3)[int(view.argmin())].tolist()
    return np.asarray(Transform.look_at(origin, target, up))


_STEPS = {"translate": _translate, "scale": _scale, "rotate": _rotate, "matrix": _matrix, "lookat": _lookat}
