"""One rendering of one sensor, as everything that works on it sees it: settings, seeds, statistics, stored hits."""

from __future__ import annotations

import warnings
import weakref
from dataclasses import dataclass
from typing import Any

import torch

from .errors import RenderError, depth_outside
from .scene.film import Film
from .scene.gradient_requirements import GradientRequirements
from .scene.native import NativeScene
from .scene.packing import Layout
from .seeds import mix


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
    adaptive_grad: bool = False
    progress: bool | None = None  # whether a bar is shown; None: where somebody is watching
    keep_hits: bool = False  # the derivative has the image's samples, and may be asked for
    hits: Any = None  # weak reference to what is kept, from the image's rendering on
    kept: torch.Tensor | None = None  # keeps it alive until autograd does

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
        threads = torch.get_num_threads()
        return [
            {**self.config, "spp": spp, "seed": seed if i == 0 else mix(seed, i), "threads": threads}
            for i in range(self.passes)
        ]

    def check_indices(self) -> None:
        """Faces that were edited since the image was rendered, which torch does not notice: they have no gradient."""
        if self.native.index_key != self.native.layout.index_key():
            raise RuntimeError(
                "the faces of a mesh have been modified by an inplace operation between rendering and backward()"
            )

    def finish(self, kind: str, all_stats: list[dict[str, Any]]) -> None:
        """Keep the statistics; warn once of samples that were not finite."""
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

    def store_hits(self, limit: int) -> torch.Tensor:
        """Begin to keep hits, `limit` bytes at most; they live as long as the memory of the tensor that comes back."""
        store = self.native.core.HitStore(limit)
        self.hits = weakref.ref(store)
        return torch.frombuffer(store, dtype=torch.uint8)

    def with_hits(self, configs: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """The passes' settings with where their hits are kept, if that is still there."""
        store = self.hits() if self.hits is not None else None
        return configs if store is None else [{**c, "hits": (store, i)} for i, c in enumerate(configs)]

    def shape(self) -> tuple[int, ...]:
        return (*self.size, self.native.channels)
