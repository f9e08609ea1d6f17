"""Large steps: optimising a grid or a mesh through smooth changes.

A derivative by heights or vertices says how to move each of them alone; a step along it makes a surface rough. Nicolet,
Jacobson and Jakob ("Large Steps in Inverse Rendering of Geometry", ACM Transactions on Graphics 40(6), 2021) optimise
``u = (I + lambda L) x`` instead of x, where L is a Laplacian: a step along the derivative by u changes
x by ``(I + lambda L)^-2`` of the derivative by x, which is smooth, while every x can still be reached. To be used with
`UniformAdam`, whose steps keep the derivative's direction.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import torch

from ..errors import describe


def _checked_lambda(value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"lambda_: expected a number >= 0, got {describe(value)}")
    if not 0 <= value < math.inf:
        raise ValueError(f"lambda_: expected a number >= 0, got {value!r}")
    return float(value)


def _dct(x: torch.Tensor) -> torch.Tensor:
    """The discrete cosine transform of type II along the last axis, unnormalised, by one real FFT of equal length.

    J. Makhoul, "A Fast Cosine Transform in One and Two Dimensions", IEEE Trans. ASSP 28(1), 1980: even entries
    forwards, odd ones backwards, and a rotation of what the FFT makes of them.
    """
    n = x.shape[-1]
    spectrum = torch.fft.rfft(torch.cat([x[..., ::2], x[..., 1::2].flip(-1)], -1)) * _turn(n, -1, x)
    return torch.cat([spectrum.real, -spectrum.imag[..., 1 : (n + 1) // 2].flip(-1)], -1)


def _inverse_dct(x: torch.Tensor) -> torch.Tensor:
    """The inverse of :func:`_dct`."""
    n = x.shape[-1]
    half = n // 2 + 1
    imaginary = torch.cat([torch.zeros_like(x[..., :1]), -x[..., 1:].flip(-1)[..., : half - 1]], -1)
    ordered = torch.fft.irfft(torch.complex(x[..., :half], imaginary) * _turn(n, 1, x), n=n)
    result = torch.empty_like(ordered)
    result[..., ::2] = ordered[..., : (n + 1) // 2]
    result[..., 1::2] = ordered[..., (n + 1) // 2 :].flip(-1)
    return result


def _turn(n: int, sign: int, like: torch.Tensor) -> torch.Tensor:
    angle = sign * math.pi / (2 * n) * torch.arange(n // 2 + 1, dtype=torch.float64, device=like.device)
    return torch.polar(torch.ones_like(angle), angle).to(torch.promote_types(like.dtype, torch.complex64))


def _eigenvalues(n: int, like: torch.Tensor) -> torch.Tensor:
    """Of the Laplacian of n points in a row, whose eigenvectors are the cosines of the transform."""
    values = 2 - 2 * torch.cos(math.pi / n * torch.arange(n, dtype=torch.float64, device=like.device))
    return values.to(like.dtype)


def _solve_grid(x: torch.Tensor, lambda_: float, dims: int) -> torch.Tensor:
    """(I + lambda L)^-1 x over the first `dims` axes."""
    count = x.dim()
    divisor = torch.ones((), dtype=x.dtype, device=x.device)
    x = x.permute(*range(dims, count), *range(dims))  # channels first
    # Each transform turns the axes of the grid on by one, in memory, too: FFTs along strides are slow.
    for _ in range(dims):
        divisor = divisor.unsqueeze(-1) + lambda_ * _eigenvalues(x.shape[-1], x)
        x = _dct(x.contiguous()).movedim(-1, count - dims)
    x = x / divisor.permute(*reversed(range(dims)))
    for _ in range(dims):
        x = _inverse_dct(x.movedim(count - dims, -1).contiguous())
    return x.permute(*range(count - dims, count), *range(count - dims)).contiguous()


class _GridSolve(torch.autograd.Function):
    """The solve is linear and symmetric: it is its own adjoint, and nothing has to be kept for it."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, lambda_: float, dims: int) -> torch.Tensor:
        ctx.lambda_, ctx.dims = lambda_, dims
        return _solve_grid(x, lambda_, dims)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        return _GridSolve.apply(gradient, ctx.lambda_, ctx.dims), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor, *_: Any) -> torch.Tensor:
        return _GridSolve.apply(tangent, ctx.lambda_, ctx.dims)


