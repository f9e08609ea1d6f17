"""The perspective camera, from a scene dict or from what people have: OpenCV and OpenGL matrices."""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Sequence
from typing import Any, ClassVar

import torch

from ..errors import describe
from ..transform import Transform, as_matrix, on_cpu
from . import values
from .context import Context
from .film import Film, ReconstructionFilter
from .registry import register
from .sensor import Sensor

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")
# The diagonal of the 36 mm x 24 mm frame that focal lengths refer to.
FRAME_DIAGONAL = math.hypot(36.0, 24.0)


def x_fov_of(fov: torch.Tensor, axis: str, aspect: float) -> torch.Tensor:
    """Horizontal field of view in degrees from one along another `axis`; `aspect` is width / height."""
    if axis == "smaller":
        axis = "y" if aspect > 1 else "x"
    elif axis == "larger":
        axis = "x" if aspect > 1 else "y"
    if axis == "x":
        return fov
    half = torch.tan(torch.deg2rad(fov) / 2)
    half = half * (aspect if axis == "y" else aspect / math.hypot(1.0, aspect))
    return torch.rad2deg(2 * torch.atan(half))


def take_fov(owner: str, properties: dict[str, Any], aspect: float, ctx: Context) -> None:
    """Replace `fov` with `fov_axis`, or `focal_length`, in `properties` by `x_fov`; `aspect` is width / height."""
    axis = properties.pop("fov_axis", "x")
    values.choice(axis, FOV_AXES, ctx.at("fov_axis"))
    ways = [n for n in ("fov", "focal_length", "x_fov") if n in properties]
    if len(ways) > 1:
        ctx.error(f"{owner}: give one of fov, focal_length and x_fov, not {' and '.join(ways)}")
    if "fov" in properties:
        given = properties.pop("fov")
        fov = x_fov_of(_angle(given, ctx.at("fov")), axis, aspect)
        properties["x_fov"] = values.rounded(fov, given, ctx)
    elif "x_fov" in properties:
        _angle(properties["x_fov"], ctx.at("x_fov"))
    else:
        given = properties.pop("focal_length", "50mm")
        millimetres = _millimetres(given, ctx.at("focal_length"))
        diagonal = torch.rad2deg(2 * torch.atan(FRAME_DIAGONAL / (2 * millimetres)))
        properties["x_fov"] = values.rounded(x_fov_of(diagonal, "diagonal", aspect), given, ctx)


def check_rigid(owner: str, properties: dict[str, Any], ctx: Context) -> None:
    """ValueError for a `to_world` in `properties` that does more than turn and move."""
    if "to_world" in properties:
        matrix = values.matrix(properties["to_world"], 4, ctx.at("to_world")).detach().double()
        gram = matrix[:3, :3].T @ matrix[:3, :3]
        if float((gram - torch.eye(3, dtype=torch.float64)).abs().max()) > 1e-3:
            ctx.at("to_world").error(f"a {owner}'s matrix may turn and move, but not scale or shear")


Rays = namedtuple("Rays", "origins directions tmax")
Rays.__doc__ = """Camera rays: `origins`, unit `directions` (N, 3), world space, and how far they reach, `tmax` (N,)."""


def perspective_rays(
    to_world: torch.Tensor,
    x_fov: torch.Tensor,
    offset_x: torch.Tensor,
    offset_y: torch.Tensor,
    near_clip: torch.Tensor,
    far_clip: torch.Tensor,
    pixel_aspect: torch.Tensor,
    size: tuple[int, int],
    positions: torch.Tensor,
) -> Rays:
    """Rays of a pinhole camera with these parameters, see `PerspectiveCamera.rays`; `size` of the film is (H, W)."""
    height, width = size
    tangent = torch.tan(x_fov * (math.pi / 360))
    x = 2 * (positions[:, 0] * (1 / width) + offset_x)
    y = 2 * (positions[:, 1] * (1 / height) + offset_y)
    local = torch.stack([(1 - x) * tangent, (1 - y) * (tangent * height / width * pixel_aspect), torch.ones_like(x)], 1)
    local = local / torch.linalg.vector_norm(local, dim=1, keepdim=True)
    directions = (to_world[:3, :3] * local[:, None]).sum(2)  # not a matrix product, which autocast would round
    directions = directions / torch.linalg.vector_norm(directions, dim=1, keepdim=True)
    stretch = 1 / local[:, 2]
    origins = to_world[:3, 3] + directions * (stretch * near_clip)[:, None]
    return Rays(origins, directions, (stretch * (far_clip - near_clip)).detach())


