"""Rotations as tensors that an optimiser can move freely: axis times angle, and two columns of a matrix.

Plain PyTorch, batched over leading dimensions, differentiable everywhere except where it is said.

    turn = torch.zeros(3, requires_grad=True)
    camera = tr.PerspectiveCamera.from_opencv(K, tr.rotation.so3_exp(turn) @ R, t, (480, 640))
"""

from __future__ import annotations

import torch

from .errors import describe


def so3_exp(rotation_vector: torch.Tensor) -> torch.Tensor:
    """Rotation matrices (..., 3, 3) about the axes `rotation_vector` (..., 3) by their lengths in radians.

    The exponential map of SO(3): smooth everywhere, also at zero, which is the identity.

    Raises:
        TypeError, ValueError: not a floating-point tensor (..., 3).
    """
    _check("so3_exp: rotation_vector", rotation_vector, (3,))
    return torch.linalg.matrix_exp(_cross_matrix(rotation_vector))


def so3_log(matrix: torch.Tensor) -> torch.Tensor:
    """Axis times angle (..., 3), angles from 0 to pi, of rotation matrices (..., 3, 3): the inverse of `so3_exp`.

    Differentiable; at pi the sign of the axis is arbitrary, and derivatives are those from one side.

    Raises:
        TypeError, ValueError: not a floating-point tensor (..., 3, 3).
    """
    _check("so3_log: matrix", matrix, (3, 3))
    # (R - R^T) / 2 = sin(a) [axis]; its length and the trace give the angle without loss of digits at either end, and
    # its direction the axis, but beyond right angles `_beyond_right_angle` has more digits of that.
    skew = torch.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        dim=-1,
    )
    skew = skew / 2
    square = (skew * skew).sum(-1)
    cosine = (matrix.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    small = square < torch.finfo(matrix.dtype).eps
    sine = torch.where(small, torch.ones_like(square), square).sqrt()
    angle = torch.atan2(sine, cosine)
    near_zero = 1 + square / 6  # a / sin(a) for small angles
    vector = skew * torch.where(small, near_zero, angle / sine)[..., None]
    wide = cosine < 0
    if not bool(wide.any()):
        return vector
    return torch.where(wide[..., None], _beyond_right_angle(matrix, skew, cosine), vector)


def _beyond_right_angle(matrix: torch.Tensor, skew: torch.Tensor, cosine: torch.Tensor) -> torch.Tensor:
    """Rotation vectors from the symmetric part of R, cos(a) 1 + (1 - cos(a)) axis axis^T."""
    identity = torch.eye(3, dtype=matrix.dtype, device=matrix.device)
    outer = (matrix + matrix.mT) / 2 - cosine[..., None, None] * identity
    column = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    axis = torch.take_along_dim(outer, column[..., None, None].expand(*column.shape, 3, 1), dim=-1)[..., 0]
    axis = torch.nn.functional.normalize(axis, dim=-1)
    # axis and -axis give the same product; sin(a) axis, which is what `skew` is, tells them apart
    axis = torch.where(((axis * skew).sum(-1) < 0)[..., None], -axis, axis)
    return axis * torch.atan2((axis * skew).sum(-1), cosine)[..., None]


def from_6d(columns: torch.Tensor) -> torch.Tensor:
    """Rotation matrices (..., 3, 3) from `columns` (..., 6): their first two columns, not yet orthonormal.

    Gram-Schmidt orthonormalisation; continuous over all rotations (Zhou, Barnes, Lu, Yang, Li, "On the Continuity of
    Rotation Representations in Neural Networks", 2019, eq. 15), which suits networks that predict one.

    Raises:
        TypeError, ValueError: not a floating-point tensor (..., 6).
    """
    _check("from_6d: columns", columns, (6,))
    first = torch.nn.functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:]
    second = torch.nn.functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def to_6d(matrix: torch.Tensor) -> torch.Tensor:
    """The first two columns (..., 6) of rotation matrices (..., 3, 3), which `from_6d` takes.

    Raises:
        TypeError, ValueError: not a floating-point tensor (..., 3, 3).
    """
    _check("to_6d: matrix", matrix, (3, 3))
    return torch.cat([matrix[..., 0], matrix[..., 1]], dim=-1)


def _cross_matrix(v: torch.Tensor) -> torch.Tensor:
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).reshape(*v.shape[:-1], 3, 3)


def _check(name: str, value: torch.Tensor, shape: tuple[int, ...]) -> None:
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name}: expected a floating-point tensor, got {describe(value)}")
    if value.shape[-len(shape) :] != shape:
        raise ValueError(f"{name}: expected shape (..., {', '.join(map(str, shape))}), got {tuple(value.shape)}")
