"""The medium `gradientindex`, which no other renderer's scene files have."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .context import Context
from .declaration import Field
from .media import Medium
from .registry import register
from .volumes import invertible

MOST_VOXELS = 1000  # a side: positions of rays are fixed-point numbers
MOST_STEPS = 10**9
LONGEST_STEP = {torch.float32: 4, torch.float64: 256}  # voxels: velocities of rays are fixed-point numbers, too


@register
class GradientIndexMedium(Medium):
    """A medium whose index of refraction n varies, so that light in it bends. A type of our own.

    n^2 is a B-spline over a grid, with the squares of ``n_i = index_base + index_scale * index`` as control values, so
    that n lies between the least and the largest of these. Beyond the grid it goes on as it ends. It fills the inside
    of a closed shape whose BSDF is `null` (the index does not jump there) or `dielectric` (light is refracted by the
    index at the boundary over `ext_ior`; its own indices are not used). See docs/gradient_index.md.

    Args:
        index: control values (Z, Y, X), or a number; voxel (k, j, i) is centred at ((i + 0.5) / X, (j + 0.5) / Y,
            (k + 0.5) / Z) of the unit cube.
        filename: a ``.vol`` or ``.npy`` file in its place, see `torchrender.io.read_volume`.
        index_base, index_scale: numbers, default 0 and 1. With a base near the index of the surroundings small
            differences, as of gases, keep their precision.
        to_world: 4x4 matrix, from the unit cube that the grid fills to the world; not singular.
        ext_ior: index of refraction outside of dielectric boundaries; default 1.000277, that of air.
        sigma_t: absorption per unit length, not negative (number, colour or volume); default 0.
        emission: radiance emitted per unit length, not negative (number, colour or volume); none by default. Outside of
            the medium it is divided by the square of the index where it was emitted. Grids of both go on beyond their
            cubes as their `wrap_mode` says; the filter "nearest" makes steps, whose motion derivatives leave out.
        scale: a factor of the absorption, not negative; default 1.
        interpolation: ``"cubic"`` or ``"quadratic"``, 1.7 times faster, with a gradient that has kinks.
        step: the length of a step at most, in units of a voxel's shortest side; default 1. Up to twice the longest
            side, which may be long along axes where the index does not vary, as in air above a road; in single
            precision up to 4, in double precision up to 256.
        max_steps: after which a ray is given up; 0, the default: as many as are 8 times the grid's three edges long.
    """

    type = "gradientindex"
    words: ClassVar[tuple[str, ...]] = ("filename",)
    filled: ClassVar[tuple[str, ...]] = ("sigma_t",)

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["filename", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        given = [n for n in ("index", "filename") if properties.get(n) is not None]
        if len(given) != 1:
            ctx.error(f"give one of index and filename; got {' and '.join(given) or 'none'}")
        properties = dict(properties)
        name = properties.pop("filename", None)
        if name is not None:
            from .. import io

            path: Path = ctx.at("filename").file(name)
            with ctx.at("filename").located():
                properties["index"] = self.convert_tensor(
                    self.fields()["index"], io.read_volume(path), ctx.at("filename")
                )
        return properties

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        tensor = values.floating(value, ctx)
        if tensor.ndim == 0:
            tensor = tensor.reshape(1, 1, 1)
        if tensor.ndim == 4 and tensor.shape[3] == 1:
            tensor = tensor[..., 0]
        if tensor.ndim != 3 or 0 in tensor.shape:
            more = " (an index for each colour would split light: that is not rendered)" if tensor.ndim == 4 else ""
            ctx.error(f"expected control values of shape (Z, Y, X), none of them 0, got {describe(value)}{more}")
        if max(tensor.shape) > MOST_VOXELS:
            ctx.error(f"expected at most {MOST_VOXELS} voxels a side, got {describe(value)}")
        return tensor.contiguous()

    def convert_static(self, name: str, value: Any, ctx: Context) -> bool | str | int:
        if name == "interpolation" and value in ("trilinear", "linear", "nearest"):
            ctx.error(f"{value!r} has no continuous gradient, which light follows: expected 'cubic' or 'quadratic'")
        converted = super().convert_static(name, value, ctx)
        if name == "max_steps" and not 0 <= int(converted) <= MOST_STEPS:
            ctx.error(f"expected an integer between 0 and {MOST_STEPS}, got {value!r}")
        return converted

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if self._parameters.get("index") is None:
            return
        matrix = invertible(self.to_world, ctx.at("to_world"))
        sides = torch.linalg.vector_norm(matrix.detach()[:3, :3], dim=0) / matrix.new_tensor(self.index.shape[::-1])
        most = min(2 * float(sides.max() / sides.min()), LONGEST_STEP[self.index.dtype]) * (1 + 1e-6)
        if not float(self.step) <= most:
            ctx.at("step").error(
                f"{float(self.step):g} is outside the range up to {most:g}: in units of a voxel's shortest side twice "
                f"the longest one, and at most {LONGEST_STEP[self.index.dtype]} in this precision"
            )
        n = (self.index_base + self.index_scale * self.index).detach()
        low, high = (float(x) for x in torch.aminmax(n))
        if not 0 < low <= high < float("inf"):
            ctx.at("index").error(
                f"expected positive indices of refraction, index_base + index_scale * index; they reach from {low:g} "
                f"to {high:g}"
            )

    def extra_repr(self) -> str:
        return " x ".join(str(n) for n in self.index.shape) + " voxels"
