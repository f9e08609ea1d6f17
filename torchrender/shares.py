"""What a process renders of an image: all of it, unless `torchrender.distributed` has set a share of several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from .first_hit_call import FirstHitCall
    from .render_call import RenderCall


class Share:
    """All of it: what a process renders that is alone. Shares of several replace what they do otherwise."""

    def check(self, **_: Any) -> None:
        """ValueError, before any work, for what cannot be shared in this way."""

    def replicated(self, tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
        """The parameters of a rendering: those of all processes, whose derivatives are to be everyone's."""
        return list(tensors)

    def crop(self, size: tuple[int, int], crop: Any) -> Any:
        """The argument `crop` of an image of `size`, whose own one is given."""
        return crop

    def gathered(self, outputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """The whole of outputs (H, W, ...) by name, of this process' part of their rows."""
        return outputs

    def part(self, count: int, batch: int = 1) -> tuple[int, int]:
        """Which of `count` things this process has, whole batches: from the first number to before the second."""
        return 0, count

    def samples(self, spp: int) -> tuple[int, int]:
        """The same of a pixel's samples, of which there is at least one: see `averaged`."""
        return 0, spp

    def adaptive_offset(self) -> int:
        """The number of the first sample of derivatives that give each pixel a number of samples of its own."""
        return 0

    def averaged(
        self,
        call: RenderCall,
        params: Sequence[torch.Tensor],
        values: tuple[torch.Tensor, ...],
        first: FirstHitCall | None = None,
    ) -> tuple[torch.Tensor, ...]:
        """Averages over all samples, of those over this process' samples: of radiance, or of outputs of `first`."""
        return values

    def attached(self, values: tuple[torch.Tensor, ...], params: Sequence[torch.Tensor]) -> tuple[torch.Tensor, ...]:
        """Outputs that PyTorch has made, and which depend on `params` where the process has seen something."""
        return values

    def same(self, values: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        """What all processes have found alike, with derivatives that add up to one."""
        return values

    def summed(self, terms: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
        """Zeros whose derivatives are to be summed."""
        return terms

    def seen_by_outlines(
        self, first: FirstHitCall, params: Sequence[torch.Tensor], values: Sequence[torch.Tensor], covered: torch.Tensor
    ) -> tuple[Sequence[torch.Tensor], torch.Tensor]:
        """Averages of `first` over the derivative's samples that hit something, and the share that does."""
        return values, covered


ALONE = Share()
_current: ContextVar[Share] = ContextVar("share", default=ALONE)
current = _current.get


@contextmanager
def sharing(share: Share) -> Iterator[None]:
    """Renderings that begin inside are shared; their derivatives are so, wherever they are asked for."""
    token = _current.set(share)
    try:
        yield
    finally:
        _current.reset(token)
