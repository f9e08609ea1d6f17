"""A number that grows whenever the structure of any scene object changes, so that scenes know when to pack anew."""

from __future__ import annotations

_epoch = 0


def structure_epoch() -> int:
    """A scene that was packed at this number is packed still."""
    return _epoch


def structure_changed() -> None:
    """After every change of which objects there are, and which tensors they hold."""
    global _epoch
    _epoch += 1
