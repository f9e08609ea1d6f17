"""What a medium does to light along rays: absorption and emission, as volumes or the same everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..scene.native import NativeScene
from ..scene.packing import Layout, Record, record
from ..scene.scene import Scene
from ..surface import inverse_linear
from ..wavefront.volumes import evaluate
from ..wavefront.world import World
from .flights import GRIDS


@dataclass
class Light:
    """The volumes of a medium, `emission` -1 for none.

    Where they vary, or the medium emits, the core adds up what every kick does to light; else the length of the way is
    enough, and `look_up` is empty.
    """

    world: World
    volumes: dict[str, int]
    factor: torch.Tensor  # of the extinction

    @classmethod
    def of(cls, scene: Scene, layout: Layout, native: NativeScene, tensors: list[torch.Tensor], medium: int) -> Light:
        described = record(layout, "medium", medium)
        field = described.field
        volumes = {"extinction": field["sigma_t"], "emission": field["emission"]}
        light = cls(World(scene, layout, native, tensors), volumes, tensors[field["scale"]])
        if layout.spectral and light.look_up:
            raise ValueError(
                f"gradientindex.trace: {described.path}: in a spectral scene the absorption of a medium is followed "
                "where it is the same everywhere, and its emission is not; render() has both"
            )
        return light

    def _volume(self, name: str) -> Record:
        return self.world.records["volume"][self.volumes[name]]

    @property
    def look_up(self) -> dict[str, tuple[int, int]]:
        """By grid the numbers of its filter and of what is beyond its cube."""
        if self.volumes["emission"] < 0 and self._volume("extinction").type == "constvolume":
            return {}
        numbers = {}
        for name in GRIDS:
            if self.volumes[name] >= 0:
                field = self._volume(name).field
                numbers[name] = field.get("filter_type", 1), field.get("wrap_mode", 2)
        return numbers

    def grids(self, matrix: torch.Tensor, origin: torch.Tensor) -> list[torch.Tensor]:
        """Grids and maps as `Flights` takes them; `matrix`, `origin`: from voxels of the field to the world."""
        found = []
        for name in GRIDS:
            none = matrix.new_empty(0)
            found += self._grid(name, matrix, origin) if name in self.look_up else [none, none]
        return found

    def _grid(self, name: str, matrix: torch.Tensor, origin: torch.Tensor) -> list[torch.Tensor]:
        volume = self._volume(name)
        if volume.type == "constvolume":
            data, to_local = self._values(volume).reshape(1, 1, 1, -1), matrix.new_zeros(3, 4)
        else:
            data, placed = self._values(volume), self.world.tensor("volume", volume, "to_world")
            inverse = inverse_linear(placed)
            columns = torch.cat([matrix, (origin - placed[:3, 3])[:, None]], 1)
            to_local = (inverse[:, :, None] * columns).sum(1)
        return [data * self.factor if name == "extinction" else data, to_local]

    def _values(self, volume: Record) -> torch.Tensor:
        return self.world.tensor("volume", volume, "data" if volume.type == "gridvolume" else "value")

    def at_end(
        self,
        position: torch.Tensor,
        n: torch.Tensor,
        length: torch.Tensor,
        rest: torch.Tensor,
        depth: torch.Tensor,
        emitted: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Transmittance and emission (N, C) with the kick of size `rest` (N,) at the end, where the index is n."""
        if not self.look_up:
            sigma = self.factor * self._values(self._volume("extinction")).reshape(-1)
            transmittance = torch.exp(-length[:, None] * sigma)
            return transmittance, torch.zeros_like(transmittance)
        colours = max(self._values(self._volume(name)).shape[-1:].numel() for name in self.look_up)
        piece = (rest * n)[:, None]
        x = self.factor * evaluate(self.world, self.volumes["extinction"], position)[:, :colours] * piece
        depth, emitted = depth[:, :colours], emitted[:, :colours]
        if self.volumes["emission"] >= 0:
            eps = evaluate(self.world, self.volumes["emission"], position)[:, :colours] / n[:, None] ** 2
            emitted = emitted + torch.exp(-depth) * eps * piece * _mean_decay(x)
        return torch.exp(-depth - x), emitted


def _mean_decay(x: torch.Tensor) -> torch.Tensor:
    """(1 - exp(-x)) / x."""
    near = x.abs() < 1e-4
    inside = torch.where(near, 1.0, x)
    return torch.where(near, 1 - x / 2 + x * x / 6, -torch.expm1(-inside) / inside)