@register
class PerspectiveCamera(Sensor):
    """A pinhole camera that looks along its +z axis, +y up, +x to the left.

    Args:
        to_world: 4x4 matrix, camera to world, without scaling.
        fov: field of view in degrees along `fov_axis` (``x``, ``y``, ``diagonal``, ``smaller``, ``larger``).
        focal_length: in place of `fov`: millimetres on a 36 x 24 mm frame, a number or ``"50mm"``, the default.
        near_clip, far_clip: planes in front of the camera between which surfaces are seen.
        principal_point_offset_x, principal_point_offset_y: fractions of the film's width and height by which the
            image moves left and up.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "perspective"
    # A pinhole is in focus everywhere; scenes written for lenses say a distance nevertheless.
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {
        "shutter_open": (0, 0.0),
        "shutter_close": (0, 0.0),
        "focus_distance": (),
    }
    unsupported: ClassVar[tuple[str, ...]] = ("srf",)

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["fov", "fov_axis", "focal_length", *super().parameter_names()]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        self.take_film(properties, ctx)
        film = self.film
        take_fov(self.type, properties, film.width / film.height, ctx)
        check_rigid("camera", properties, ctx)
        near = float(values.double(properties.get("near_clip", 1e-2), ctx.at("near_clip")).detach())
        far = float(values.double(properties.get("far_clip", 1e4), ctx.at("far_clip")).detach())
        if not 0 < near < far:
            ctx.error(f"perspective: expected 0 < near_clip < far_clip, got {near:g} and {far:g}")
        return properties

    def rays(self, positions: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in pose, field of view and principal point.

        ``tr.ray_intersect(scene, *camera.rays(positions))`` is what the camera sees there.

        Args:
            positions: (N, 2) as (x, y) in pixels from the upper left corner of the whole film, x to the right and y
                down, pixel centres at +0.5. None: the centres of the pixels that are rendered, row by row.

        Returns:
            A named tuple of `origins` (N, 3) on the near plane, unit `directions` (N, 3) in world space, and `tmax`
            (N,), the distances to the far plane, which carry no gradient.
        """
        if positions is None:
            y0, x0, height, width = self.film.window
            rows = torch.arange(height, device=self.to_world.device) + (y0 + 0.5)
            columns = torch.arange(width, device=self.to_world.device) + (x0 + 0.5)
            y, x = torch.meshgrid(rows, columns, indexing="ij")
            positions = torch.stack([x, y], -1).reshape(-1, 2)
        if not isinstance(positions, torch.Tensor):
            positions = torch.as_tensor(positions, device=self.to_world.device)
        if positions.ndim != 2 or positions.shape[1] != 2 or positions.is_complex():
            raise ValueError(f"rays: positions: expected shape (N, 2), got {describe(positions)}")
        return perspective_rays(
            self.to_world,
            self.x_fov,
            self.principal_point_offset_x,
            self.principal_point_offset_y,
            self.near_clip,
            self.far_clip,
            self.pixel_aspect,
            (self.film.height, self.film.width),
            positions.to(self.to_world),
        )

    # ------------------------------------------------------------------------------------------- constructors
    @classmethod
    @on_cpu
    def look_at(
        cls,
        origin: Any,
        target: Any,
        up: Any = (0.0, 1.0, 0.0),
        *,
        fov: float = 40.0,
        size: Sequence[int] = (256, 256),
        fov_axis: str = "x",
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> PerspectiveCamera:
        """A camera at `origin` that looks at `target`.

        Args:
            origin, target, up: (3,) in world space.
            fov: field of view in degrees along `fov_axis`.
            size: of the film (H, W).
            filter: name of a reconstruction filter, or one.
            properties: others that the class takes.
        """
        matrix = Transform.look_at(origin, target, up).matrix
        film = _film(size, filter)
        precision = _precision(cls, origin, target, up, fov)
        return cls(to_world=matrix, fov=fov, fov_axis=fov_axis, film=film, _context=precision, **properties)

    @classmethod
    @on_cpu
    def from_opencv(
        cls,
        K: Any,
        R: Any,
        t: Any,
        size: Sequence[int],
        *,
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> PerspectiveCamera:
        """A camera in OpenCV's convention: x_camera = R x_world + t, looking along +z with +y down.

        Args:
            K: (3, 3) intrinsics in pixels, without skew. Pixel centres lie at +0.5.
            R: (3, 3) rotation, world to camera.
            t: (3,) translation.
            size: of the film (H, W).

        Tensors keep their graph: gradients of an image reach K, R and t.
        """
        ctx = Context(path=("PerspectiveCamera", "from_opencv"))
        height, width = _size(size, ctx)
        intrinsics = as_matrix(K, 3, "PerspectiveCamera.from_opencv: K")
        rotation = as_matrix(R, 3, "PerspectiveCamera.from_opencv: R")
        offset = values.vector(t, ctx.at("t")).double()
        fx, fy = intrinsics[0, 0], intrinsics[1, 1]
        _check_intrinsics(intrinsics.detach(), ctx.at("K"))
        # Our +x is left and +y up: both are turned around with respect to OpenCV's.
        flip = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
        to_world = _rigid(rotation.T @ flip, -(rotation.T @ offset))
        return cls(
            to_world=to_world,
            x_fov=torch.rad2deg(2 * torch.atan(width / (2 * fx))),
            principal_point_offset_x=0.5 - intrinsics[0, 2] / width,
            principal_point_offset_y=0.5 - intrinsics[1, 2] / height,
            film=_film((height, width), filter),
            pixel_aspect=fx / fy,
            _context=_precision(cls, K, R, t),
            **properties,
        )

    @classmethod
    @on_cpu
    def from_opengl(
        cls,
        camera_to_world: Any,
        fov: Any,
        size: Sequence[int],
        *,
        fov_axis: str = "x",
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> PerspectiveCamera:
        """A camera in OpenGL's, Blender's and NeRF's convention: looking along -z with +y up and +x right.

        Args:
            camera_to_world: (4, 4) or (3, 4).
            fov: field of view in degrees along `fov_axis`.
            size: of the film (H, W).
        """
        ctx = Context(path=("PerspectiveCamera", "from_opengl"))
        height, width = _size(size, ctx)
        matrix = camera_to_world if isinstance(camera_to_world, (torch.Tensor, Transform)) else None
        if matrix is None:
            matrix = values.floating(camera_to_world, Context(dtype=torch.float64, path=ctx.path))
        if isinstance(matrix, torch.Tensor) and matrix.shape == (3, 4):
            matrix = torch.cat([matrix.double(), torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])
        matrix = as_matrix(matrix, 4, "PerspectiveCamera.from_opengl: camera_to_world")
        flip = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64))
        film = _film((height, width), filter)
        return cls(
            to_world=matrix @ flip,
            fov=fov,
            fov_axis=fov_axis,
            film=film,
            _context=_precision(cls, camera_to_world, fov),
            **properties,
        )

    # ------------------------------------------------------------------------------------------- and back again
    @property
    def K(self) -> torch.Tensor:
        """Intrinsics (3, 3) in pixels of the whole film, as `from_opencv` takes them; attached to the parameters."""
        half = torch.tan(torch.deg2rad(self.x_fov) / 2)
        fx = self.film.width / (2 * half)
        cx = (0.5 - self.principal_point_offset_x) * self.film.width
        cy = (0.5 - self.principal_point_offset_y) * self.film.height
        zero, one = torch.zeros_like(fx), torch.ones_like(fx)
        return torch.stack([fx, zero, cx, zero, fx / self.pixel_aspect, cy, zero, zero, one]).reshape(3, 3)

    @property
    def world_to_camera(self) -> torch.Tensor:
        """(4, 4), the rows [R | t] and 0 0 0 1 of OpenCV's convention (+y down, +z forward); attached to `to_world`."""
        signs = self.to_world.new_tensor([-1.0, -1.0, 1.0, 1.0])
        return signs[:, None] * torch.linalg.inv(self.to_world)  # not a matrix product, which autocast would round


def _precision(cls: type, *given: Any) -> Context:
    """float64 if a tensor among the arguments is, else torch's default."""
    wide = any(isinstance(value, torch.Tensor) and value.dtype == torch.float64 for value in given)
    return Context(dtype=torch.float64 if wide else torch.get_default_dtype(), path=(cls.__name__,))


def _check_intrinsics(K: torch.Tensor, ctx: Context) -> None:
    fx, fy, skew = float(K[0, 0]), float(K[1, 1]), float(K[0, 1])
    if not (fx > 0 and fy > 0 and abs(skew) <= 1e-3 * fx):
        ctx.error(f"needs fx > 0, fy > 0 and no skew, got fx={fx:.6g}, fy={fy:.6g}, skew={skew:.6g}")


def _rigid(linear: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    top = torch.cat([linear, offset[:, None]], dim=1)
    return torch.cat([top, torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])


def _size(size: Any, ctx: Context) -> tuple[int, int]:
    try:
        height, width = size
    except (TypeError, ValueError):
        ctx.at("size").error(f"expected (height, width), got {describe(size)}")
    return values.integer(height, ctx.at("size"), 1), values.integer(width, ctx.at("size"), 1)


def _film(size: Any, filter: str | ReconstructionFilter) -> Film:
    height, width = _size(size, Context(path=("PerspectiveCamera",)))
    return Film(width, height, filter=ReconstructionFilter(filter) if isinstance(filter, str) else filter)


def _angle(value: Any, ctx: Context) -> torch.Tensor:
    angle = values.double(value, ctx)
    if not 0 < float(angle.detach()) < 180:
        ctx.error(f"expected an angle between 0 and 180 degrees, got {float(angle.detach()):g}")
    return angle


def _millimetres(value: Any, ctx: Context) -> torch.Tensor:
    if isinstance(value, str):
        text = value.strip()
        try:
            value = float(text[:-2] if text.endswith("mm") else text)
        except ValueError:
            ctx.error(f"expected a length like '50mm', got {value!r}")
    length = values.double(value, ctx)
    if not 0 < float(length.detach()) < float("inf"):
        ctx.error(f"expected a positive length, got {float(length.detach()):g}")
    return length
