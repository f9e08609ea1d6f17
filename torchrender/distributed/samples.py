"""Samples over processes: each traces its share of the samples of every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ..first_hit_call import FirstHitCall
from ..functions import unwrapped
from ..render_call import RenderCall
from ..scene.gather import has_derivative
from ..shares import Share
from .collectives import Attach, Group, Replicate, Total, by_derivative, plain, times


class Replicating(Share):
    """What shares of samples and of tiles have in common: parameters that all processes have."""

    def __init__(self, group: Group) -> None:
        self.group = group

    def replicated(self, tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """The tensors, whose gradients are the sums of those of all processes."""
        return by_derivative(
            tensors, lambda some, known: Replicate.apply(self.group, *some) if known != (False, False) else some
        )

    def attached(self, values: tuple[torch.Tensor, ...], params: Sequence[torch.Tensor]) -> tuple[torch.Tensor, ...]:
        """Values that saw nothing here take part in the derivative of what other processes saw."""
        known = [p for p in params if has_derivative(p)]
        if not known:
            return values
        return tuple(v if has_derivative(v) else Attach.apply(1, v, *known)[0] for v in values)


class SampleShare(Replicating):
    """Samples spp * rank / size to spp * (rank + 1) / size of every pixel.

    An average over all samples is the sum over processes of averages over their samples, each times its share of what
    all are divided by: a number of samples or, with filters and where only hits count, a sum of weights in each pixel.
    Image and derivative have samples and therefore weights of their own.
    """

    def check(self, *, names: Sequence[str], passes: int, wavefront: bool, boxes: bool, **_: Any) -> None:
        if wavefront:
            raise ValueError(
                "distributed.render: integrator: WavefrontPathTracer has no shares of samples; split='tiles' shares "
                "its image"
            )
        if "variance" in names:
            raise ValueError(
                "distributed.render: outputs: 'variance' is not found from shares of the samples; split='tiles' has "
                "it, and 'second_moment' is"
            )
        if passes > 1 and not boxes:
            raise ValueError(
                "distributed.render: passes: several need the box filter, since each has weights of its own; a larger "
                "spp takes no more memory"
            )

    def part(self, count: int, batch: int = 1) -> tuple[int, int]:
        batches, rank, size = -(-count // batch), self.group.rank, self.group.size
        begin, end = (min(count, batch * (batches * (rank + i) // size)) for i in (0, 1))
        return begin, end

    def samples(self, spp: int) -> tuple[int, int]:
        """One without weight, where there are fewer than processes."""
        begin, end = self.part(spp)
        return begin, max(end, begin + 1)

    def adaptive_offset(self) -> int:
        return self.part(1 << 32)[0]  # how many of these numbers a pixel takes depends on its gradient

    def averaged(
        self,
        call: RenderCall,
        params: Sequence[torch.Tensor],
        values: tuple[torch.Tensor, ...],
        first: FirstHitCall | None = None,
    ) -> tuple[torch.Tensor, ...]:
        weights = Weights(self, call, params, first)

        def total(some: Sequence[torch.Tensor], _: Any) -> tuple[torch.Tensor, ...]:
            def ratios(derivative: bool) -> list[Any]:
                ratio = weights.ratio(derivative)
                return [_spread(ratio, value.ndim - len(call.size)) for value in some]

            return Total.apply(self.group, ratios, False, *some)

        return tuple(by_derivative(values, total))

    def same(self, values: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        return Total.apply(self.group, lambda _: [1 / self.group.size] * len(values), False, *values)

    def summed(self, terms: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        return Total.apply(self.group, lambda _: [1] * len(terms), True, *terms)

    def seen_by_outlines(
        self, first: FirstHitCall, params: Sequence[torch.Tensor], values: Sequence[torch.Tensor], covered: torch.Tensor
    ) -> tuple[Sequence[torch.Tensor], torch.Tensor]:
        call = first.render
        weights = Weights(self, call, params, first)
        hits, every = weights.shares_of_hits(derivative=True)
        found = [times(value, _spread(hits, value.ndim - len(call.size))) for value in values]
        *found, covered = self.group.sum([*found, covered * every])
        return found, covered


def _spread(ratio: Any, dims: int) -> Any:
    """A factor a pixel for so many further dimensions of its values."""
    return ratio.reshape(*ratio.shape, *(1,) * dims) if isinstance(ratio, torch.Tensor) else ratio


class Weights:
    """What averages of one rendering are divided by, and which share of it this process has."""

    def __init__(
        self, share: SampleShare, call: RenderCall, params: Sequence[torch.Tensor], first: FirstHitCall | None
    ) -> None:
        self.share, self.call, self.first = share, call, first
        self.params = [unwrapped(p) for p in params]
        self.known: dict[bool, Any] = {}

    def ratio(self, derivative: bool) -> Any:
        """A number, or one a pixel, (H, W) or (N,)."""
        call = self.call
        if derivative not in self.known:
            light = call.config["integrator"] == "ptracer"
            counted = light or call.film.filter.type == "box" or (derivative and call.adaptive_grad)
            with plain():
                if self.first is not None:
                    found: Any = self.shares_of_hits(derivative)[0]
                elif counted:
                    spp = call.spp_grad if derivative else call.spp
                    begin, end = self.share.part(spp)
                    found = (end - begin) / spp
                else:
                    own = torch.empty(call.size, dtype=torch.float64)
                    self._find({**call.configs(derivative)[0]}, {"samples": own.data_ptr()})
                    found = self._shares(own, derivative)
            self.known[derivative] = found
        return self.known[derivative]

    def shares_of_hits(self, derivative: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Those of samples that hit something, or whatever outputs of the first hit are averages over, and of all."""
        assert self.first is not None
        own = torch.empty(*self.call.size, 2, dtype=torch.float64)
        self._find(self.first.config(derivative), {"hits": own.data_ptr()})
        hits, every = self._shares(own, derivative).unbind(-1)
        return (every if self.first.zero_at_misses else hits), every

    def _find(self, config: dict[str, Any], out: dict[str, int]) -> None:
        self.call.native.call("pixel_weights", self.params, config, out)

    def _shares(self, own: torch.Tensor, derivative: bool) -> torch.Tensor:
        begin, end = self.share.part(self.call.spp_grad if derivative else self.call.spp)
        if begin == end:
            own.zero_()
        (total,) = self.share.group.sum([own])
        shares = torch.where(total != 0, own / total, 1 / self.share.group.size)
        return shares.to(self.call.native.dtype)
