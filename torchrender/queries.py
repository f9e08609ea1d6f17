"""Batched ray queries, the building block for integrators written in PyTorch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch

from .compiling import opaque
from .errors import describe
from .functions import ConstantFunction
from .scene.gather import check_place, gather, has_derivative
from .scene.host_memory import results_at_the_scene
from .scene.native import NativeScene
from .scene.packing import Layout
from .scene.scene import Scene
from .scene.spectral.core_values import for_core
from .surface import Surfaces


class Hits(NamedTuple):
    """What rays hit; values are 0 at a miss where nothing else is stated. On curved shapes `barycentric` repeats `uv`.

    `t` (N,) is the distance in units of the direction's length, infinite at a miss; `position` (infinite at a miss),
    `normal` (geometric) and `shading_normal` are (N, 3), unit vectors in world space; `uv` and `barycentric` (N, 2);
    `shape_id` (position among the scene's shapes) and `prim_id`, the triangle, (N,) int32, -1 at a miss; `valid` (N,)
    bool.
    """

    t: torch.Tensor
    position: torch.Tensor
    normal: torch.Tensor
    shading_normal: torch.Tensor
    uv: torch.Tensor
    barycentric: torch.Tensor
    shape_id: torch.Tensor
    prim_id: torch.Tensor
    valid: torch.Tensor


CONTINUOUS = Hits._fields[:6]


@opaque
@results_at_the_scene
def ray_intersect(
    scene: Scene,
    origins: Any,
    directions: Any,
    tmax: Any = None,
    *,
    params: Mapping[str, torch.Tensor] | None = None,
) -> Hits:
    """The nearest surface along each ray, differentiable in the rays and in the scene's geometry.

    What a camera sees, lit from where it stands::

        rays = scene.sensors[0].rays()
        hits = tr.ray_intersect(scene, *rays)
        image = -(hits.shading_normal * rays.directions).sum(1)  # one number a pixel, 0 where nothing is hit

    Derivatives are those of the intersection with the triangle or curved shape that is hit: the point slides along the
    ray as the surface moves. That a ray may come to hit something else, at a silhouette, is no part of them. They exist
    with respect to origins, directions, vertices, normals, texture coordinates, `to_world`, centers, radii, heights and
    grids of distances;
    in reverse and forward mode, and of any order (height fields: up to the seventh). A ray that misses has
    derivatives of zero.

    Args:
        scene: where.
        origins, directions: (N, 3), world space, array-like; directions need not be normalised. Other dtypes than the
            scene's are converted, and their gradients converted back.
        tmax: longest distance in units of the direction's length, a number or (N,); infinite if omitted.
        params: tensors that replace parameters of these names in this call, as in `render`.

    Returns:
        A named tuple of tensors in the scene's dtype, see `Hits`.

    Raises:
        TypeError, ValueError: before any work, naming the argument, what was expected and what came.
    """
    scene, origins, directions, limits = _rays("ray_intersect", scene, origins, directions, tmax)
    layout = scene.layout()
    tensors = for_core(scene, layout, gather(scene, layout, params, "ray_intersect"))
    native = scene.native(layout, [tuple(t.shape) for t in tensors])
    hits = find_hits(native, tensors, origins, directions, limits)
    geometry = [tensors[i] for i in _geometry(layout)]
    if not any(has_derivative(t) for t in (origins, directions, *geometry)):
        return hits
    return attached(hits, Surfaces.of(scene, layout, tensors), origins, directions)


@opaque
@results_at_the_scene
def ray_occluded(
    scene: Scene,
    origins: Any,
    directions: Any,
    tmax: Any = None,
    *,
    params: Mapping[str, torch.Tensor] | None = None,
) -> torch.Tensor:
    """Whether anything lies along each ray, closer than `tmax`: (N,) bool. Arguments as for `ray_intersect`.

    The answer is piecewise constant and has no derivative; tensors that require gradients are accepted. Shadow rays
    start a little off the surface: at ``hits.position + 1e-4 * (1 + hits.position.abs().amax(1, True)) * hits.normal``.
    """
    scene, origins, directions, limits = _rays("ray_occluded", scene, origins, directions, tmax)
    layout = scene.layout()
    tensors = for_core(scene, layout, gather(scene, layout, params, "ray_occluded"))
    return _Occluded.apply(scene, layout, *_detached([origins, directions, limits, *tensors]))


class _Intersect(ConstantFunction):
    @staticmethod
    def forward(native: NativeScene, *tensors: torch.Tensor) -> Any:
        origins, directions, limits, *params = tensors
        return tuple(nearest_hits(native, params, origins, directions, limits))[:-1]


def find_hits(
    native: NativeScene,
    tensors: Sequence[torch.Tensor],
    origins: torch.Tensor,
    directions: torch.Tensor,
    limits: torch.Tensor,
) -> Hits:
    """What rays hit, without derivatives, also within `torch.func`; `tensors` for each of the layout's slots."""
    found = _Intersect.apply(native, *_detached([origins, directions, limits, *tensors]))
    return Hits(*found, valid=found[6] >= 0)


def attached(hits: Hits, surfaces: Surfaces, origins: torch.Tensor, directions: torch.Tensor) -> Hits:
    """The core's numbers with derivatives by rays and surfaces: values do not depend on whether those are asked for."""
    rows = hits.valid.nonzero()[:, 0]
    points = surfaces.meet(hits.shape_id[rows], hits.prim_id[rows], origins[rows], directions[rows], hits.t[rows])
    found = {}
    for name in CONTINUOUS:
        value, point = getattr(hits, name), getattr(points, name)
        found[name] = value.index_put((rows,), value[rows] + (point - point.detach()))
    return hits._replace(**found)


class _Occluded(ConstantFunction):
    @staticmethod
    def forward(scene: Scene, layout: Layout, *tensors: torch.Tensor) -> torch.Tensor:
        origins, directions, limits, *params = tensors
        native = scene.native(layout, [tuple(p.shape) for p in params])
        return occlusion(native, params, origins, directions, limits)


def nearest_hits(
    native: NativeScene,
    params: list[torch.Tensor],
    origins: torch.Tensor,
    directions: torch.Tensor,
    limits: torch.Tensor,
) -> Hits:
    """What the core finds along rays, of tensors that are as it takes them; without derivatives."""
    n, real = origins.shape[0], {"dtype": native.dtype, "device": "cpu"}
    whole = {"dtype": torch.int32, "device": "cpu"}
    out = {
        "t": torch.empty(n, **real),
        "position": torch.empty(n, 3, **real),
        "normal": torch.empty(n, 3, **real),
        "shading_normal": torch.empty(n, 3, **real),
        "uv": torch.empty(n, 2, **real),
        "b1": torch.empty(n, **real),
        "b2": torch.empty(n, **real),
        "shape_id": torch.empty(n, **whole),
        "prim_id": torch.empty(n, **whole),
    }
    dense = [t.contiguous() for t in (origins, directions, limits)]
    rays = [t.data_ptr() for t in dense]
    addresses = {name: tensor.data_ptr() for name, tensor in out.items()}
    native.call("ray_intersect", params, n, *rays, addresses, native.device())
    out["barycentric"] = torch.stack([out.pop("b1"), out.pop("b2")], dim=1)
    return Hits(**out, valid=out["shape_id"] >= 0)


def occlusion(
    native: NativeScene,
    params: list[torch.Tensor],
    origins: torch.Tensor,
    directions: torch.Tensor,
    limits: torch.Tensor,
) -> torch.Tensor:
    """Whether the core finds anything along rays, (N,) bool; see `nearest_hits`."""
    hit = torch.empty(origins.shape[0], dtype=torch.uint8, device="cpu")
    dense = [t.contiguous() for t in (origins, directions, limits)]
    rays = [t.data_ptr() for t in dense]
    native.call("ray_occluded", params, origins.shape[0], *rays, hit.data_ptr(), native.device())
    return hit.bool()


def _detached(tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    return [t.detach() for t in tensors]


def _geometry(layout: Layout) -> list[int]:
    """Slots of the parameters that say where surfaces are."""
    return [i for i, slot in enumerate(layout.slots) if slot.module.category == "shape"]


def _on_cpu(name: str, value: Any, scene: Scene, dtype: torch.dtype | None = None) -> torch.Tensor:
    """`value` as a tensor whose memory the core can read; what torch's default device is does not matter."""
    if not isinstance(value, torch.Tensor):
        return torch.as_tensor(value, dtype=dtype, device="cpu")
    check_place(scene, name, value)
    return value.to("cpu", dtype)


def _rays(function: str, scene: Any, origins: Any, directions: Any, tmax: Any) -> tuple[Any, ...]:
    if not isinstance(scene, Scene):
        raise TypeError(f"{function}: scene: expected a Scene, got {describe(scene)}")
    made = []
    for name, value in (("origins", origins), ("directions", directions)):
        tensor = _on_cpu(f"{function}: {name}", value, scene)
        if tensor.ndim != 2 or tensor.shape[1] != 3 or tensor.is_complex():
            raise ValueError(f"{function}: {name}: expected shape (N, 3), got {describe(tensor)}")
        made.append(tensor.to(scene.dtype).contiguous())
    if made[0].shape != made[1].shape:
        raise ValueError(
            f"{function}: origins have shape {tuple(made[0].shape)}, but directions {tuple(made[1].shape)}"
        )
    limit = _on_cpu(f"{function}: tmax", float("inf") if tmax is None else tmax, scene, scene.dtype).detach()
    if limit.ndim > 1 or (limit.ndim == 1 and limit.shape[0] != made[0].shape[0]):
        raise ValueError(f"{function}: tmax: expected a number or shape (N,), got {describe(limit)}")
    if bool(torch.isnan(limit).any()):
        raise ValueError(f"{function}: tmax: has values that are not numbers")
    return scene, made[0], made[1], limit.expand(made[0].shape[0]).contiguous()
