"""Cameras besides the perspective one: with a lens in focus at one distance, without perspective, of wide views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from ..transform import Transform, on_cpu
from . import values
from .camera import (
    LENS,
    Camera,
    LensCamera,
    ProjectiveCamera,
    coefficients,
    film_of,
    precision_of,
)
from .camera_batches import batched
from .camera_rays import Rays, fisheye_rays, orthographic_rays, panorama_rays, thinlens_rays
from .context import Context
from .field_of_view import scale_angle
from .film import ReconstructionFilter
from .registry import register

if TYPE_CHECKING:
    from typing_extensions import Self


@register
class ThinLensCamera(ProjectiveCamera):
    """A camera with a lens: what is not at the distance of focus is blurred.

    It stands and sees as a `PerspectiveCamera` does; rays come from a disk around the frame's origin.

    Args:
        to_world: 4x4 matrix, camera to world, without scaling.
        aperture_radius: radius of the lens, in scene units; 0 is a pinhole.
        focus_distance: distance of the plane in focus, along the camera's axis; `far_clip` if omitted.
        fov, fov_axis, focal_length: the field of view, as of a `PerspectiveCamera`.
        near_clip, far_clip: planes in front of the camera between which surfaces are seen.
        principal_point_offset_x, principal_point_offset_y: fractions of the film's width and height by which the
            image moves left and up.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "thinlens"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        properties = super().prepare(properties, ctx)
        if "focus_distance" not in properties:
            far = properties.get("far_clip", 1e4)
            properties["focus_distance"] = values.number(far, ctx.at("far_clip")).detach()
        return properties

    def required(self) -> dict[str, Any]:
        return {"aperture_radius": 0.0}

    def rays(self, positions: Any = None, lens: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in all parameters but the clipping planes.

        Args:
            positions: (N, 2) as (x, y) in pixels from the upper left corner of the whole film, x to the right and y
                down, pixel centres at +0.5. None: the centres of the pixels that are rendered, row by row.
            lens: (N, 2) in the unit square, which is mapped onto the lens, keeping areas; None: its middle.

        Returns:
            Origins, unit directions (N, 3) and reach (N,), as of `PerspectiveCamera.rays`.
        """
        size, at = (self.film.height, self.film.width), self.positions(positions)
        parameters = self.values_of(*LENS, "aperture_radius", "focus_distance")
        return thinlens_rays(*parameters, size=size, positions=at, lens=self.on_lens(lens, len(at)))


@register
class OrthographicCamera(Camera):
    """Parallel rays along +z. The film's width is [-1, 1] of the camera's frame, +x to the left, +y up.

    Args:
        to_world: 4x4 matrix, camera to world; its scale along x and y is half of the width of what is seen.
        near_clip, far_clip: planes in front of the camera between which surfaces are seen.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "orthographic"
    rigid = False

    @classmethod
    @batched(origin=1, target=1, up=1)
    @on_cpu
    def look_at(
        cls,
        origin: Any,
        target: Any,
        up: Any = (0.0, 1.0, 0.0),
        *,
        width: Any = 2.0,
        size: Sequence[int] = (256, 256),
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> Self:
        """A camera at `origin` that looks at `target`.

        Args:
            origin, target, up: (3,) in world space.
            width: of what is seen, in scene units.
            size: of the film (H, W).
            filter: name of a reconstruction filter, or one.
            properties: others that the class takes.
        """
        half = values.double(width, Context(path=(cls.__name__, "look_at", "width"))) / 2
        scale = torch.stack([half, half, torch.ones_like(half)])
        matrix = (Transform.look_at(origin, target, up) @ Transform.scale(scale)).matrix
        precision = precision_of(cls, origin, target, up, width)
        return cls(to_world=matrix, film=film_of(size, filter), _context=precision, **properties)

    def rays(self, positions: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in `to_world`; see `PerspectiveCamera.rays`."""
        size = (self.film.height, self.film.width)
        return orthographic_rays(
            *self.values_of("to_world", "near_clip", "far_clip"), size=size, positions=self.positions(positions)
        )


@register
class FisheyeCamera(LensCamera):
    """A fisheye lens: the distance from the image's middle grows with the angle to the axis, not with its tangent.

    In focal lengths it is ``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``, as in OpenCV.

    Args:
        to_world: 4x4 matrix, camera to world, without scaling.
        fov: field of view without distortion, in degrees along `fov_axis` (``x``, ``y``, ``diagonal``, ``smaller``,
            ``larger``), below 720.
        distortion: the coefficients k1 k2 k3 k4.
        max_angle: angle to the axis, in degrees, beyond which nothing is seen; 90 makes a circle of a half space.
        near_clip, far_clip: distances from the camera between which surfaces are seen.
        principal_point_offset_x, principal_point_offset_y: fractions of the film's width and height by which the
            image moves left and up.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "fisheye"
    most: ClassVar[float] = 720.0
    scale: ClassVar[Callable[[torch.Tensor, float], torch.Tensor]] = staticmethod(scale_angle)
    otherwise: ClassVar[str | None] = None

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["fov", "fov_axis", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        properties = super().prepare(properties, ctx)
        if properties.get("distortion") is None:
            properties["distortion"] = [0.0] * 4
        return properties

    def convert_tensor(self, field: Any, value: Any, ctx: Context) -> torch.Tensor:
        return coefficients(value, (4,), 4, "k1 k2 k3 k4", ctx)

    @classmethod
    def focal_of(cls, x_fov: torch.Tensor, width: int) -> torch.Tensor:
        return width / torch.deg2rad(x_fov)

    @classmethod
    def fov_of(cls, focal: torch.Tensor, width: int) -> torch.Tensor:
        return torch.rad2deg(width / focal)

    def rays(self, positions: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in pose and lens; see `PerspectiveCamera.rays`."""
        size, at = (self.film.height, self.film.width), self.positions(positions)
        return fisheye_rays(*self.values_of(*LENS, "distortion", "max_angle"), size=size, positions=at)


@register
class PanoramaCamera(Camera):
    """All directions, columns being longitudes and rows latitudes, from +y of the camera's frame down to -y.

    The image's middle is +z of the frame, its right -x: an `EnvironmentMap` at rest in that frame is seen with the
    columns of its bitmap, and with its rows from pole to pole.

    Args:
        to_world: 4x4 matrix, camera to world, without scaling.
        near_clip, far_clip: distances from the camera between which surfaces are seen.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "panorama"

    @classmethod
    @batched(origin=1, target=1, up=1)
    @on_cpu
    def look_at(
        cls,
        origin: Any,
        target: Any,
        up: Any = (0.0, 1.0, 0.0),
        *,
        size: Sequence[int] = (128, 256),
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> Self:
        """A camera at `origin` that has `target` in the middle of the image; see `PerspectiveCamera.look_at`."""
        matrix, precision = Transform.look_at(origin, target, up).matrix, precision_of(cls, origin, target, up)
        return cls(to_world=matrix, film=film_of(size, filter), _context=precision, **properties)

    def rays(self, positions: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in `to_world`; see `PerspectiveCamera.rays`."""
        size = (self.film.height, self.film.width)
        return panorama_rays(
            *self.values_of("to_world", "near_clip", "far_clip"), size=size, positions=self.positions(positions)
        )
