"""Sensors: functions of the world, the sensor's record, film size, film and lens positions (N, 2), to rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from ..scene import camera_rays
from ..scene.camera_rays import Rays

if TYPE_CHECKING:
    from ..scene.packing import Record
    from .world import World

LENS = "to_world x_fov principal_point_offset_x principal_point_offset_y near_clip far_clip pixel_aspect"
Sensor = Callable[["World", "Record", tuple[int, int], torch.Tensor, torch.Tensor], Rays]


def sensor(rays: Callable[..., Rays], names: str, lens: bool = False) -> Sensor:
    """A sensor whose rays are a function of these fields, of size and positions, and of those on a lens."""

    def trace(
        world: World, record: Record, size: tuple[int, int], positions: torch.Tensor, on_lens: torch.Tensor
    ) -> Rays:
        fields = [world.tensor("sensor", record, name) for name in names.split()]
        return rays(*fields, size, positions, *([on_lens] if lens else []))

    return trace


def perspective(
    world: World, record: Record, size: tuple[int, int], positions: torch.Tensor, on_lens: torch.Tensor
) -> Rays:
    """Rays of a pinhole camera, with or without distortion."""
    if record.field["distortion"] < 0:
        trace = sensor(camera_rays.perspective_rays, LENS)
    else:
        trace = sensor(camera_rays.distorted_rays, f"{LENS} distortion")
    return trace(world, record, size, positions, on_lens)


def radiancemeter(
    world: World, record: Record, size: tuple[int, int], positions: torch.Tensor, on_lens: torch.Tensor
) -> Rays:
    """The one ray of a radiance meter."""
    return camera_rays.radiancemeter_rays(world.tensor("sensor", record, "to_world"), len(positions))


def distant(
    world: World, record: Record, size: tuple[int, int], positions: torch.Tensor, on_lens: torch.Tensor
) -> Rays:
    """Parallel rays, or rays through one target, from outside of the scene."""
    target = world.tensor("sensor", record, "target") if record.field["target"] >= 0 else None
    to_world = world.tensor("sensor", record, "to_world")
    bounds = world.scene.bounding_box().detach().float().to(to_world.dtype)  # as the ray queries know it
    return camera_rays.distant_rays(to_world, target, bounds, on_lens)


PLANES = "to_world near_clip far_clip"
SENSORS: dict[str, Sensor] = {
    "perspective": perspective,
    "thinlens": sensor(camera_rays.thinlens_rays, f"{LENS} aperture_radius focus_distance", lens=True),
    "orthographic": sensor(camera_rays.orthographic_rays, PLANES),
    "fisheye": sensor(camera_rays.fisheye_rays, f"{LENS} distortion max_angle"),
    "panorama": sensor(camera_rays.panorama_rays, PLANES),
    "radiancemeter": radiancemeter,
    "distant": distant,
}
