"""Affine transforms of three-dimensional space as 4x4 matrices.

A `Transform` acts on column vectors: ``(A @ B)`` applies `B` first. Angles are degrees, lengths are scene units.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from .errors import describe


def on_cpu(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: what `function` makes without naming a device lies on the CPU, whatever torch's default is."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with torch.device("cpu"):
            return function(*args, **kwargs)

    return call


class _Chainable:
    """A constructor of transforms that works on the class and, chained, on an instance.

    ``Transform.translate([0, 1, 0])`` is a new transform, ``T.translate([0, 1, 0])`` is ``T @`` that.
    """

    def __init__(self, function: Callable[..., torch.Tensor]) -> None:
        self.function = function
        self.__doc__ = function.__doc__

    def __get__(self, instance: Transform | None, owner: type[Transform]) -> Callable[..., Transform]:
        @on_cpu
        def make(*args: Any, **kwargs: Any) -> Transform:
            made = owner(self.function(*args, **kwargs))
            return made if instance is None else instance @ made

        make.__doc__ = self.__doc__
        make.__name__ = self.function.__name__
        return make


def _vector(value: Any, name: str, broadcast: bool = False) -> torch.Tensor:
    try:
        tensor = torch.as_tensor(plain(value), dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name}: expected three numbers, got {describe(value)}") from None
    if broadcast and tensor.ndim == 0:
        tensor = tensor.expand(3)
    if tensor.shape != (3,):
        raise ValueError(f"{name}: expected three numbers, got {describe(value)}")
    return tensor


class Transform:
    """A 4x4 matrix in float64, row-major, acting on column vectors.

    Args:
        matrix: (4, 4) array-like: torch, NumPy, nested lists or another `Transform`; identity if omitted. A tensor
            that carries gradients keeps them.
    """

    def __init__(self, matrix: Any = None) -> None:
        self.matrix = (
            torch.eye(4, dtype=torch.float64, device="cpu") if matrix is None else as_matrix(matrix, 4, "Transform")
        )

    def __matmul__(self, other: Any) -> Transform:
        return Transform(self.matrix @ as_matrix(other, 4, "Transform @"))

    def __repr__(self) -> str:
        rows = ", ".join("[" + ", ".join(f"{x:.6g}" for x in row) + "]" for row in self.matrix.tolist())
        return f"Transform([{rows}])"

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        array = self.matrix.detach().numpy()
        return array if dtype is None else array.astype(dtype)

    def inverse(self) -> Transform:
        """The inverse transform; ValueError if the matrix is singular."""
        matrix, info = torch.linalg.inv_ex(self.matrix)
        if int(info) != 0:
            raise ValueError("Transform.inverse: the matrix is singular")
        return Transform(matrix)

    def transform_points(self, points: Any) -> torch.Tensor:
        """Images of `points` (..., 3), divided by the homogeneous coordinate."""
        points = torch.as_tensor(plain(points), dtype=torch.float64)
        out = points @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        w = points @ self.matrix[3, :3] + self.matrix[3, 3]
        return out / w[..., None]

    def transform_normals(self, normals: Any) -> torch.Tensor:
        """Images of the normals (..., 3), by the inverse transpose, normalised."""
        normals = torch.as_tensor(plain(normals), dtype=torch.float64)
        out = normals @ torch.linalg.inv(self.matrix[:3, :3])
        return torch.nn.functional.normalize(out, dim=-1)

    @_Chainable
    def translate(offset: Any) -> torch.Tensor:
        """Translation by `offset` (3,)."""
        offset = _vector(offset, "Transform.translate")
        top = torch.cat([torch.eye(3, dtype=torch.float64), offset[:, None]], dim=1)
        return torch.cat([top, torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])

    @_Chainable
    def scale(factor: Any) -> torch.Tensor:
        """Scaling by one number or by three."""
        factor = _vector(factor, "Transform.scale", broadcast=True)
        return torch.diag(torch.cat([factor, torch.ones(1, dtype=torch.float64)]))

    @_Chainable
    def rotate(axis: Any, angle: float) -> torch.Tensor:
        """Rotation about `axis` (3,), any length, by `angle` degrees, counter-clockwise seen from the axis' tip."""
        axis = _vector(axis, "Transform.rotate: axis")
        length = torch.linalg.vector_norm(axis)
        if not float(length.detach()) > 0:
            raise ValueError("Transform.rotate: the axis has no length")
        x, y, z = axis / length
        radians = torch.as_tensor(plain(angle), dtype=torch.float64) * (math.pi / 180)
        zero = torch.zeros((), dtype=torch.float64)
        # Rodrigues' formula: R = I + sin(a) K + (1 - cos(a)) K^2
        cross = torch.stack([torch.stack([zero, -z, y]), torch.stack([z, zero, -x]), torch.stack([-y, x, zero])])
        rotation = torch.eye(3, dtype=torch.float64) + torch.sin(radians) * cross
        rotation = rotation + (1 - torch.cos(radians)) * (cross @ cross)
        return _homogeneous(rotation, torch.zeros(3, dtype=torch.float64))

    @_Chainable
    def look_at(origin: Any, target: Any, up: Any = (0.0, 1.0, 0.0)) -> torch.Tensor:
        """Camera to world: the camera stands at `origin`, looks along +z at `target`, its +y is nearest to `up`."""
        origin = _vector(origin, "Transform.look_at: origin")
        target = _vector(target, "Transform.look_at: target")
        up = _vector(up, "Transform.look_at: up")
        forward = target - origin
        if not float(torch.linalg.vector_norm(forward.detach())) > 0:
            raise ValueError("Transform.look_at: origin and target are the same point")
        forward = forward / torch.linalg.vector_norm(forward)
        left = torch.linalg.cross(up, forward)
        if not float(torch.linalg.vector_norm(left.detach())) > 1e-12:
            raise ValueError("Transform.look_at: up is parallel to the viewing direction")
        left = left / torch.linalg.vector_norm(left)
        return _homogeneous(torch.stack([left, torch.linalg.cross(forward, left), forward], dim=1), origin)


