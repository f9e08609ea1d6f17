"""Settings that are attributes, checked: errors name their owner, the setting, what was expected and what came."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .errors import describe
from .transform import is_whole, single


def integer(owner: str, name: str, value: Any, minimum: int) -> int:
    """An integer of at least `minimum`, of Python, NumPy or torch."""
    number = single(value)
    if not is_whole(number):
        raise TypeError(f"{owner}: {name}: expected an integer, got {describe(value)}")
    if int(number) < minimum:
        raise ValueError(f"{owner}: {name}: expected at least {minimum}, got {number}")
    return int(number)


def boolean(owner: str, name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(single(value), bool):
        raise TypeError(f"{owner}: {name}: expected True or False, got {describe(value)}")
    return bool(value)


def word(owner: str, name: str, value: Any, known: Sequence[str]) -> str:
    """One of the `known` words."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{owner}: {name}: expected {' or '.join(known)}, got {describe(value)}")
    return value


def is_own(owner: object, name: str) -> bool:
    """Whether an attribute of this name is private, there already, or one that the class has for all."""
    return name.startswith("_") or name in owner.__dict__ or hasattr(type(owner), name)