class GridSmoothing:
    """Large steps for textures, height fields and volumes: ``u = (I + lambda L) x`` on a grid, and back.

    L is the Laplacian of the grid as a graph, ``(L x)_i = sum over neighbours j of (x_i - x_j)``, without neighbours
    beyond the border (reflecting boundary). Both directions are exact up to rounding, and differentiable in reverse and
    forward mode. The inverse takes one fast cosine transform an axis there and one back.

    Args:
        lambda_: how smooth, at least 0, in squared distances of neighbours: changes spread over about ``sqrt(lambda_)``
            entries. When a grid becomes twice as fine, four times as much means the same smoothness.
        dims: the number of leading axes that are the grid: 2 for (H, W) and (H, W, C), 3 for volumes (Z, Y, X, C).

    Example::

        smoothing = tr.optim.GridSmoothing(lambda_=30.0)
        u = smoothing.to_differential(heights).requires_grad_()
        optimizer = tr.optim.UniformAdam([u], lr=1e-3)
        ...
        image = tr.render(scene, params={"lens.heights": smoothing.from_differential(u)})

    Raises:
        TypeError, ValueError: for arguments other than these.
    """

    def __init__(self, lambda_: float, dims: int = 2) -> None:
        self.lambda_ = _checked_lambda(lambda_)
        if isinstance(dims, bool) or not isinstance(dims, int) or dims < 1:
            raise ValueError(f"dims: expected an integer of at least 1, got {dims!r}")
        self.dims = dims

    def __repr__(self) -> str:
        return f"GridSmoothing(lambda_={self.lambda_:g}, dims={self.dims})"

    def _checked(self, name: str, x: torch.Tensor) -> torch.Tensor:
        if not isinstance(x, torch.Tensor) or x.dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{name}: expected a tensor of float32 or float64, got {describe(x)}")
        if x.dim() < self.dims or 0 in x.shape:
            raise ValueError(f"{name}: expected at least {self.dims} axes, none empty, got shape {tuple(x.shape)}")
        return x

    def to_differential(self, x: torch.Tensor) -> torch.Tensor:
        """``(I + lambda L) x``, of the same shape as x: a grid, which channels may follow."""
        result = self._checked("x", x)
        for axis in range(self.dims):
            flow = self.lambda_ * x.diff(dim=axis)
            none = torch.zeros_like(x.narrow(axis, 0, 1))
            result = result + torch.cat([none, flow], axis) - torch.cat([flow, none], axis)
        return result

    def from_differential(self, u: torch.Tensor) -> torch.Tensor:
        """The x with ``(I + lambda L) x = u``, of the same shape as u."""
        return _GridSolve.apply(self._checked("u", u), self.lambda_, self.dims)


class _MeshSolve(torch.autograd.Function):
    """As `_GridSolve`, with a factorised matrix."""

    @staticmethod
    def forward(ctx: Any, u: torch.Tensor, factors: Any) -> torch.Tensor:
        ctx.factors = factors
        given = u.detach().reshape(len(u), -1).double().cpu().numpy()
        with _blas().limit(limits=1, user_api="blas"):
            values = factors.solve(given)
        return torch.from_numpy(np.ascontiguousarray(values)).to(u).reshape(u.shape)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor, None]:
        return _MeshSolve.apply(gradient, ctx.factors), None

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor, *_: Any) -> torch.Tensor:
        return _MeshSolve.apply(tangent, ctx.factors)


@functools.cache
def _blas() -> Any:
    """That of scipy, whose threads would wait busily for some milliseconds after each solution, in the way of ours."""
    import scipy.sparse.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _as_tensor(x: Any) -> Any:
    """An array as a tensor, of signed integers if it has integers; others as they are."""
    if not isinstance(x, np.ndarray):
        return x
    return torch.from_numpy(np.array(x, dtype=np.int64 if np.issubdtype(x.dtype, np.integer) else x.dtype))


