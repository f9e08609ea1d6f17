"""Derivatives that a rendering is asked for: an error where there are none, one warning where a term is missing."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

from ..errors import MissingTermWarning, NotDifferentiableError, depth_outside
from .derivatives import moves_rays
from .moving_edges import MARK, moving_caveat
from .packing import Layout, Slot

COVERAGE = "outputs: alpha"  # among the names that were warned about

STEADY = (
    "the particle tracer moves light over the film, whose box filter has no derivative; "
    "give the film another one, such as 'gaussian' or 'tent'"
)

ON_GRIDS = "the particle tracer has none with respect to what moves where there is an sdfgrid; the path tracer has"


@dataclass
class GradientRequirements:
    """Derivatives asked for in one rendering, and what it can say about them.

    Attributes:
        layout: of the packed scene.
        warned: names that were warned about in this scene before; grows.
        alpha: coverage is among the outputs, which has no derivative where surfaces or the camera move.
        volumetric: it is an image of the volumetric path tracer.
        steady: the image is splatted by light paths with a filter that has no derivative.
        particles: it is splatted by light paths.
        outlines: whether the motion of silhouettes, creases and shadows is in the derivative; False also of
            those who do not want to hear of it, see `silent`.
        silent: missing motion of edges is not warned about.
    """

    layout: Layout
    warned: set[str]
    alpha: bool = False
    volumetric: bool = False
    steady: bool = False
    particles: bool = False
    outlines: bool = False
    silent: bool = False

    def check(self, indices: Iterable[int]) -> None:
        """For the slots of these `indices`: NotDifferentiableError, or one MissingTermWarning for all of them.

        Objects that no image depends on, such as a material that no shape has, are warned about too.
        """
        lacking: dict[str, list[str]] = {}
        unused: list[str] = []
        asked = list(indices)
        for i in asked:
            slot = self.layout.slots[i]
            if id(slot.module) not in self.layout.used and slot.name not in self.warned:
                unused.append(slot.name)
            refusal = slot.refusal
            if self.steady and not refusal and moves_rays(slot):
                refusal = STEADY
            if self.particles and not refusal and moves_rays(slot) and self._has_grids():
                refusal = ON_GRIDS
            if refusal:
                refuse(slot.name, refusal)
            if slot.caveat and slot.name not in self.warned and self._source(i) not in asked:
                caveat = self._caveat(slot)
                if caveat:
                    lacking.setdefault(caveat, []).append(slot.name)
        if unused:
            self.warned.update(unused)
            text = f"{_listing(unused)}: nothing in the scene uses this, so that its gradient is zero"
            warnings.warn(text, UserWarning, stacklevel=depth_outside())
        clauses = []
        if lacking:
            self.warned.update(*lacking.values())
            for caveat, names in lacking.items():
                missing, _, zero = caveat.partition(": ")
                clauses.append(
                    f"the derivative with respect to {_listing(names)} is without {missing}, which is {zero}"
                )
        if (
            self.alpha
            and not self.outlines
            and not self.silent
            and COVERAGE not in self.warned
            and any(self._moves(i) for i in asked)
        ):
            self.warned.add(COVERAGE)
            clauses.append("alpha carries no derivative: that of coverage consists of moving silhouettes alone")
        if clauses:
            warnings.warn("; ".join(clauses), MissingTermWarning, stacklevel=depth_outside())

    def _caveat(self, slot: Slot) -> str:
        """What this rendering's derivative lacks, and when that is zero; empty if nothing is to be said."""
        if self.silent and MARK in slot.caveat:
            return ""
        return moving_caveat(self.layout, slot.caveat, self.outlines, self.particles, self.volumetric)

    def _has_grids(self) -> bool:
        return any(kind == "sdfgrid" for kind, _, _ in self.layout.objects["shape"])

    def _moves(self, index: int) -> bool:
        """Whether this parameter moves outlines in the image."""
        slot = self.layout.slots[index]
        shading = ("vertex_normals", "vertex_texcoords")
        return slot.module.category in ("shape", "sensor") and slot.attribute not in shading

    def _source(self, index: int) -> int | None:
        """For computed normals the positions that they follow: whoever asks for those has not asked for these."""
        slot = self.layout.slots[index]
        if slot.attribute == "vertex_normals" and slot.module in self.layout.smooth_meshes:
            return self.layout.slot_of[id(slot.module), "vertex_positions"]
        return None


def _listing(names: list[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def refuse(name: str, reason: str) -> None:
    """NotDifferentiableError for a parameter of this name."""
    raise NotDifferentiableError(
        f"{name}: the image has no derivative with respect to this parameter in this version ({reason}); "
        "switch its requires_grad off, or let scene.train_only(PATTERN, ...) choose among those that have one"
    )
