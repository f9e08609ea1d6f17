"""Volumes: values everywhere in space, for the properties of media."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .construction import check_names
from .context import Context
from .declaration import Field
from .plugin import Plugin
from .registry import register


@register
class ConstantVolume(Plugin):
    """The same value everywhere.

    Args:
        value: a number for all channels or a colour, default 1.
    """

    category, type = "volume", "constvolume"

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        child = self._child("value")
        if child is not None:
            for leaf, tensor in child.texels():
                yield f"value.{leaf}", tensor


@register
class GridVolume(Plugin):
    """Values on a grid that fills the unit cube [0, 1]^3 of its own space, which `to_world` places in the world.

    Voxel (k, j, i) of a grid (Z, Y, X) has its centre at x = (i + 0.5) / X, y = (j + 0.5) / Y, z = (k + 0.5) / Z.

    Args:
        filename: a ``.vol`` or ``.npy`` file, see `torchrender.io.read_volume`.
        data: voxels (Z, Y, X, C), C = 1 or 3, or (Z, Y, X).
        grid: an object that NumPy can read as such an array, in place of the two.
        use_grid_bbox: the grid fills the bounding box that the ``.vol`` file states, to which `to_world` is applied,
            instead of the unit cube.
        filter_type: ``"trilinear"`` or ``"nearest"``.
        wrap_mode: what lies beyond the cube: ``"clamp"``, ``"repeat"`` or ``"mirror"``. (The extinction of a medium is
            zero there, whatever this says.)
        to_world: 4x4 matrix, not singular.
        raw: accepted; without spectra there is nothing to convert.
    """

    category, type = "volume", "gridvolume"
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"accel": (True, False), "raw": (True, False)}
    words: ClassVar[tuple[str, ...]] = ("filename", "grid")

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", "grid", "use_grid_bbox", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        sources = ("filename", "grid")
        with_bounds = values.boolean(properties.pop("use_grid_bbox", False), ctx.at("use_grid_bbox"))
        check_names(self, {k: v for k, v in properties.items() if k not in sources}, ctx)
        given = [n for n in (*sources, "data") if properties.get(n) is not None]
        if len(given) != 1:
            ctx.error(f"give one of filename, grid and data; got {' and '.join(given) or 'none'}")
        content = properties.pop(given[0])
        to_world = properties.get("to_world")
        to_world = None if to_world is None else invertible(to_world, ctx.at("to_world"))
        if given[0] == "filename":
            from .. import io

            path = ctx.at("filename").file(content)
            with ctx.at("filename").located():
                content = io.read_volume(path)
                if with_bounds:
                    placed = _placed(io.read_volume_bounds(path).double(), path)
                    to_world = placed if to_world is None else to_world @ placed
        elif with_bounds:
            ctx.at("use_grid_bbox").error(f"only .vol files have a bounding box, but {given[0]} is given")
        if to_world is not None:
            properties["to_world"] = values.rounded(to_world, properties.get("to_world"), ctx)
        return {**properties, "data": content}

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        return values.voxels(value, ctx)

    def derivative_of(self, field: Field) -> str:
        if field.name == "to_world" and self.filter_type == "nearest":
            return "none: moves the faces of nearest voxels, a discontinuity that is not implemented yet"
        return super().derivative_of(field)

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if self._parameters.get("to_world") is not None:
            invertible(self.to_world, ctx.at("to_world"))

    def extra_repr(self) -> str:
        return " x ".join(str(n) for n in self.data.shape[:3]) + " voxels, " + super().extra_repr()


def _placed(box: torch.Tensor, path: Path) -> torch.Tensor:
    """The matrix that brings the unit cube to a bounding box (2, 3)."""
    if not bool((box[1] > box[0]).all()):
        raise ValueError(f"{path}: its bounding box is empty: {box.tolist()}")
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = torch.diag(box[1] - box[0])
    matrix[:3, 3] = box[0]
    return matrix


def invertible(value: Any, ctx: Context) -> torch.Tensor:
    """`value` as a 4x4 matrix in double precision that can be inverted."""
    matrix = values.matrix(value, 4, Context(ctx.color, torch.float64, ctx.device, ctx.path, ctx.folder))
    plain = matrix.detach()
    # relative to the axes' lengths: a tiny or flat grid is no singular one
    lengths = torch.linalg.vector_norm(plain[:3, :3], dim=0)
    if not bool((lengths > 0).all()) or abs(float(torch.linalg.det(plain[:3, :3] / lengths))) < 1e-7:
        ctx.error("the matrix is singular: the grid would have no volume")
    if plain[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        ctx.error(f"expected 0 0 0 1 as the last row, got {describe(plain[3].tolist())}")
    return matrix
