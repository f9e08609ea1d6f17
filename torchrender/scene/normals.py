"""Normals of meshes that follow from their positions, computed by the core."""

from __future__ import annotations

from typing import Any

import torch

from .. import backends


def vertex_normals(positions: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Normals (V, 3) of a mesh: face normals averaged with the corners' angles as weights (Thurmer, Wuthrich 1998).

    Vertices without a face, or where the average vanishes, get (1, 0, 0); faces without an area have no part in it.
    Neither has a derivative. All others have derivatives of any order, in reverse and forward mode.

    Args:
        positions: (V, 3), on the CPU in single or double precision, else it is computed by PyTorch.
        faces: (F, 3), indices of vertices.
    """
    if positions.device.type != "cpu" or positions.dtype not in (torch.float32, torch.float64):
        return by_torch(positions, faces)
    normals: torch.Tensor = _Normals.apply(positions, faces.to(torch.int32).contiguous())
    return normals


def by_torch(positions: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """The same by operations of PyTorch, three times slower: for its second derivatives, and for other devices."""
    # `index_select`: the derivative of indexing adds in the order in which threads come
    corners = positions.index_select(0, faces.long().flatten()).reshape(*faces.shape, 3)
    edges = corners.roll(-1, 1) - corners  # from each corner to the next
    product = torch.linalg.cross(edges[:, 0], edges[:, 1])
    some = (product != 0).any(1)  # a norm has no derivative at zero
    length = torch.linalg.vector_norm(torch.where(some[:, None], product, 1.0), dim=1)
    normal = torch.where(some[:, None], product / length[:, None], 0.0)
    along = -(edges * edges.roll(1, 1)).sum(2)
    angle = torch.atan2(length[:, None], torch.where(some[:, None], along, 0.0))
    given = normal[:, None] * angle[..., None]
    total = torch.zeros_like(positions).index_add(0, faces.long().flatten(), given.flatten(0, 1))
    there = (total != 0).any(1, keepdim=True)
    total = torch.where(there, total, torch.tensor([1.0, 0.0, 0.0], dtype=total.dtype, device=total.device))
    return total / torch.linalg.vector_norm(total, dim=1, keepdim=True)


class _Normals(torch.autograd.Function):
    @staticmethod
    def forward(positions: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
        return _computed("normals", positions, faces)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[torch.Tensor, torch.Tensor], output: torch.Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:
        return _Product.apply("vjp", grad, *ctx.saved_tensors), None

    @staticmethod
    def jvp(ctx: Any, tangent: torch.Tensor, _: None) -> torch.Tensor:
        product: torch.Tensor = _Product.apply("jvp", tangent, *ctx.saved_tensors)
        return product

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int, None], positions: torch.Tensor, faces: torch.Tensor) -> Any:
        return _one_by_one(lambda p: vertex_normals(p, faces), info, in_dims[:1], positions)


class _Product(torch.autograd.Function):
    """The product of the Jacobian, or its transpose, with a vector (V, 3)."""

    @staticmethod
    def forward(what: str, vector: torch.Tensor, positions: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
        return _computed(what, positions, faces, vector)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        ctx.what = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[Any, ...]:
        vector, positions, faces = ctx.saved_tensors
        pull = torch.func.vjp(lambda v, p: _product_by_torch(ctx.what, v, p, faces), vector, positions)[1]
        return (None, *pull(grad), None)

    @staticmethod
    def jvp(ctx: Any, _: None, vector_dot: Any, positions_dot: Any, __: None) -> torch.Tensor:
        vector, positions, faces = ctx.saved_tensors
        given = (vector, positions)
        tangents = [torch.zeros_like(x) if t is None else t for x, t in zip(given, (vector_dot, positions_dot))]
        return _pushed(lambda v, p: _product_by_torch(ctx.what, v, p, faces), given, tuple(tangents))

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], what: str, vector: Any, positions: Any, faces: Any) -> Any:
        return _one_by_one(lambda v, p: _Product.apply(what, v, p, faces), info, in_dims[1:3], vector, positions)


def _product_by_torch(what: str, vector: torch.Tensor, positions: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    def normals(p: torch.Tensor) -> torch.Tensor:
        return by_torch(p, faces)

    if what == "jvp":
        return _pushed(normals, (positions,), (vector,))
    pulled: torch.Tensor = torch.func.vjp(normals, positions)[1](vector)[0]
    return pulled


def _pushed(function: Any, at: tuple[torch.Tensor, ...], tangents: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """The product of a function's Jacobian with tangents, by reverse mode twice: PyTorch's forward mode cannot nest."""
    value, pull = torch.func.vjp(function, *at)[:2]
    pushed: torch.Tensor = torch.func.vjp(pull, torch.zeros_like(value))[1](tangents)[0]
    return pushed


def _computed(
    what: str, positions: torch.Tensor, faces: torch.Tensor, vector: torch.Tensor | None = None
) -> torch.Tensor:
    """The mesh's normals, or the product of their Jacobian, or its transpose, with a vector (V, 3)."""
    positions = positions.detach().contiguous()
    vector = positions if vector is None else vector.detach().to(positions.dtype).contiguous()
    result = torch.empty_like(positions)
    mesh = (positions.data_ptr(), positions.shape[0], faces.data_ptr(), faces.shape[0])
    dtype, threads = str(positions.dtype).removeprefix("torch."), torch.get_num_threads()
    backends.core().vertex_normals(what, dtype, *mesh, vector.data_ptr(), result.data_ptr(), threads)
    return result


def _one_by_one(function: Any, info: Any, in_dims: tuple[Any, ...], *batched: torch.Tensor) -> tuple[torch.Tensor, int]:
    """`function` for each of a batch."""
    rows = [
        t.movedim(d, 0) if d is not None else t.expand(info.batch_size, *t.shape)
        for t, d in zip(batched, in_dims, strict=True)
    ]
    return torch.stack([function(*row) for row in zip(*rows, strict=True)]), 0
