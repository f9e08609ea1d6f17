"""Batched ray queries, the building block for integrators written in PyTorch."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import torch

from .errors import NotDifferentiableError, describe
from .scene.gather import gather
from .scene.scene import Scene

Hits = namedtuple("Hits", "t position normal shading_normal uv barycentric shape_id prim_id valid")
Hits.__doc__ = """What rays hit: `t` (N,) distance in units of the direction's length, infinite at a miss; `position`,
`normal` (geometric), `shading_normal` (N, 3); `uv`, `barycentric` (N, 2); `shape_id` (position among the scene's
shapes) and `prim_id` (N,) int32, -1 at a miss; `valid` (N,) bool."""


def ray_intersect(scene: Scene, origins: Any, directions: Any, tmax: Any = None) -> Hits:
    """The nearest surface along each ray.

    Args:
        scene: where.
        origins, directions: (N, 3), world space; directions need not be normalised.
        tmax: longest distance, a number or (N,); infinite if omitted.

    Returns:
        A named tuple of tensors, see `Hits`. Values carry no gradient in this version.
    """
    origins, directions, limits = _rays("ray_intersect", scene, origins, directions, tmax)
    n = origins.shape[0]
    real = {"dtype": scene.dtype}
    out = {
        "t": torch.empty(n, **real),
        "position": torch.empty(n, 3, **real),
        "normal": torch.empty(n, 3, **real),
        "shading_normal": torch.empty(n, 3, **real),
        "uv": torch.empty(n, 2, **real),
        "b1": torch.empty(n, **real),
        "b2": torch.empty(n, **real),
        "shape_id": torch.empty(n, dtype=torch.int32),
        "prim_id": torch.empty(n, dtype=torch.int32),
    }
    addresses = {name: tensor.data_ptr() for name, tensor in out.items()}
    _query(scene, "ray_intersect", n, origins, directions, limits, addresses)
    barycentric = torch.stack([out.pop("b1"), out.pop("b2")], dim=1)
    return Hits(**out, barycentric=barycentric, valid=out["shape_id"] >= 0)


def ray_occluded(scene: Scene, origins: Any, directions: Any, tmax: Any = None) -> torch.Tensor:
    """Whether anything lies along each ray, closer than `tmax`: (N,) bool. Arguments as for `ray_intersect`."""
    origins, directions, limits = _rays("ray_occluded", scene, origins, directions, tmax)
    hit = torch.empty(origins.shape[0], dtype=torch.uint8)
    _query(scene, "ray_occluded", origins.shape[0], origins, directions, limits, hit.data_ptr())
    return hit.bool()


def _query(scene: Scene, function: str, n: int, origins: Any, directions: Any, limits: Any, out: Any) -> None:
    layout = scene.layout()
    params = [t.detach() for t in gather(scene, layout, None)]
    native = scene.native(layout, [tuple(t.shape) for t in params])
    native.call(function, params, n, origins.data_ptr(), directions.data_ptr(), limits.data_ptr(), out)


def _rays(function: str, scene: Any, origins: Any, directions: Any, tmax: Any) -> tuple[torch.Tensor, ...]:
    if not isinstance(scene, Scene):
        raise TypeError(f"{function}: scene: expected a Scene, got {describe(scene)}")
    made = []
    for name, value in (("origins", origins), ("directions", directions)):
        tensor = torch.as_tensor(value)
        if tensor.ndim != 2 or tensor.shape[1] != 3 or tensor.is_complex():
            raise ValueError(f"{function}: {name}: expected shape (N, 3), got {describe(tensor)}")
        if tensor.requires_grad and torch.is_grad_enabled():
            raise NotDifferentiableError(f"{function}: {name}: queries have no derivatives in this version")
        made.append(tensor.detach().to(scene.dtype).contiguous())
    if made[0].shape != made[1].shape:
        raise ValueError(
            f"{function}: origins have shape {tuple(made[0].shape)}, but directions {tuple(made[1].shape)}"
        )
    limit = torch.as_tensor(float("inf") if tmax is None else tmax, dtype=scene.dtype).detach()
    if limit.ndim > 1 or (limit.ndim == 1 and limit.shape[0] != made[0].shape[0]):
        raise ValueError(f"{function}: tmax: expected a number or shape (N,), got {describe(limit)}")
    if bool(torch.isnan(limit).any()):
        raise ValueError(f"{function}: tmax: has values that are not numbers")
    return made[0], made[1], limit.expand(made[0].shape[0]).contiguous()
