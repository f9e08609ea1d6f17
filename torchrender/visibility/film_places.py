"""Where on the film of a camera a point is seen: the inverses of the maps in scene/camera_rays.py."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from ..scene.camera_rays import distort, fisheye_angle, on_disk
from ..surface import inverse_linear, transform_vector

if TYPE_CHECKING:
    from ..wavefront.world import Record, World

Place = tuple[torch.Tensor, torch.Tensor]
Get = Callable[[str], torch.Tensor]


def film_places(
    world: World, sensor: int, size: tuple[int, int], points: torch.Tensor, lens: torch.Tensor
) -> torch.Tensor:
    """Places (N, 2), x and y in pixels, of points (N, 3) seen through places on the lens (N, 2); NaN behind it.

    A lens that distorts may show nothing there, or another point: `World.camera_rays` decides.
    """
    record = world.records["sensor"][sensor]

    def get(name: str) -> torch.Tensor:
        return world.tensor("sensor", record, name).detach()

    to_world = get("to_world")
    local = transform_vector(inverse_linear(to_world), points - to_world[:3, 3])
    x, y = SENSORS[record.type](record, get, size, local, lens)
    return torch.stack([x, y], 1)


def _from_slopes(get: Get, size: tuple[int, int], half_width: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> Place:
    """The inverse of `camera_rays.film_slopes`."""
    height, width = size
    half_height = half_width * get("pixel_aspect") * (height / width)
    return (
        width * ((1 - x / half_width) / 2 - get("principal_point_offset_x")),
        height * ((1 - y / half_height) / 2 - get("principal_point_offset_y")),
    )


def _in_front(z: torch.Tensor) -> torch.Tensor:
    return torch.where(z > 0, z, torch.nan)


def _perspective(record: Record, get: Get, size: tuple[int, int], p: torch.Tensor, _lens: torch.Tensor) -> Place:
    z = _in_front(p[:, 2])
    x, y = p[:, 0] / z, p[:, 1] / z
    if record.field["distortion"] >= 0:
        x, y = distort(get("distortion"), -x, -y)
        x, y = -x, -y
    return _from_slopes(get, size, torch.tan(get("x_fov") * (math.pi / 360)), x, y)


def _thinlens(_record: Record, get: Get, size: tuple[int, int], p: torch.Tensor, lens: torch.Tensor) -> Place:
    origin = on_disk(lens) * get("aperture_radius")
    focus = get("focus_distance")
    at = origin + (p[:, :2] - origin) * (focus / _in_front(p[:, 2]))[:, None]
    return _from_slopes(get, size, torch.tan(get("x_fov") * (math.pi / 360)), at[:, 0] / focus, at[:, 1] / focus)


def _orthographic(_record: Record, _get: Get, size: tuple[int, int], p: torch.Tensor, _lens: torch.Tensor) -> Place:
    height, width = size
    return width * (1 - p[:, 0]) / 2, height * (1 - p[:, 1] * (width / height)) / 2


def _fisheye(_record: Record, get: Get, size: tuple[int, int], p: torch.Tensor, _lens: torch.Tensor) -> Place:
    r = torch.linalg.vector_norm(p[:, :2], dim=1)
    theta = torch.atan2(r, p[:, 2])
    scale = fisheye_angle(get("distortion"), theta) / torch.where(r > 0, r, 1.0)
    return _from_slopes(get, size, get("x_fov") * (math.pi / 360), p[:, 0] * scale, p[:, 1] * scale)


def _panorama(_record: Record, _get: Get, size: tuple[int, int], p: torch.Tensor, _lens: torch.Tensor) -> Place:
    height, width = size
    theta = torch.atan2(torch.linalg.vector_norm(p[:, [0, 2]], dim=1), p[:, 1])
    phi = torch.atan2(-p[:, 0], p[:, 2])
    return width * (phi / (2 * math.pi) + 0.5), height * theta / math.pi


SENSORS: dict[str, Callable[[Record, Get, tuple[int, int], torch.Tensor, torch.Tensor], Place]] = {
    "perspective": _perspective,
    "thinlens": _thinlens,
    "orthographic": _orthographic,
    "fisheye": _fisheye,
    "panorama": _panorama,
}
