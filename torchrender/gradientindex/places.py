"""Cameras and lamps that are in a medium which bends light, where rays would have to begin bent."""

from __future__ import annotations

import torch

from ..errors import warn_once
from ..scene.native import NativeScene
from ..scene.packing import Layout, Record, record, records
from ..scene.scene import Scene
from .around import media_around

SOMEWHERE = (0.36, 0.48, 0.8)  # the direction of the rays that tell


def check_places(
    scene: Scene, layout: Layout, native: NativeScene, tensors: list[torch.Tensor], sensor: int, light: bool
) -> None:
    """ValueError for a camera in such a medium and, of light paths, for a lamp; a warning for lamps that nothing finds.

    `sensor`: the number of the one that is rendered.
    """
    camera = record(layout, "sensor", sensor)
    found = {camera.path: _translation(tensors, camera)} if "medium" in camera.field else {}
    points: set[str] = set()
    for shape in records(layout, "shape"):
        if light and shape.field["emitter"] >= 0 and shape.field["interior"] not in layout.bending:
            found[shape.path] = _point_of(tensors, shape)
    for lamp in records(layout, "emitter"):
        if lamp.type in ("point", "spot", "projector"):
            points.add(lamp.path)
            found[lamp.path] = tensors[lamp.field["position"]] if lamp.type == "point" else _translation(tensors, lamp)
    if not found:
        return
    at = torch.stack([point.detach().reshape(3) for point in found.values()])
    somewhere = at.new_tensor(SOMEWHERE).expand_as(at).contiguous()
    for path, around in zip(found, media_around(layout, native, tensors, at, somewhere), strict=True):
        if around is None:
            continue
        if path == camera.path:
            raise ValueError(
                f"render: {path}: the camera is in the gradientindex medium of {around}, where its rays would begin "
                "bent: put it outside; tr.gradientindex.trace follows rays that begin inside"
            )
        if light:
            raise ValueError(
                f"render: {path}: a lamp in the gradientindex medium of {around}, where light paths would begin "
                "bent: put it outside, or take PathTracer, which finds lamps inside that are surfaces"
            )
        if path in points:
            text = (
                f"{path} lights nothing: no path finds a point in the gradientindex medium of {around}; a small sphere "
                "with an area light is found"
            )
            warn_once(scene.warned, f"{path}: bent", text)


def _translation(tensors: list[torch.Tensor], described: Record) -> torch.Tensor:
    slot = described.field["to_world"]
    return tensors[slot][:3, 3] if slot >= 0 else tensors[0].new_zeros(3)


def _point_of(tensors: list[torch.Tensor], shape: Record) -> torch.Tensor:
    """A point of a shape, or of what it bounds."""
    for name in ("vertices", "control_points"):
        if name in shape.field:
            return tensors[shape.field[name]][0]
    place = shape.field["to_world"]
    own = next((tensors[shape.field[n]] for n in ("center", "p0") if shape.field.get(n, -1) >= 0), None)
    own = tensors[0].new_zeros(3) if own is None else own
    return own if place < 0 else tensors[place][:3, :3] @ own + tensors[place][:3, 3]
