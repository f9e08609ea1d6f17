"""The shape `sdfgrid`: an implicit surface on a grid."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .context import Context
from .declaration import Field
from .registry import register
from .shapes import Shape


@register
class SdfGrid(Shape):
    """Where a grid of signed distances, or of any function that is negative inside, is zero; under `to_world`.

    The numbers lie at the corners of cells that fill the unit cube [0, 1]^3: number (k, j, i) at x = i / (W - 1),
    y = j / (H - 1), z = k / (D - 1). Between them the function is trilinear. Rays meet its zeros exactly, from both
    sides; where the cube ends the surface does. Normals point to positive values. There are no texture coordinates:
    textures of images are looked up at (0, 0), those of volumes anywhere, and materials that need directions along the
    surface (brushed ones, bump and normal maps) are refused. `tr.sdfgrid` has the function in PyTorch.

    Args:
        grid: (D, H, W, 1) or (D, H, W), floating point, D, H, W > 1.
        filename: a ``.vol`` or ``.npy`` file in its place, see `torchrender.io.read_volume`.
        normals: for shading: ``"smooth"``, which go on from cell to cell, or ``"analytic"``, those of the surface.
        to_world: 4x4 matrix.
        flip_normals: normals point to negative values.
        bsdf: material; a grid of distances cannot emit.
        interior, exterior: media inside and outside.
    """

    type = "sdfgrid"
    words: ClassVar[tuple[str, ...]] = ("filename",)
    wrap_mode: ClassVar[str] = "corners"  # where the numbers lie, for those who resample them

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = [n for n in ("grid", "filename") if properties.get(n) is not None]
        if len(given) != 1:
            ctx.error(f"give one of grid and filename; got {' and '.join(given) or 'none'}")
        rest = {k: v for k, v in properties.items() if k not in ("grid", "filename")}
        content = properties[given[0]]
        if given[0] == "filename":
            from .. import io

            path = ctx.at("filename").file(content)
            with ctx.at("filename").located():
                content = io.read_volume(path)
        return {**rest, "grid": content}

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        if isinstance(value, torch.Tensor) and not value.is_floating_point():
            ctx.error(f"expected a floating-point tensor of shape (D, H, W, 1), got {describe(value)}")
        tensor = values.floating(value, ctx)
        if tensor.ndim == 3:
            tensor = tensor[..., None]
        if tensor.ndim != 4 or tensor.shape[3] != 1 or min(tensor.shape[:3]) < 2:
            ctx.error(f"expected distances of shape (D, H, W, 1) with D, H, W > 1, got {describe(value)}")
        return tensor.contiguous()

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if self._child("emitter") is not None:
            ctx.at("emitter").error("a grid of distances cannot emit")

    def bounds(self) -> torch.Tensor:
        """Of the cells that the surface meets; a corner of the cube if there are none."""
        matrix, grid = self.to_world.detach(), self.grid.detach()[..., 0]
        low, high = (
            -torch.nn.functional.max_pool3d(-grid[None, None], 2, 1)[0, 0],
            torch.nn.functional.max_pool3d(grid[None, None], 2, 1)[0, 0],
        )
        met = ((low <= 0) & (high >= 0) & (low < high)).nonzero().flip(1)  # x, y, z
        cells = torch.tensor([n - 1 for n in reversed(grid.shape)], dtype=matrix.dtype, device=matrix.device)
        ends = torch.zeros_like(matrix[:2, :3])
        if len(met):
            ends = torch.stack([met.amin(0), met.amax(0) + 1]) / cells
        points = torch.cartesian_prod(*ends.unbind(1)).to(matrix.dtype) @ matrix[:3, :3].T + matrix[:3, 3]
        return torch.stack([points.amin(0), points.amax(0)])
