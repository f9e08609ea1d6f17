"""Sensors: functions of the world, the sensor's record, film size and film positions (N, 2), to rays."""

from __future__ import annotations

from collections.abc import Callable

import torch

from torchrender.scene.camera import Rays, perspective_rays

from .world import Record, World


def perspective(world: World, record: Record, size: tuple[int, int], positions: torch.Tensor) -> Rays:
    names = "to_world x_fov principal_point_offset_x principal_point_offset_y near_clip far_clip pixel_aspect".split()
    return perspective_rays(*(world.tensor("sensor", record, n) for n in names), size, positions)


SENSORS: dict[str, Callable[[World, Record, tuple[int, int], torch.Tensor], Rays]] = {"perspective": perspective}
