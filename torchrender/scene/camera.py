"""What cameras share, and the perspective one: from a scene dict or from OpenCV's and OpenGL's matrices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from ..errors import describe
from ..transform import Transform, as_matrix, on_cpu
from . import values
from .camera_batches import batched
from .camera_rays import Rays, distorted_rays, perspective_rays
from .construction import substituted
from .context import Context
from .field_of_view import FOV_AXES, FRAME_DIAGONAL, along_x, scale_tangent, take_fov
from .film import Film, ReconstructionFilter
from .registry import register
from .sensor import Sensor

if TYPE_CHECKING:
    from typing_extensions import Self


def check_rigid(owner: str, properties: dict[str, Any], ctx: Context) -> None:
    """ValueError for a `to_world` in `properties` that does more than turn and move."""
    if "to_world" in properties:
        matrix = values.matrix(properties["to_world"], 4, ctx.at("to_world")).detach().double()
        gram = matrix[:3, :3].T @ matrix[:3, :3]
        if float((gram - torch.eye(3, dtype=torch.float64)).abs().max()) > 1e-3:
            ctx.at("to_world").error(f"a {owner}'s matrix may turn and move, but not scale or shear")


def check_light(owner: str, properties: dict[str, Any], ctx: Context) -> None:
    """The same for a light, whose matrix may have an even scale, which changes nothing and is left out."""
    if "to_world" in properties:
        matrix = values.matrix(properties["to_world"], 4, ctx.at("to_world"))
        lengths = torch.linalg.vector_norm(matrix.detach().double()[:3, :3], dim=0)
        size = float(lengths.mean())
        if size > 0 and abs(size - 1) > 1e-3 and float((lengths / size - 1).abs().max()) < 1e-3:
            text = f"the scale {size:g} is left out: a {owner} has no size"
            substituted(ctx.at("to_world"), text)
            properties["to_world"] = torch.cat([matrix[:, :3] / size, matrix[:, 3:]], dim=1)
    check_rigid(owner, properties, ctx)


class Camera(Sensor):
    """What all cameras share: a film, a matrix, and rays through positions on the film."""

    inert: ClassVar[dict[str, tuple[Any, ...]]] = {"shutter_open": (), "shutter_close": ()}  # nothing moves
    rigid: ClassVar[bool] = True  # its matrix neither scales nor shears

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        self.take_film(properties, ctx)
        if self.rigid:
            check_rigid("camera", properties, ctx)
        elif "to_world" in properties:
            matrix = values.matrix(properties["to_world"], 4, ctx.at("to_world")).detach().double()
            if float(torch.linalg.det(matrix[:3, :3])) == 0:
                ctx.at("to_world").error("the matrix is singular")
        near = float(values.double(properties.get("near_clip", 1e-2), ctx.at("near_clip")).detach())
        far = float(values.double(properties.get("far_clip", 1e4), ctx.at("far_clip")).detach())
        if "near_clip" in self.fields() and not 0 < near < far:
            ctx.error(f"{self.type}: expected 0 < near_clip < far_clip, got {near:g} and {far:g}")
        return properties

    def positions(self, given: Any) -> torch.Tensor:
        """`given` positions on the film as (N, 2) in the camera's precision, None: the centres of the pixels."""
        device = self.to_world.device
        if given is None:
            y0, x0, height, width = self.film.window
            rows = torch.arange(height, device=device) + (y0 + 0.5)
            columns = torch.arange(width, device=device) + (x0 + 0.5)
            y, x = torch.meshgrid(rows, columns, indexing="ij")
            given = torch.stack([x, y], -1).reshape(-1, 2)
        if not isinstance(given, torch.Tensor):
            given = torch.as_tensor(given, device=device)
        if given.ndim != 2 or given.shape[1] != 2 or given.is_complex():
            raise ValueError(f"rays: positions: expected shape (N, 2), got {describe(given)}")
        return given.to(self.to_world)

    def on_lens(self, lens: Any, count: int) -> torch.Tensor:
        """`lens` as (N, 2) in the unit square, None: its middle."""
        if lens is None:
            return self.to_world.new_full((count, 2), 0.5)
        if not isinstance(lens, torch.Tensor):
            lens = torch.as_tensor(lens, device=self.to_world.device)
        if lens.shape != (count, 2) or lens.is_complex():
            raise ValueError(f"rays: lens: expected shape ({count}, 2) like positions, got {describe(lens)}")
        return lens.to(self.to_world)

    def values_of(self, *names: str) -> list[torch.Tensor]:
        return [getattr(self, name) for name in names]

    @property
    def world_to_camera(self) -> torch.Tensor:
        """(4, 4), the rows [R | t] and 0 0 0 1 of OpenCV's convention (+y down, +z forward); attached to `to_world`."""
        signs = self.to_world.new_tensor([-1.0, -1.0, 1.0, 1.0])
        return signs[:, None] * torch.linalg.inv(self.to_world)  # not a matrix product, which autocast would round


