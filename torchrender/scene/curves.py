"""The shapes `bsplinecurve` and `linearcurve`: hair, wires, tubes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch

from ..errors import describe
from . import values
from .construction import check_names
from .context import Context
from .declaration import Field
from .registry import register
from .shapes import Shape


class Curve(Shape):
    """What both kinds of curves share: control points with radii, and the segments between them."""

    category = "shape"
    order: ClassVar[int]  # control points of a segment, less one
    words: ClassVar[tuple[str, ...]] = ("filename", "to_world")
    renames: ClassVar[dict[str, str]] = {**Shape.renames, "segments": "segment_indices"}
    # `read_curves` gives what the file holds, in these terms
    control_points: torch.Tensor
    radii: torch.Tensor
    segment_indices: torch.Tensor

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["control_points", "radii", "segment_indices", "filename", "to_world", "bsdf"]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        check_names(self, {k: v for k, v in properties.items() if k not in self.parameter_names()}, ctx)
        given = [n for n in ("control_points", "filename") if properties.get(n) is not None]
        if len(given) != 1:
            ctx.error(f"give one of control_points and filename; got {' and '.join(given) or 'none'}")
        rest = {k: v for k, v in properties.items() if k not in ("filename", "to_world")}
        if given == ["filename"]:
            for name in ("radii", "segment_indices"):
                if properties.get(name) is not None:
                    ctx.at(name).error("the file has them; give control_points in place of filename")
            rest |= self._from_file(properties["filename"], ctx.at("filename"))
        points, radii, strands = _points_and_radii(rest.pop("control_points"), rest.pop("radii", None), ctx)
        matrix = properties.get("to_world")
        if matrix is not None:  # in double precision, so that the same dict gives the same curve in all scenes
            double = Context(ctx.color, torch.float64, ctx.device, ctx.path, ctx.folder)
            matrix = values.matrix(matrix, 4, double.at("to_world"))
            points = (points.to(torch.float64) @ matrix[:3, :3].T + matrix[:3, 3]).to(points.dtype)
        segments = rest.pop("segment_indices", None)
        if segments is None:
            each = len(points) // max(strands, 1)
            if each <= self.order:
                ctx.at("control_points").error(f"a {self.type} has at least {self.order + 1}, got {each}")
            segments = (torch.arange(strands)[:, None] * each + torch.arange(each - self.order)).flatten()
        segments = self._segments(segments, len(points), ctx.at("segment_indices"))
        return {**rest, "control_points": points, "radii": radii, "segment_indices": segments}

    def _from_file(self, name: Any, ctx: Context) -> dict[str, Any]:
        from ..io.curves import read_curves  # when there is such a file

        path = ctx.file(name)
        with ctx.located():
            curves = read_curves(path)
        short = next((c for c in curves if len(c) <= self.order), None)
        if short is not None:
            ctx.error(f"{path}: each curve of a {self.type} has at least {self.order + 1} points, one has {len(short)}")
        firsts, begin = [], 0
        for curve in curves:
            firsts.append(torch.arange(begin, begin + len(curve) - self.order))
            begin += len(curve)
        return {"control_points": torch.cat(curves), "segment_indices": torch.cat(firsts)}

    def _segments(self, value: Any, count: int, ctx: Context) -> torch.Tensor:
        """First control points (S,) as contiguous int32, checked against the number of points."""
        tensor = value if isinstance(value, torch.Tensor) else torch.as_tensor(value)
        if tensor.is_floating_point() or tensor.is_complex() or tensor.dtype == torch.bool or tensor.ndim != 1:
            ctx.error(
                f"expected integers of shape (S,), the first control point of each segment; got {describe(value)}"
            )
        if not len(tensor):
            ctx.error("expected at least one segment, got none")
        low, high, last = int(tensor.min()), int(tensor.max()), count - 1 - self.order
        if low < 0 or high > last:
            ctx.error(f"expected numbers from 0 to {last}, got {low if low < 0 else high}: there are {count} points")
        return tensor.to(device=ctx.device, dtype=torch.int32).contiguous()

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        tensor = values.floating(value, ctx)
        known = self._parameters.get("radii") if self.__dict__.get("_built", False) else None
        count = "N" if known is None else str(len(known))
        width = () if field.name == "radii" else (3,)
        if tensor.ndim != 1 + len(width) or tuple(tensor.shape[1:]) != width or count not in ("N", str(len(tensor))):
            expected = f"({count},)" if field.name == "radii" else f"({count}, 3)"
            advice = "" if known is None else "; for another number of points assign a new curve"
            ctx.error(f"expected an array of shape {expected}, got {describe(value)}{advice}")
        return tensor.contiguous()

    def _install(self, name: str, field: Field, value: Any, ctx: Context) -> None:
        if field.kind == "indices":
            self._buffers[name] = self._segments(value, len(self.control_points), ctx)
            return
        super()._install(name, field, value, ctx)

    def takes_shape(self, name: str, tensor: torch.Tensor, state: Mapping[str, Any], prefix: str) -> bool:
        """Another number of points, if everything that the checkpoint brings goes together."""
        own = {**self._parameters, **self._buffers}
        points, radii, segments = (
            state.get(prefix + n, own[n]) for n in ("control_points", "radii", "segment_indices")
        )
        fits = points.ndim == 2 and points.shape[1] == 3 and radii.shape == points.shape[:1] and segments.ndim == 1
        fits = fits and len(segments) > 0 and int(segments.min()) >= 0
        return bool(fits and int(segments.max()) + self.order < len(points))

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        if self._child("emitter") is not None:
            ctx.at("emitter").error("a curve cannot emit; a mesh or a cylinder can")
        for side in ("interior_medium", "exterior_medium"):
            if self._child(side) is not None:
                ctx.at(side.removesuffix("_medium")).error(
                    "rays meet a curve from outside only, so that it bounds no medium; a mesh or a cylinder does"
                )

    def bounds(self) -> torch.Tensor:
        points, radius = self.control_points.detach(), self.radii.detach().max()
        return torch.stack([points.amin(0) - radius, points.amax(0) + radius])

    def extra_repr(self) -> str:
        sizes = f"{len(self.control_points)} control points, {len(self.segment_indices)} segments"
        return ", ".join(filter(None, (sizes, super().extra_repr())))


@register
class BSplineCurve(Curve):
    """Tubes along uniform cubic B-splines: the centre and the radius are splines of the control points and radii.

    A spline does not pass through its control points; four of them in a row make a segment. Its cross section is a
    circle perpendicular to it, its ends are open. Texture coordinates are the azimuth and the place along all
    segments, both from 0 to 1; the tangent dp/du goes around. Rays meet curves from outside only.

    Args:
        control_points: (N, 3), or (M, K, 3) for M strands of K points, which become one after the other (N, 3); with
            `radii` in a fourth column (N, 4), (M, K, 4) or flat (4 N,), as Mitsuba has them.
        radii: (N,), (M, K) or one number, at least 0.
        segment_indices: (S,) integers, the first control point of each segment; without them all points,
            or those of each strand, are one curve.
        filename: a text file in place of these: ``x y z radius`` a line, an empty line between two curves.
        to_world: 4x4 matrix applied once to the points, when the curve is made; radii stay.
        bsdf: material; a curve cannot emit.
    """

    type = "bsplinecurve"
    order = 3


@register
class LinearCurve(Curve):
    """Cones around straight segments between spheres, which fill the joints and close the ends.

    Texture coordinates are the azimuth and the place along all segments, both from 0 to 1; the tangent dp/du goes
    around. Rays meet curves from outside only.

    Args:
        control_points: (N, 3), centres of the spheres, or (M, K, 3) for M strands of K points, which become one after
            the other (N, 3); with `radii` in a fourth column (N, 4), (M, K, 4) or flat (4 N,), as Mitsuba has them.
        radii: (N,), (M, K) or one number, at least 0.
        segment_indices: (S,) integers, the first control point of each segment; without them all points,
            or those of each strand, are one curve.
        filename: a text file in place of these: ``x y z radius`` a line, an empty line between two curves.
        to_world: 4x4 matrix applied once to the points, when the curve is made; radii stay.
        bsdf: material; a curve cannot emit.
    """

    type = "linearcurve"
    order = 1


def _points_and_radii(points: Any, radii: Any, ctx: Context) -> tuple[torch.Tensor, torch.Tensor, int]:
    """(N, 3) and (N,) from what is given, with radii in a fourth column or by themselves, and the number of strands."""
    if isinstance(points, Sequence) and len({len(p) for p in points if getattr(p, "ndim", 0) == 2}) > 1:
        ctx.at("control_points").error(
            "got strands of different lengths: give them one after the other (N, 3), and segment_indices, or a file"
        )
    tensor = values.floating(points, ctx.at("control_points"))
    strands = 1
    if tensor.ndim == 3:
        strands, tensor = len(tensor), tensor.flatten(0, 1)
    if radii is None and tensor.ndim == 1 and len(tensor) % 4 == 0:
        tensor = tensor.reshape(-1, 4)
    width = 4 if radii is None else 3
    if tensor.ndim != 2 or tensor.shape[1] != width:
        expected = "(N, 4) or (M, K, 4), the radius in the last column, or (N, 3) or (M, K, 3) and radii"
        expected = expected if radii is None else "(N, 3) or (M, K, 3)"
        ctx.at("control_points").error(f"expected an array of shape {expected}, got {describe(points)}")
    if not bool(torch.isfinite(tensor.detach()).all()):
        ctx.at("control_points").error("has values that are not finite")
    if radii is None:
        return tensor[:, :3].contiguous(), tensor[:, 3].contiguous(), strands
    own = values.floating(radii, ctx.at("radii"))
    if own.ndim == 2 and own.shape == (strands, len(tensor) // max(strands, 1)):
        own = own.flatten()
    if own.ndim == 0:
        own = own.expand(len(tensor))
    if own.shape != tensor.shape[:1]:
        ctx.at("radii").error(f"expected one number or an array of shape ({len(tensor)},), got {describe(radii)}")
    return tensor.contiguous(), own.contiguous(), strands
