"""What derivatives by what moves things lack in one scene, where declarations say what they lack in some."""

from __future__ import annotations

from collections.abc import Callable

from .declaration import models
from .packing import Layout

MARK = "seen in mirrors or through glass"  # in the declarations of what moves things
ZERO = ": zero where no such edge is in view"
NONE = f"the motion of silhouettes, creases and edges of shadows{ZERO}"
JUMPS = "jumps of textures"
OWN, OTHERS, BORDER = "of its silhouettes", "of silhouettes of curves", "of the image's border"
WITHOUT_OUTLINES = ("heightfield", "bsplinecurve", "linearcurve", "sdfgrid")


def moving_caveat(layout: Layout, caveat: str, outlines: bool) -> str:
    """`caveat` with what is there: the missing term, and after a colon when it is zero; empty if the rest is complete.

    Args:
        layout: of the packed scene.
        caveat: as it is declared.
        outlines: whether the rendering looks for outlines at all.
    """
    if MARK not in caveat:
        return caveat
    if not outlines:
        jumps = _named("of jumps of", layout, "volume", _has_nearest) if layout.media else []
        return ", and ".join([NONE.partition(":")[0], *jumps]) + ZERO
    missing = [OWN] if OWN in caveat else []
    if OTHERS in caveat:
        missing += _named("of silhouettes of", layout, "shape", lambda kind, _: kind in WITHOUT_OUTLINES)
    if BORDER in caveat:
        missing.append(BORDER)
    missing += _named("of edges that are seen in or through", layout, "bsdf", _is_delta)
    if JUMPS in caveat:
        missing += _named("of jumps of", layout, "texture", _jumps)
    return f"the motion {', '.join(missing)}: zero where no such edge is in view" if missing else ""


def _named(what: str, layout: Layout, category: str, fits: Callable[[str, list[int]], bool]) -> list[str]:
    """That, with the names of the objects of a category that fit."""
    names = [path for kind, row, path in layout.objects[category] if fits(kind, row)]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return [f"{what} {', '.join(names[:3])}{more}"] if names else []


def _is_delta(kind: str, _row: list[int]) -> bool:
    return kind in ("null", "mask") or "has_delta_lobes" in models()["bsdf", kind].flags


def _jumps(kind: str, row: list[int]) -> bool:
    return kind == "checkerboard" or _has_nearest(kind, row, "texture")


def _has_nearest(kind: str, row: list[int], category: str = "volume") -> bool:
    fields = [f.name for f in models()[category, kind].fields]
    return "filter_type" in fields and row[fields.index("filter_type")] == 1
