"""The tensors of one call, one for each slot of a packed scene."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping

import torch
from torch import nn

from ..errors import describe, nearest
from .bending_field import bending_field
from .host_memory import on_host
from .packing import Layout, record
from .plugin import Plugin
from .residence import FEW
from .scene import Scene
from .values import has_derivative


def gather(
    scene: Scene,
    layout: Layout,
    params: Mapping[str, torch.Tensor] | None,
    function: str = "render",
    staying: Container[int] = (),
) -> list[torch.Tensor]:
    """The tensors of all slots in the scene's dtype, dense; `params` replaces some of them by name.

    They are on the CPU, but large ones of the slots `staying`. `function` is who asks, for messages.
    """
    if scene.dtype not in (torch.float32, torch.float64):
        raise TypeError(
            f"{function}: scene: float32 and float64 are rendered, but it is {scene.dtype}: use scene.float()"
        )
    replaced: dict[int, torch.Tensor] = {}
    if params:
        if not isinstance(params, Mapping):
            raise TypeError(f"{function}: params: expected a mapping from names to tensors, got {describe(params)}")
        for name, tensor in params.items():
            if not isinstance(name, str):
                raise TypeError(f"{function}: params: expected names of parameters, got {describe(name)}")
            index = layout.index_of(name)
            if index is None:
                raise ValueError(
                    f"{function}: params: the scene has no parameter {name!r}; {nearest(name, layout.by_name)}"
                )
            if not isinstance(tensor, torch.Tensor):
                raise TypeError(f"{function}: params: {name}: expected a tensor, got {describe(tensor)}")
            if tensor.layout is not torch.strided:
                raise TypeError(f"{function}: params: {name}: expected a dense tensor, got layout {tensor.layout}")
            if not tensor.is_floating_point():
                raise TypeError(f"{function}: params: {name}: expected floating-point numbers, got {describe(tensor)}")
            layout.slots[index].check_shape(tensor, f"{function}: params: {name}")
            if index in replaced:
                raise ValueError(f"{function}: params: {name}: the parameter {layout.slots[index].name!r}, given twice")
            replaced[index] = tensor
    tensors = [replaced[i] if i in replaced else slot.tensor() for i, slot in enumerate(layout.slots)]
    dtype = scene.dtype
    for i, tensor in enumerate(tensors):
        if not (tensor.is_cpu and tensor.dtype == dtype and tensor.is_contiguous()):  # most are, and there are many
            tensors[i] = _dense(scene, layout.slots[i].name, tensor, i in staying)
    for mesh in layout.smooth_meshes:
        positions = layout.slot_of[id(mesh), "vertex_positions"]
        normals = layout.slot_of.get((id(mesh), "vertex_normals"))
        if normals is None or normals in replaced:
            continue
        own = mesh._parameters.get("vertex_positions") if positions not in replaced else None
        if isinstance(own, nn.Parameter) and not has_derivative(own):
            mesh.refresh_normals()
            tensors[normals] = _dense(scene, layout.slots[normals].name, layout.slots[normals].tensor())
            continue
        computed = mesh.normals_from_positions(tensors[positions])
        if isinstance(own, nn.Parameter):
            mesh.refresh_normals(computed)
        if has_derivative(tensors[normals]):  # asked for by itself: a change on top of what follows from the positions
            computed = computed + (tensors[normals] - tensors[normals].detach())
        tensors[normals] = _dense(scene, "normals", computed)
    for field in (record(layout, "medium", number).field for number in layout.bending):
        index = field["index"]
        tensors[index] = bending_field(tensors[index], tensors[field["index_base"]], tensors[field["index_scale"]])
    return tensors


def replace_placeholder(
    scene: Scene,
    layout: Layout,
    tensors: list[torch.Tensor],
    placeholder: Plugin,
    camera: Plugin,
    replicated: Callable[[list[torch.Tensor]], list[torch.Tensor]],
) -> list[torch.Tensor]:
    """`tensors` with those of a `camera` that is no part of the scene, in the place of its `placeholder`.

    `replicated`: see `torchrender.shares.Share`.
    """
    changed = list(tensors)
    slots = layout.camera_slots(placeholder)
    found = replicated([_dense(scene, f"camera.{attribute}", getattr(camera, attribute)) for attribute in slots])
    for index, tensor in zip(slots.values(), found, strict=True):
        changed[index] = tensor
    return changed


def check_place(scene: Scene, name: str, tensor: torch.Tensor) -> None:
    """ValueError for a tensor that lies neither on the CPU nor with the scene, or has no numbers."""
    place = tensor.device
    if place.type != "cpu" and (place.type == "meta" or place != scene.device):
        where = "" if place == scene.device else f", but the scene on {scene.device}"
        better = "cpu" if scene.device.type == "meta" else scene.device
        raise ValueError(f"{name}: lies on {place}{where}: use .to({str(better)!r})")


def _dense(scene: Scene, name: str, tensor: torch.Tensor, stays: bool = False) -> torch.Tensor:
    if not tensor.is_cpu:
        check_place(scene, name, tensor)
        if not stays or tensor.numel() <= FEW:
            tensor = on_host(tensor)
    if tensor.dtype != scene.dtype:
        tensor = tensor.to(scene.dtype)
    return tensor if tensor.is_contiguous() else tensor.contiguous()