class MeshSmoothing:
    """Large steps for meshes: ``u = (I + lambda L) x`` on vertices, and back.

    L is the Laplacian of the mesh as a graph, ``(L x)_i = sum over neighbours j of (x_i - x_j)``, which stays the same
    while vertices move: the matrix is factorised once, here, by scipy.

    Args:
        vertices: (V, 3) positions, a tensor or an array, of which only equality matters: vertices at the same place, as
            files have them along seams of texture coordinates, are treated as one. Or the number of vertices: none are
            joined.
        faces: (F, 3) integers, a tensor or an array.
        lambda_: how smooth, at least 0.

    Raises:
        TypeError, ValueError: for arguments other than these.
    """

    def __init__(
        self, vertices: torch.Tensor | np.ndarray | int, faces: torch.Tensor | np.ndarray, lambda_: float = 19.0
    ) -> None:
        self.lambda_ = _checked_lambda(lambda_)
        vertices, faces = _as_tensor(vertices), _as_tensor(faces)
        if isinstance(vertices, int) and not isinstance(vertices, bool):
            if vertices < 1:
                raise ValueError(f"vertices: expected at least 1, got {vertices}")
            shared = torch.arange(vertices)
        elif isinstance(vertices, torch.Tensor) and vertices.dim() == 2 and vertices.shape[1] == 3 and len(vertices):
            shared = torch.unique(vertices.detach().cpu(), dim=0, return_inverse=True)[1]
        else:
            raise TypeError(f"vertices: expected a tensor (V, 3) or the number of vertices, got {describe(vertices)}")
        if not isinstance(faces, torch.Tensor) or faces.dim() != 2 or faces.shape[1] != 3:
            raise TypeError(f"faces: expected a tensor (F, 3) of integers, got {describe(faces)}")
        if faces.is_floating_point() or faces.is_complex() or faces.dtype == torch.bool:
            raise TypeError(f"faces: expected integers, got {faces.dtype}")
        if faces.numel() and not 0 <= int(faces.min()) <= int(faces.max()) < len(shared):
            low, high = int(faces.min()), int(faces.max())
            raise ValueError(f"faces: expected vertices from 0 to {len(shared) - 1}, got {low} to {high}")
        self._shared = shared  # of each vertex: the number of its place
        self.count = int(shared.max()) + 1
        # The last vertex of each place, which stands for all of them.
        self._first = torch.zeros(self.count, dtype=torch.long).scatter_(0, shared, torch.arange(len(shared)))
        corners = shared[faces.detach().cpu().long()]
        edges = torch.cat([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).sort(1).values
        self._edges = torch.unique(edges[edges[:, 0] != edges[:, 1]], dim=0)
        self._factors = self._factorised()

    def _factorised(self) -> Any:
        from scipy.sparse import coo_matrix
        from scipy.sparse.linalg import splu

        i, j = self._edges.T.numpy()
        degree = np.bincount(np.concatenate([i, j]), minlength=self.count)
        diagonal = np.arange(self.count)
        values = np.concatenate([1 + self.lambda_ * degree, np.full(2 * len(i), -self.lambda_)])
        places = np.concatenate([diagonal, i, j]), np.concatenate([diagonal, j, i])
        matrix = coo_matrix((values, places), shape=(self.count, self.count)).tocsc()
        # Symmetric and diagonally dominant: no pivoting, and an ordering for symmetric matrices.
        with _blas().limit(limits=1, user_api="blas"):
            return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def __repr__(self) -> str:
        return f"MeshSmoothing(lambda_={self.lambda_:g}, {len(self._shared)} vertices at {self.count} places)"

    def _checked(self, name: str, x: torch.Tensor, count: int) -> torch.Tensor:
        if not isinstance(x, torch.Tensor) or not x.is_floating_point():
            raise TypeError(f"{name}: expected a floating-point tensor, got {describe(x)}")
        if x.dim() < 1 or len(x) != count or 0 in x.shape:
            raise ValueError(f"{name}: expected {count} rows, got shape {tuple(x.shape)}")
        return x

    def to_differential(self, x: torch.Tensor) -> torch.Tensor:
        """``(I + lambda L) x``: (V, ...) to (`count`, ...), a row for each place where there are vertices."""
        # `index_select`: the derivative of indexing adds in the order in which threads come
        x = self._checked("x", x, len(self._shared)).index_select(0, self._first.to(x.device))
        i, j = self._edges.T.to(x.device)
        flow = self.lambda_ * (x.index_select(0, i) - x.index_select(0, j))
        return x.index_add(0, i, flow).index_add(0, j, -flow)

    def from_differential(self, u: torch.Tensor) -> torch.Tensor:
        """The x with ``(I + lambda L) x = u``: (`count`, ...) to (V, ...)."""
        solved = _MeshSolve.apply(self._checked("u", u, self.count), self._factors)
        return solved if self.count == len(self._shared) else solved.index_select(0, self._shared.to(u.device))