class LensCamera(Camera):
    """A camera with a field of view: its constructors from what people have, and the way back."""

    most: ClassVar[float] = 180.0  # degrees, above all fields of view
    scale: ClassVar[Callable[[torch.Tensor, float], torch.Tensor]] = staticmethod(scale_tangent)
    otherwise: ClassVar[str | None] = "50mm"

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        properties = super().prepare(properties, ctx)
        self.__dict__["_fov_axis"] = properties.get("fov_axis", "x")
        self._take_fov(properties, ctx, self.otherwise)
        return properties

    def _aspect(self) -> float:
        return self.film.width / self.film.height

    def _take_fov(self, properties: dict[str, Any], ctx: Context, otherwise: str | None = None) -> None:
        take_fov(self.type, properties, self._aspect(), ctx, self.most, type(self).scale, otherwise)

    def _assign_fov(self, **given: Any) -> None:
        properties, ctx = dict(given), Context(dtype=self._dtype(), path=(type(self).__name__,))
        self._take_fov(properties, ctx, "50mm" if "focal_length" in given else None)
        self.x_fov = properties["x_fov"]

    @property
    def fov_axis(self) -> str:
        """What `fov` is measured along: the word that the camera was made with."""
        return self.__dict__["_fov_axis"]

    @fov_axis.setter
    def fov_axis(self, value: Any) -> None:
        values.choice(value, FOV_AXES, Context(path=(type(self).__name__, "fov_axis")))
        self.__dict__["_fov_axis"] = value

    @property
    def fov(self) -> torch.Tensor:
        """Field of view in degrees along `fov_axis`; attached to `x_fov`, which assigning sets."""
        return type(self).scale(self.x_fov, 1 / along_x(self.fov_axis, self._aspect()))

    @fov.setter
    def fov(self, value: Any) -> None:
        self._assign_fov(fov=value, fov_axis=self.fov_axis)

    @classmethod
    def focal_of(cls, x_fov: torch.Tensor, width: int) -> torch.Tensor:
        """Focal length in pixels of a film of this width."""
        return width / (2 * torch.tan(torch.deg2rad(x_fov) / 2))

    @classmethod
    def fov_of(cls, focal: torch.Tensor, width: int) -> torch.Tensor:
        """The reverse."""
        return torch.rad2deg(2 * torch.atan(width / (2 * focal)))

    # ------------------------------------------------------------------------------------------- constructors
    @classmethod
    @batched(origin=1, target=1, up=1, fov=0)
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
    ) -> Self:
        """A camera at `origin` that looks at `target`.

        Args:
            origin, target, up: (3,) in world space; with a leading dimension (B, 3) of any of them, or of `fov`, a list
                of B cameras comes back, which `render` takes as `sensor`.
            fov: field of view in degrees along `fov_axis`.
            size: of the film (H, W).
            filter: name of a reconstruction filter, or one.
            properties: others that the class takes.
        """
        matrix = Transform.look_at(origin, target, up).matrix
        film = film_of(size, filter)
        precision = precision_of(cls, origin, target, up, fov)
        return cls(to_world=matrix, fov=fov, fov_axis=fov_axis, film=film, _context=precision, **properties)

    @classmethod
    @batched(K=2, R=2, t=1)
    @on_cpu
    def from_opencv(
        cls,
        K: Any,
        R: Any,
        t: Any,
        size: Sequence[int],
        distortion: Any = None,
        *,
        filter: str | ReconstructionFilter = "gaussian",
        **properties: Any,
    ) -> Self:
        """A camera in OpenCV's convention: x_camera = R x_world + t, looking along +z with +y down.

        With a leading dimension of `K`, `R` or `t` a list of cameras.

        Args:
            K: (3, 3) intrinsics in pixels, without skew. Pixel centres lie at +0.5.
            R: (3, 3) rotation, world to camera.
            t: (3,) translation.
            size: of the film (H, W).
            distortion: coefficients of the lens, as OpenCV has them: k1 k2 p1 p2 (k3 (k4 k5 k6)), of a fisheye lens
                k1 k2 k3 k4; (N,), (1, N) or (N, 1).
            properties: others that the class takes.

        Tensors keep their graph: gradients of an image reach K, R, t and the distortion.
        """
        name = f"{cls.__name__}.from_opencv"
        ctx = Context(path=(cls.__name__, "from_opencv"))
        height, width = film_size(size, ctx.at("size"))
        intrinsics = as_matrix(K, 3, f"{name}: K")
        rotation = as_matrix(R, 3, f"{name}: R")
        offset = values.vector(t, ctx.at("t")).double()
        fx, fy = intrinsics[0, 0], intrinsics[1, 1]
        _check_intrinsics(intrinsics.detach(), ctx.at("K"))
        # Our +x is left and +y up: both are turned around with respect to OpenCV's.
        flip = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
        to_world = _rigid(rotation.T @ flip, -(rotation.T @ offset))
        if float(torch.linalg.det(rotation.detach())) < 0:
            ctx.at("R").error("expected a rotation, got a reflection: its determinant is negative")
        if distortion is not None:
            shape = getattr(distortion, "shape", ())
            is_row = len(shape) == 2 and 1 in shape  # (1, N) or (N, 1), as cv2 returns it
            properties["distortion"] = distortion.reshape(-1) if is_row else distortion
        return cls(
            to_world=to_world,
            x_fov=cls.fov_of(fx, width),
            principal_point_offset_x=0.5 - intrinsics[0, 2] / width,
            principal_point_offset_y=0.5 - intrinsics[1, 2] / height,
            film=film_of((height, width), filter),
            pixel_aspect=fx / fy,
            _context=precision_of(cls, K, R, t, distortion),
            **properties,
        )

    @classmethod
    @batched(camera_to_world=2, fov=0)
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
    ) -> Self:
        """A camera in OpenGL's, Blender's and NeRF's convention: looking along -z with +y up and +x right.

        With a leading dimension of `camera_to_world` or `fov` a list of cameras.

        Args:
            camera_to_world: (4, 4) or (3, 4).
            fov: field of view in degrees along `fov_axis`.
            size: of the film (H, W).
        """
        ctx = Context(path=(cls.__name__, "from_opengl"))
        height, width = film_size(size, ctx.at("size"))
        matrix = camera_to_world if isinstance(camera_to_world, (torch.Tensor, Transform)) else None
        if matrix is None:
            matrix = values.floating(camera_to_world, Context(dtype=torch.float64, path=ctx.path))
        if isinstance(matrix, torch.Tensor) and matrix.shape == (3, 4):
            matrix = torch.cat([matrix.double(), torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])
        matrix = as_matrix(matrix, 4, f"{cls.__name__}.from_opengl: camera_to_world")
        flip = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64))
        film = film_of((height, width), filter)
        return cls(
            to_world=matrix @ flip,
            fov=fov,
            fov_axis=fov_axis,
            film=film,
            _context=precision_of(cls, camera_to_world, fov),
            **properties,
        )

    # ------------------------------------------------------------------------------------------- and back again
    @property
    def K(self) -> torch.Tensor:
        """Intrinsics (3, 3) in pixels of the whole film, as `from_opencv` takes them; attached to the parameters."""
        fx = self.focal_of(self.x_fov, self.film.width)
        cx = (0.5 - self.principal_point_offset_x) * self.film.width
        cy = (0.5 - self.principal_point_offset_y) * self.film.height
        zero, one = torch.zeros_like(fx), torch.ones_like(fx)
        return torch.stack([fx, zero, cx, zero, fx / self.pixel_aspect, cy, zero, zero, one]).reshape(3, 3)


