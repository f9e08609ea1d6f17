"""One rendering of one sensor, as everything that works on it sees it: settings, seeds, statistics, stored hits."""

from __future__ import annotations

import math
import warnings
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from .errors import RenderError, depth_outside
from .interruption import Interruption, part_ends
from .scene.derivatives import moves_outlines
from .scene.film import Film
from .scene.gradient_requirements import GradientRequirements
from .scene.native import NativeScene
from .scene.packing import Layout
from .scene.values import in_forward_mode
from .seeds import mix
from .shares import ALONE, Share

# Of rays that bend those that may be lost without a warning: near edges of a boundary rounding takes some past it.
MOST_LOST = 1e-3


@dataclass
class RenderCall:
    """Everything of one rendering of one sensor that is no tensor."""

    native: NativeScene
    config: dict[str, Any]  # what primal and derivative rendering share
    size: tuple[int, ...]  # (H, W), or (N,) with a list of pixels
    spp: int
    seed: int
    spp_grad: int
    seed_grad: int
    passes: int
    nan: str
    pixels: Any  # the array to whose memory `config` points
    alpha: bool
    variance: bool
    second_moment: bool
    statistics: dict[str, Any]
    requirements: GradientRequirements  # which derivatives there are
    film: Film
    features: dict[int, torch.Tensor]  # those of the output of this name, by the number of their shape
    interruption: Interruption
    outlines: bool = False  # derivatives have the motion of outlines that the camera sees
    spp_visibility: tuple[int, int] | None = None  # see `render`
    adaptive_grad: bool = False
    progress: bool | None = None  # whether a bar is shown; None: where somebody is watching
    stokes: bool = False  # the image has the four components of a colour one after the other, (H, W, 4 C)
    held: tuple[torch.Tensor, ...] = ()  # whose memory `config` points to, besides
    keep_hits: bool = False  # the derivative has the image's samples, and may be asked for
    hits: Any = None  # weak reference to what is kept, from the image's rendering on
    kept: torch.Tensor | None = None  # keeps it alive until autograd does
    pattern: int | None = None  # samples a pixel that were wanted, of which the first `spp` are there
    share: Share = ALONE  # what of it this process renders

    @property
    def extra(self) -> tuple[str, ...]:
        """Outputs of paths besides the image, none of which has a derivative."""
        return tuple(name for name in ("alpha", "variance", "second_moment") if getattr(self, name))

    @property
    def layout(self) -> Layout:
        """Of the packed scene."""
        return self.requirements.layout

    def configs(self, derivative: bool) -> list[dict[str, Any]]:
        """The core's settings of each pass."""
        seed, spp = (self.seed_grad, self.spp_grad) if derivative else (self.seed, self.spp)
        pattern = spp if self.pattern is None or derivative else self.pattern
        begin, end = self.share.samples(spp)
        some = {"sample_offset": begin, "spp": end - begin, "pattern": (0, pattern)}
        common = {**self.config, **some, "threads": torch.get_num_threads()}
        return [{**common, "seed": seed if i == 0 else mix(seed, i)} for i in range(self.passes)]

    def parts(self) -> list[Part]:
        """What of the image the core is asked for in turn: passes, the first in parts, if a part is to come back.

        But not where a derivative is to have the samples of the image.
        """
        configs = self.with_hits(self.configs(derivative=False))
        if not self.interruption.returns:
            return [Part(config, i, self.spp, 1.0) for i, config in enumerate(configs)]
        traced = self.config["film_size"] if self.config["integrator"] == "ptracer" else self.size
        ends = [self.spp] if self.seed == self.seed_grad else part_ends(self.spp, math.prod(traced))
        parts = []
        for i, config in enumerate(configs):
            sums, begin = self.native.core.FilmSums(), 0
            for end in ends if i == 0 else [self.spp]:
                some = {"pattern": (0, self.spp), "sums": sums, "sample_offset": begin, "spp": end - begin}
                parts.append(Part({**config, **some}, i, end, (end - begin) / self.spp))
                begin = end
        return parts

    def cut(self, last: Part) -> None:
        """Count what there is when `last` is done; other outputs and derivatives then have as many passes."""
        self.interruption.count(last.number * self.spp + last.end, self.passes * self.spp)
        self.passes = last.number + 1
        if last.end < self.spp:
            self.pattern, self.spp = self.spp, last.end

    def check_indices(self) -> None:
        """Faces that were edited since the image was rendered, which torch does not notice: they have no gradient."""
        if self.native.index_key != self.native.layout.index_key():
            raise RuntimeError(
                "the faces of a mesh have been modified by an inplace operation between rendering and backward()"
            )

    def may_move_outlines(self, tensors: Sequence[torch.Tensor]) -> bool:
        """Whether derivatives by what moves outlines may be asked for; `tensors` by slot."""
        layout = self.layout
        if layout.outlines is None:
            layout.outlines = [i for i, slot in enumerate(layout.slots) if moves_outlines(slot)]
        return in_forward_mode() or any(tensors[i].requires_grad for i in layout.outlines)

    def finish(self, kind: str, all_stats: list[dict[str, Any]]) -> None:
        """Keep the statistics; warn of samples that were not finite, and of rays that were given up."""
        total = dict(all_stats[0])
        for stats in all_stats[1:]:
            for key, value in stats.items():
                if isinstance(value, (int, float)) and key != "lanes":
                    total[key] += value
        self.statistics[kind] = total
        count = int(total.get("nonfinite", 0))
        if count:
            where = next((s["nonfinite_where"] for s in all_stats if s.get("nonfinite")), "")
            text = f"{count} samples were not finite" + (f", first at {where}" if where else "")
            if self.nan == "raise":
                raise RenderError(text)
            warnings.warn(text + "; they were dropped", RuntimeWarning, stacklevel=depth_outside())

        bent, lost = int(total.get("bent_rays", 0)), int(total.get("bent_rays_lost", 0))
        if lost > MOST_LOST * bent:
            text = (
                f"{lost} of {bent} rays in gradientindex media took more than max_steps steps, or went further beyond "
                "the grid than it is long; they are black. Is the shape around the medium closed?"
            )
            warnings.warn(text, RuntimeWarning, stacklevel=depth_outside())
        met = int(total.get("bent_rays_met", 0))
        if met:
            text = (
                f"{met} of {bent} rays in gradientindex media met the boundary of another one: media that touch, "
                "overlap or are nested are not rendered; behind that boundary light goes astray"
            )
            warnings.warn(text, RuntimeWarning, stacklevel=depth_outside())

    def store_hits(self, limit: int) -> torch.Tensor:
        """Begin to keep hits, `limit` bytes at most; they live as long as the memory of the tensor that comes back."""
        store = self.native.core.HitStore(limit)
        self.hits = weakref.ref(store)
        return torch.frombuffer(store, dtype=torch.uint8)

    def with_hits(self, configs: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The passes' settings with where their hits are kept, if that is still there."""
        store = self.hits() if self.hits is not None else None
        return configs if store is None else [{**c, "hits": (store, i)} for i, c in enumerate(configs)]

    @property
    def place(self) -> torch.device:
        """Where the image is made, and its adjoint is read: with the scene, if what renders has that memory."""
        home = self.native.home
        alone = self.share is ALONE and self.pixels is None and not self.interruption.returns and not self.stokes
        if home is None or not alone or self.config["integrator"] == "ptracer" or not self.native.holds(home):
            return torch.device("cpu")
        return home

    def shape(self) -> tuple[int, ...]:
        return (*self.size, self.numbers)

    @property
    def numbers(self) -> int:
        """Of a pixel of the image."""
        return (4 if self.stokes else 1) * self.native.channels


@dataclass
class Part:
    """What the core renders in one call: samples up to `end` of the pass of this number, a `share` of the pass."""

    config: dict[str, Any]
    number: int
    end: int
    share: float

    def done(self) -> bool:
        """Whether it was rendered, although Ctrl-C came before the core's call returned."""
        return "sums" in self.config and self.config["sums"].spp() == self.end
