"""What pictures of a view depend on: values that may change from one to the next, and all else as a fingerprint."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from .render_arguments import as_integrator
from .scene.packing import Layout
from .scene.scene import Scene
from .scene.sensor import Sensor


def remembered(packed: Layout, params: Mapping[str, torch.Tensor] | None) -> dict[str, torch.Tensor]:
    """What pictures depend on and may change: parameters that are given, or that require gradients, by name."""
    given = {packed.index_of(name): value for name, value in (params or {}).items() if isinstance(name, str)}
    computed = computed_normals(packed)
    found = {}
    for i, slot in enumerate(packed.slots):
        tensor = given[i] if i in given else slot.tensor()
        if isinstance(tensor, torch.Tensor) and (i in given or (tensor.requires_grad and i not in computed)):
            found[slot.name] = tensor
    return found


def computed_normals(packed: Layout) -> set[int]:
    """Slots of normals that follow from the positions of their mesh."""
    slots = (packed.slot_of.get((id(mesh), "vertex_normals")) for mesh in packed.smooth_meshes)
    return {slot for slot in slots if slot is not None}


class Fingerprints:
    """What a view's picture depends on besides `remembered` parameters, in numbers and words that outlive a process."""

    def __init__(self) -> None:
        self._structure: tuple[Layout, Any, int] | None = None
        self._sums: dict[int, tuple[torch.Tensor, int, int]] = {}  # of a slot: tensor, version, checksum

    def __reduce__(self) -> Any:
        return Fingerprints, ()  # no copy has the scene of the first one

    def describe(
        self, scene: Scene, packed: Layout, camera: Sensor, settings: Mapping[str, Any], values: dict[str, torch.Tensor]
    ) -> dict[str, Any]:
        """By the words that say what it is."""
        computed = computed_normals(packed)
        rest = [
            (self._sum(i, slot.tensor()), tuple(slot.tensor().shape))
            for i, slot in enumerate(packed.slots)
            if slot.name not in values and i not in computed
        ]
        responses = [*(camera.film.bands or {}).values(), *([] if camera.srf is None else [camera.srf])]
        if any(table.requires_grad for table in responses):
            raise ValueError("Renderer: reuse: bands and srf that are learned are not reused")
        part = settings.get("crop"), settings.get("size"), settings.get("pixels")
        return {
            "the scene": self._scene(scene, packed),
            "what is learned or given": str([(name, tuple(value.shape)) for name, value in values.items()]),
            "another parameter": str(rest),
            "the integrator": str(as_integrator(scene, settings.get("integrator")).config()),
            "the film": f"{camera.film} {[checksum(table) for table in responses]}",
            "the part of the film": " ".join(
                str(checksum(torch.as_tensor(value)) if isinstance(value, (torch.Tensor, np.ndarray)) else value)
                for value in part
            ),
        }

    def _scene(self, scene: Scene, packed: Layout) -> int:
        key = packed.index_key()
        if self._structure is None or self._structure[0] is not packed or self._structure[1] != key:
            faces = [checksum(tensor) for tensor in packed.index_tensors]
            described = repr((scene.dtype, packed.objects, faces))
            self._structure = packed, key, zlib.crc32(described.encode())
        return self._structure[2]

    def _sum(self, slot: int, tensor: torch.Tensor) -> int:
        version = -1 if tensor.is_inference() else tensor._version
        seen = self._sums.get(slot)
        if seen is None or version < 0 or seen[1] != version or seen[0].data_ptr() != tensor.data_ptr():
            # the alias holds the memory, so that an equal address means the same
            self._sums[slot] = seen = tensor.detach(), version, checksum(tensor)
        return seen[2]


def checksum(tensor: torch.Tensor) -> int:
    """Of a tensor's bytes."""
    return zlib.crc32(tensor.detach().cpu().contiguous().reshape(-1).numpy().data)