class ProjectiveCamera(LensCamera):
    """A camera that sees straight lines as straight lines, but for its distortion."""

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["fov", "fov_axis", "focal_length", *super().parameter_names()]

    @property
    def focal_length(self) -> torch.Tensor:
        """In millimetres, of a frame of 36 x 24 mm; attached to `x_fov`. Assigning a number or ``"50mm"`` sets that."""
        diagonal = scale_tangent(self.x_fov, 1 / along_x("diagonal", self._aspect()))
        return FRAME_DIAGONAL / (2 * torch.tan(torch.deg2rad(diagonal) / 2))

    @focal_length.setter
    def focal_length(self, value: Any) -> None:
        self._assign_fov(focal_length=value)


LENS = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "near_clip", "far_clip",
        "pixel_aspect")  # fmt: skip


@register
class PerspectiveCamera(ProjectiveCamera):
    """A pinhole camera that looks along its +z axis, +y up, +x to the left.

    Args:
        to_world: 4x4 matrix, camera to world, without scaling.
        fov: field of view in degrees along `fov_axis` (``x``, ``y``, ``diagonal``, ``smaller``, ``larger``).
        focal_length: in place of `fov`: millimetres on a 36 x 24 mm frame, a number or ``"50mm"``, the default.
        near_clip, far_clip: planes in front of the camera between which surfaces are seen.
        principal_point_offset_x, principal_point_offset_y: fractions of the film's width and height by which the
            image moves left and up.
        distortion: coefficients of the lens in OpenCV's order, k1 k2 p1 p2 (k3 (k4 k5 k6)); fields of view and focal
            lengths are those without it. Where the lens shows nothing the image is black.
        film, sampler: dicts or objects.
        medium: the medium that the camera is in, if it is in one.
    """

    type = "perspective"
    # A pinhole is in focus everywhere; scenes written for lenses say a distance nevertheless.
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {**Camera.inert, "focus_distance": ()}

    def convert_tensor(self, field: Any, value: Any, ctx: Context) -> torch.Tensor:
        return coefficients(value, (4, 5, 8), 8, "k1 k2 p1 p2 (k3 (k4 k5 k6))", ctx)

    def required(self) -> dict[str, Any]:
        return {} if self.distortion is None else {"distortion": [0.0] * 8}

    def rays(self, positions: Any = None) -> Rays:
        """The rays of positions on the film, differentiable in pose, field of view, principal point and distortion.

        ``tr.ray_intersect(scene, *camera.rays(positions))`` is what the camera sees there.

        Args:
            positions: (N, 2) as (x, y) in pixels from the upper left corner of the whole film, x to the right and y
                down, pixel centres at +0.5. None: the centres of the pixels that are rendered, row by row.

        Returns:
            A named tuple of `origins` (N, 3) on the near plane, unit `directions` (N, 3) in world space, and `tmax`
            (N,), the distances to the far plane, which carry no gradient; 0 where the lens shows nothing.
        """
        size, at = (self.film.height, self.film.width), self.positions(positions)
        if self.distortion is None:
            return perspective_rays(*self.values_of(*LENS), size=size, positions=at)
        return distorted_rays(*self.values_of(*LENS, "distortion"), size=size, positions=at)


