"""The shape `heightfield`, which no other renderer's scene files have."""

from __future__ import annotations

from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .context import Context
from .declaration import Field
from .registry import register
from .shapes import Shape
from .textures import load_texels


@register
class HeightField(Shape):
    """Heights z over the square [-1, 1] x [-1, 1], under `to_world`; normals point to +z. A type of our own.

    The surface is smooth, curved like the heights themselves, and needs no mesh: rays meet the spline. Heights lie like
    the texels of a bitmap, row 0 at v = 0 (y = -1), and go on beyond the border as they end; (1, 1) is a plane.
    `tr.heightfield` has the same surface in PyTorch, and as a mesh.

    Args:
        heights: (H, W), floating point.
        filename, bitmap: an image of one channel in their place, taken as it is.
        interpolation: ``"bspline"``, cubic, with the heights as control values, or ``"bilinear"``.
        to_world: 4x4 matrix.
        flip_normals: normals point to -z.
        bsdf: material; a height field cannot emit.
        interior, exterior: media behind and in front of it.
    """

    type = "heightfield"
    words: ClassVar[tuple[str, ...]] = ("filename", "bitmap")
    wrap_mode: ClassVar[str] = "clamp"  # what lies beyond the border, for those who resample the heights

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", "bitmap", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = [n for n in ("heights", "bitmap", "filename") if properties.get(n) is not None]
        if len(given) != 1:
            ctx.error(f"give one of heights, bitmap and filename; got {' and '.join(given) or 'none'}")
        (name,) = given
        rest = {k: v for k, v in properties.items() if k not in ("heights", "bitmap", "filename")}
        content = properties[name]
        if name != "heights":
            content = torch.as_tensor(load_texels({name: content}, ctx, raw=True))
            if content.ndim == 3 and content.shape[2] == 1:
                content = content[:, :, 0]
            if content.ndim != 2:
                ctx.at(name).error(f"expected an image of one channel, got {describe(content)}")
        return {**rest, "heights": content}

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        if isinstance(value, torch.Tensor) and not value.is_floating_point():
            ctx.error(f"expected a floating-point tensor of shape (H, W), got {describe(value)}")
        tensor = values.floating(value, ctx)
        if tensor.ndim != 2 or tensor.numel() == 0:
            ctx.error(f"expected heights of shape (H, W) with H, W > 0, got {describe(value)}")
        return tensor.contiguous()

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if self._child("emitter") is not None:
            ctx.at("emitter").error("a height field cannot emit; tr.heightfield.mesh makes a mesh of it, which can")

    def bounds(self) -> torch.Tensor:
        """Of the least and the largest height, between which the surface is."""
        matrix, heights = self.to_world.detach(), self.heights.detach()
        x, y, z = torch.meshgrid(
            matrix.new_tensor([-1.0, 1.0]),
            matrix.new_tensor([-1.0, 1.0]),
            torch.stack(torch.aminmax(heights)),
            indexing="ij",
        )
        points = torch.stack([t.reshape(-1) for t in (x, y, z)], 1) @ matrix[:3, :3].T + matrix[:3, 3]
        return torch.stack([points.amin(0), points.amax(0)])
