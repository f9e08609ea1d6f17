"""Exceptions of this package, and the wording that all argument checks share."""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Iterable


class NotDifferentiableError(RuntimeError):
    """A derivative was asked for that the renderer does not have.

    Raised before any work, so that a missing derivative is never a silent zero.
    """


class MissingTermWarning(UserWarning):
    """A derivative was asked for that the renderer has in part only; the message says which term is missing.

    Given once for each parameter of each scene.
    """


class RangeWarning(UserWarning):
    """A parameter has left its physical range while it was optimised; the message says how to keep it inside.

    Given once for each parameter of each scene, in ``render``, whose argument `range` says what is done instead.
    """


class InterruptionWarning(UserWarning):
    """A rendering was interrupted whose ``on_interrupt`` is ``"return"``; the message says which samples it has."""


class SubstitutionWarning(UserWarning):
    """A part of a scene is not supported and a fallback takes its place.

    Wherever ``unsupported="substitute"`` asks for one; otherwise only where the image is the same in expectation, or
    next to it.

    The message names the place in the scene, what was there, and what is there now.
    """


class RenderError(RuntimeError):
    """A rendering failed: non-finite samples with ``nan="raise"``, or a broken native library."""


def nearest(word: object, known: Iterable[str]) -> str:
    """A clause naming the known words nearest to `word`, or listing all of them when none is near or it is no word."""
    names = sorted(set(known))
    if not names:
        return "none is accepted here"
    close = difflib.get_close_matches(word, names, n=3, cutoff=0.6) if isinstance(word, str) else []
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "known here: " + ", ".join(names)


def close_to(word: str, known: Iterable[str]) -> str:
    """The question whether known words are meant that are near `word` but for their case; empty where none is."""
    names = {name.lower(): name for name in sorted(known)}
    close = difflib.get_close_matches(word.lower(), names, n=3, cutoff=0.6)
    return "; did you mean " + " or ".join(repr(names[c]) for c in close) + "?" if close else ""


def describe(value: object) -> str:
    """What came, for an error message: type, and shape and dtype where there are any."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"a {type(value).__name__} of shape {tuple(shape)} and dtype {dtype}"
    text = " ".join(repr(value).split())
    if len(text) > 60:
        text = text[:57] + "..."
    return f"{text} ({type(value).__name__})"


def depth_outside() -> int:
    """The `stacklevel` that makes a warning of the caller point at the first line outside of this package."""
    frame, depth = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(("torchrender.", "torch.")):
        frame, depth = frame.f_back, depth + 1
    return depth


def warn_once(warned: set[str], key: str, text: str, category: type[Warning] = UserWarning) -> None:
    """A warning for the caller of this package, if `key` is not among what was `warned` about, which it is then."""
    if key not in warned:
        warned.add(key)
        warnings.warn(text, category, stacklevel=depth_outside())