def coefficients(value: Any, lengths: tuple[int, ...], length: int, names: str, ctx: Context) -> torch.Tensor:
    """Coefficients of a lens, filled up with zeros; a string holds them separated by commas."""
    given = values.numbers(value, ctx) if isinstance(value, str) else value
    tensor = values.floating(given, ctx)
    if tensor.ndim != 1 or len(tensor) not in lengths:
        *some, last = map(str, lengths)
        counts = " or ".join([", ".join(some), last] if some else [last])
        ctx.error(f"expected {counts} coefficients ({names}), got {describe(value)}")
    if len(tensor) == length:
        return tensor.contiguous()
    return torch.cat([tensor, tensor.new_zeros(length - len(tensor))])


def precision_of(cls: type, *given: Any) -> Context:
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


def film_size(size: Any, ctx: Context) -> tuple[int, int]:
    """`size` as (height, width)."""
    try:
        height, width = size
    except (TypeError, ValueError):
        ctx.error(f"expected (height, width), got {describe(size)}")
    return values.integer(height, ctx, 1), values.integer(width, ctx, 1)


def film_of(size: Any, filter: str | ReconstructionFilter) -> Film:
    """A film of the size (H, W) with this reconstruction filter."""
    height, width = film_size(size, Context(path=("PerspectiveCamera", "size")))
    return Film(width, height, filter=ReconstructionFilter(filter) if isinstance(filter, str) else filter)