def _homogeneous(linear: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    top = torch.cat([linear, offset[:, None]], dim=1)
    return torch.cat([top, torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])


def as_matrix(value: Any, size: int, name: str) -> torch.Tensor:
    """`value` as a finite (size, size) tensor in float64, keeping its gradient.

    Accepts a `Transform`, tensors, arrays, nested sequences and flat sequences of size*size numbers. With ``size=3``
    (texture coordinates) a 4x4 matrix is accepted too: rows and columns 0, 1 and 3 hold the planar affine map.
    """
    if isinstance(value, Transform):
        matrix = value.matrix
    elif isinstance(value, torch.Tensor):
        matrix = value.to(torch.float64)
    else:
        inner = getattr(value, "matrix", value)  # objects of other libraries that wrap a matrix
        try:
            with torch.device("cpu"):
                matrix = torch.as_tensor(plain(inner), dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError):
            raise ValueError(f"{name}: expected a {size}x{size} matrix, got {describe(value)}") from None
    if matrix.ndim == 1 and matrix.numel() in (9, 16):
        matrix = matrix.reshape(3, 3) if matrix.numel() == 9 else matrix.reshape(4, 4)
    if size == 3 and matrix.shape == (4, 4):
        keep = torch.tensor([0, 1, 3])
        matrix = matrix[keep][:, keep]
    if matrix.shape != (size, size):
        hint = "; a place is tr.Transform.translate([x, y, z])" if matrix.shape == (3,) and size == 4 else ""
        raise ValueError(f"{name}: expected a {size}x{size} matrix, got {describe(value)}{hint}")
    if not bool(torch.isfinite(matrix.detach()).all()):
        raise ValueError(f"{name}: the matrix has entries that are not finite")
    return matrix


def plain(value: Any) -> Any:
    """What people write for numbers as what `torch.as_tensor` takes, silently.

    Numbers of Python, NumPy and torch, arrays, tensors with and without dimensions, and nested sequences of all these.
    """
    if isinstance(value, torch.Tensor):
        return value
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        parts = [plain(v) for v in value]
        if any(isinstance(p, torch.Tensor) for p in parts):  # numbers among which some may carry gradients
            return torch.stack([torch.as_tensor(p, dtype=torch.float64) for p in parts])
        return np.stack(parts) if any(isinstance(p, np.ndarray) for p in parts) else parts
    if hasattr(value, "__array__"):
        array = np.array(value, dtype="float64")  # a copy: torch warns about read-only arrays
        return array if array.ndim else array.item()  # NumPy's numbers are arrays, too
    return value


def single(value: Any) -> Any:
    """A number or truth value of NumPy or torch as one of Python; whatever else as it is."""
    shape = getattr(value, "shape", None)
    return value.item() if shape is not None and tuple(shape) in ((), (1,)) else value


def is_whole(number: Any) -> bool:
    """Whether what `single` gives is an integer, also one written as a float; booleans are none."""
    if isinstance(number, bool):
        return False
    return hasattr(number, "__index__") or (isinstance(number, float) and number.is_integer())
