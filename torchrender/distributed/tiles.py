"""Tiles over processes: each renders a band of the image's rows."""

from __future__ import annotations

from typing import Any

import torch

from ..scene.context import Context
from ..scene.film import check_crop
from .collectives import Gather, Group, by_derivative
from .samples import Replicating


class TileShare(Replicating):
    """Rows h * rank to h * (rank + 1) of every image, h being its rows over the number of processes, rounded up."""

    def __init__(self, group: Group, to: int | None) -> None:
        super().__init__(group)
        self.to = to
        self.rows, self.places = 0, (0, 0)  # of the image that is being rendered, and which of them are here

    def check(self, *, light: bool, pixels: Any, **_: Any) -> None:
        if light:
            raise ValueError(
                "distributed.render: split: paths of ParticleTracer belong to no tile; split='samples' shares them"
            )
        if pixels is not None:
            raise ValueError("distributed.render: pixels: a list has no tiles; split='samples' shares its samples")

    def crop(self, size: tuple[int, int], crop: Any) -> Any:
        y0, x0, height, width = (0, 0, *size) if crop is None else check_crop(crop, size, Context(path=("render",)))
        band = -(-height // self.group.size)
        begin, end = (min(height, band * (self.group.rank + i)) for i in (0, 1))
        self.rows, self.places = height, (begin, end)
        if begin == end:
            begin, end = height - 1, height
        return y0 + begin, x0, end - begin, width

    def gathered(self, outputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        arguments = self.group, self.places, self.rows, self.to
        wholes = by_derivative(list(outputs.values()), lambda some, _: Gather.apply(*arguments, *some))
        return dict(zip(outputs, wholes, strict=True))
