"""What derivatives by what moves things lack in one scene, where declarations say what they lack in some."""

from __future__ import annotations

from collections.abc import Callable

from .declaration import models
from .packing import Layout

MARK = "seen in mirrors or through glass"  # in the declarations of what moves things
ZERO = ": zero where no such edge is in view"
NONE = "the motion of silhouettes, creases and edges of shadows"
UNSEEN = ["of edges of shadows", "of edges that reflected and scattered light meets"]
JUMPS = "jumps of textures"
OWN, OTHERS, BORDER = "of its silhouettes", "of silhouettes of curves", "of the image's border"
SEEN = "of edges that are seen in or through"
BEAM = "directionalarea"
WITHOUT_OUTLINES = ("bsplinecurve", "linearcurve", "sdfgrid")


def moving_caveat(
    layout: Layout, caveat: str, outlines: bool, particles: bool = False, volumetric: bool = False
) -> str:
    """`caveat` with what is there: the missing term, and after a colon when it is zero; empty if the rest is complete.

    Args:
        layout: of the packed scene.
        caveat: as it is declared.
        outlines: whether the rendering looks for outlines at all.
        particles: whether it is one of light tracing.
        volumetric: whether it is one of paths through media.
    """
    if MARK not in caveat:
        return caveat
    voxels = _named("of jumps of", layout, "volume", _has_nearest) if volumetric else []
    if not outlines:
        return ", and ".join([NONE, *voxels]) + ZERO
    missing = (UNSEEN if volumetric or layout.bending else []) + ([OWN] if OWN in caveat else [])
    if OTHERS in caveat:
        missing += _named("of silhouettes of", layout, "shape", lambda kind, _: kind in WITHOUT_OUTLINES)
    if BORDER in caveat:
        missing.append(BORDER)
    slides = _in_light_of(layout) if particles else _named(SEEN, layout, "bsdf", _blocks if volumetric else _is_delta)
    missing += slides
    # points that light paths find keep their place on the texture, but behind delta lobes and in beams
    if JUMPS in caveat and (slides or not particles):
        missing += _named("of jumps of", layout, "texture", _jumps)
    missing += voxels
    return f"the motion {', '.join(missing)}{ZERO}" if missing else ""


def _in_light_of(layout: Layout) -> list[str]:
    """Edges that light paths meet, or cast on surfaces, behind delta lobes and in beams."""
    return [
        *_named("of edges in the light that comes by way of", layout, "bsdf", _is_delta),
        *_named("of edges in the beams of", layout, "emitter", lambda kind, _: kind == BEAM),
    ]


def _named(what: str, layout: Layout, category: str, fits: Callable[[str, list[int]], bool]) -> list[str]:
    """That, with the names of the objects of a category that fit."""
    names = [path for kind, row, path in layout.objects[category] if fits(kind, row)]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return [f"{what} {', '.join(names[:3])}{more}"] if names else []


def _is_delta(kind: str, _row: list[int]) -> bool:
    return kind in ("null", "mask") or "has_delta_lobes" in models()["bsdf", kind].flags


def _blocks(kind: str, row: list[int]) -> bool:
    """Paths through media go on through what is `null`."""
    return kind != "null" and _is_delta(kind, row)


def _jumps(kind: str, row: list[int]) -> bool:
    return kind == "checkerboard" or _has_nearest(kind, row, "texture")


def _has_nearest(kind: str, row: list[int], category: str = "volume") -> bool:
    fields = [f.name for f in models()[category, kind].fields]
    return "filter_type" in fields and row[fields.index("filter_type")] == 1
