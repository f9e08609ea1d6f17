"""The argument `sensor` of `render`: which of the packed sensors is rendered, and for which camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, SupportsIndex

import numpy as np
import torch

from .errors import describe, nearest
from .scene.packing import Layout
from .scene.scene import Scene
from .scene.sensor import IrradianceMeter, Sensor


def layout_with_room(scene: Scene, sensor: Any) -> Layout:
    """The scene's layout, with room for cameras that are no part of it."""
    for item in sensor if isinstance(sensor, Sequence) and not isinstance(sensor, str) else [sensor]:
        if isinstance(item, Sensor) and not isinstance(item, IrradianceMeter):
            scene.admit(item)
    return scene.layout()


def chosen_sensors(packed: Layout, sensor: Any, one_size: bool = True) -> tuple[list[tuple[int, Sensor]], bool]:
    """Pairs of index and camera; further indices of the packed sensors stand for cameras outside of the scene.

    ValueError for films that have not `one_size`, if they have to have it.
    """
    if isinstance(sensor, (torch.Tensor, np.ndarray)) and sensor.ndim == 1:
        sensor = sensor.tolist()
    batched = isinstance(sensor, Sequence) and not isinstance(sensor, str)
    chosen = list(sensor) if batched else [sensor]
    if not chosen:
        raise ValueError("render: sensor: an empty list")
    own = packed.sensors[: packed.own_sensors]
    names = [path for _, _, path in packed.objects["sensor"][: packed.own_sensors]]
    found: list[tuple[int, Sensor]] = []
    for item in chosen:
        if isinstance(item, Sensor):
            index = next((i for i, camera in enumerate(own) if camera is item), len(own))
            if index == len(own):
                if isinstance(item, IrradianceMeter):
                    raise ValueError(
                        f"render: sensor: {describe(item)} has to be one of the scene's: scene['meter'] = ..."
                    )
                while packed.sensors[index].kind() != item.kind():
                    index += 1
            found.append((index, item))
            continue
        if isinstance(item, str):
            if item not in names:
                raise ValueError(f"render: sensor: the scene has no camera {item!r}; {nearest(item, names)}")
            item = names.index(item)
        if isinstance(item, bool) or not isinstance(item, SupportsIndex) or getattr(item, "ndim", 0):
            raise TypeError(f"render: sensor: expected an index, a name or a camera, got {describe(item)}")
        index = item.__index__()
        if not own:
            raise ValueError(
                "render: sensor: the scene has no camera; pass one, such as PerspectiveCamera.look_at(...)"
            )
        if not -len(own) <= index < len(own):
            count = "1 camera" if len(own) == 1 else f"{len(own)} cameras"
            raise ValueError(f"render: sensor: index {index}, but the scene has {count}")
        found.append((index % len(own), own[index]))
    sizes = {camera.film.window[2:] for _, camera in found}
    if one_size and len(sizes) > 1:
        raise ValueError(
            f"render: sensor: films of one size are needed in a list, got {sorted(sizes)} (rows, columns); size=(H, W) "
            "gives them one, or render them one by one"
        )
    return found, batched
