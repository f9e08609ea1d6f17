"""From the module tree to the flat description that the native core takes.

Every distinct parameter of a scene gets one slot in a flat list, every object a row of integers in its category's
table: slots, indices of other objects, static numbers, in the order in which the core declares its fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import nn

from .context import SAMPLES
from .declaration import TENSOR_KINDS, models
from .derivatives import COMPLETE, Limits
from .host_memory import on_host
from .media import Medium, ScatteringMedium
from .mesh import Mesh
from .plugin import Plugin
from .sensor import Sensor
from .shapes import ON_SHAPES, Shape
from .torch_bsdf import TorchBSDF

if TYPE_CHECKING:
    from .scene import Scene


# Kinds of objects whose parameters have the derivatives that the field has in which the object sits.
LIMITING = ("spectrum", "texture", "volume")
# What the core has in the place of a BSDF that is written in PyTorch: rays meet its surface, and it is never evaluated.
PLACEHOLDER: tuple[str, list[int]] = ("diffuse", [-1])


@dataclass
class Slot:
    """One parameter of the flat list."""

    module: Plugin
    attribute: str
    name: str
    kind: str
    refusal: str = ""  # why there is no derivative, or empty
    caveat: str = ""  # the term that the derivative lacks, and when it is zero, or empty

    def tensor(self) -> torch.Tensor:
        found = self.module._parameters.get(self.attribute)
        return found if found is not None else getattr(self.module, self.attribute)

    def check_shape(self, tensor: torch.Tensor, what: str) -> None:
        """ValueError unless `tensor` can take this parameter's place."""
        shape = tuple(tensor.shape)
        channels = 1 if self.module._color == "mono" else 3  # a map of normals has three in any scene
        fixed = {"float": [()], "point": [(3,)], "vector": [(3,)], "transform": [(4, 4)], "transform2": [(3, 3)]}
        if self.kind == "spectrum":
            tables = [(SAMPLES,)] if self.module._color == "spectral" else []
            fixed["spectrum"] = [(), (channels,), *tables]
        if self.kind in fixed:
            if shape not in fixed[self.kind]:
                expected = " or ".join(str(s) for s in fixed[self.kind])
                raise ValueError(f"{what}: expected shape {expected}, got {shape}")
            return
        current = tuple(self.tensor().shape)
        if self.attribute == "heights":  # of a height field: any size
            if len(shape) != 2 or 0 in shape:
                raise ValueError(f"{what}: expected shape (H, W), got {shape}")
        elif self.attribute == "index":  # of refraction: likewise
            if len(shape) != 3 or 0 in shape:
                raise ValueError(f"{what}: expected shape (Z, Y, X), got {shape}")
        elif self.attribute == "grid":  # of distances: likewise
            if len(shape) != 4 or shape[3] != 1 or min(shape[:3]) < 2:
                raise ValueError(f"{what}: expected shape (D, H, W, 1) with D, H, W > 1, got {shape}")
        elif len(current) in (3, 4):  # texels and voxels: any size
            if len(shape) != len(current) or shape[-1] not in (1, channels) or 0 in shape:
                size = "(H, W, C)" if len(current) == 3 else "(Z, Y, X, C)"
                raise ValueError(f"{what}: expected shape {size} with C = 1 or {channels}, got {shape}")
        elif shape != current:
            raise ValueError(f"{what}: expected shape {current}, got {shape}")


@dataclass
class Layout:
    """What a native scene is built from. Layouts with equal objects and indices need only one native scene."""

    slots: list[Slot] = field(default_factory=list)
    objects: dict[str, list[tuple[str, list[int], str]]] = field(default_factory=dict)
    index_sources: list[torch.Tensor] = field(default_factory=list)  # wherever they lie
    slot_of: dict[tuple[int, str], int] = field(default_factory=dict)
    by_name: dict[str, int] = field(default_factory=dict)
    sensors: list[Sensor] = field(default_factory=list)  # those of the scene, then those that stand for others
    own_sensors: int = 0  # how many are the scene's
    attribute_names: dict[str, int] = field(default_factory=dict)  # numbers that colours of meshes go by
    smooth_meshes: list[Mesh] = field(default_factory=list)  # those whose normals follow from their positions
    used: set[int] = field(default_factory=set)  # ids of the modules that an image can depend on
    media: bool = False  # some shape or camera has a medium
    boundaries_seen: bool = False  # the media's boundaries were looked at
    lights_seen: bool = False  # whether there are lights was looked at
    torch_bsdfs: dict[int, TorchBSDF] = field(default_factory=dict)  # those written in PyTorch, by row
    torch_names: dict[str, TorchBSDF] = field(default_factory=dict)  # the same by each of their paths
    outlines: list[int] | None = None  # slots of what moves them, once that was asked
    spectral: bool = False  # colours are spectra for the core
    roles: list[str | None] | None = None  # of slots, once that was asked, see spectral/roles.py
    staying: dict[int, bool] | None = None  # see residence.py, once that was asked
    edges: Any = None  # the core's outlines, and the index arrays they were found with, see visibility/outlines.py

    @property
    def index_tensors(self) -> list[torch.Tensor]:
        """Faces of meshes and segments of curves, in the host's memory."""
        return [tensor if tensor.is_cpu else on_host(tensor) for tensor in self.index_sources]

    def indices(self, number: int) -> torch.Tensor:
        """One of `index_tensors`."""
        return on_host(self.index_sources[number])

    def index_key(self) -> list[tuple[int, int, int]]:
        """Tells whether the index arrays are still those that a native scene was built with."""
        return [(t.data_ptr(), t.shape[0], 0 if t.is_inference() else t._version) for t in self.index_tensors]

    def index_of(self, name: str) -> int | None:
        """The slot of the parameter that goes by this name, also by one with the words of a scene dict."""
        found = self.by_name.get(name)
        return self.by_name.get(canonical(name)) if found is None else found

    @property
    def bending(self) -> list[int]:
        """Numbers of the media that light bends in."""
        return [i for i, (kind, _, _) in enumerate(self.objects["medium"]) if kind == "gradientindex"]

    def camera_slots(self, camera: Plugin) -> dict[str, int]:
        """Slots of the fields of `camera`, which is among the packed sensors."""
        return {a: i for (m, a), i in self.slot_of.items() if m == id(camera)}


@dataclass(frozen=True)
class Record:
    """An object of a scene: its type, and for each field a slot, an index of another object, or a number."""

    type: str
    field: dict[str, int]
    path: str


def record(layout: Layout, category: str, row: int) -> Record:
    """An object of a category by its number; a BSDF that is written in PyTorch has the type ``"torch"``."""
    kind, numbers, path = layout.objects[category][row]
    if category == "bsdf" and row in layout.torch_bsdfs:
        return Record("torch", {"row": row}, path)
    names = [f.name for f in models()[category, kind].fields]
    return Record(kind, dict(zip(names, numbers, strict=True)), path)


def records(layout: Layout, category: str) -> list[Record]:
    """All objects of a category."""
    return [record(layout, category, row) for row in range(len(layout.objects[category]))]


def bending_boundary(layout: Layout, tensors: list[torch.Tensor], bsdf: int, where: str) -> bool:
    """Whether this BSDF refracts; ValueError, naming `where`, unless it may bound a medium that light bends in."""
    boundary = record(layout, "bsdf", bsdf)
    if boundary.type == "torch":
        raise ValueError(f"{where}: expected null or dielectric, got one written in PyTorch")
    if boundary.type not in ("null", "dielectric"):
        raise ValueError(f"{where}: expected null or dielectric as the boundary of the medium, got {boundary.type}")
    if boundary.type == "null":
        return False
    usual = models()["bsdf", "dielectric"].fields[0].default
    if usual is None or abs(float(tensors[boundary.field["eta"]]) - usual) > 1e-5:
        raise ValueError(
            f"{where}: the index inside is that of the medium, and the one outside its ext_ior: leave out int_ior and "
            "ext_ior of the dielectric"
        )
    return True


class _Packer:
    def __init__(self) -> None:
        self.layout = Layout(objects={category: [] for category, _ in models()})
        self.index: dict[int, int] = {}  # id of a module -> its row

    def slot(self, module: Plugin, attribute: str, name: str, kind: str, limits: Limits) -> int:
        key = (id(module), attribute)
        found = self.layout.slot_of.get(key)
        if found is None:
            found = len(self.layout.slots)
            self.layout.slots.append(Slot(module, attribute, name, kind, limits.refusal, limits.caveat))
            self.layout.slot_of[key] = found
        else:  # used in several places: each of them limits what there is
            slot = self.layout.slots[found]
            slot.refusal, slot.caveat = slot.refusal or limits.refusal, slot.caveat or limits.caveat
        self.layout.by_name.setdefault(name, found)
        return found

    def attribute_id(self, name: str) -> int:
        names = self.layout.attribute_names
        return names.setdefault(name, len(names))

    def add(self, plugin: Plugin, name: str, limits: Limits = COMPLETE) -> int:
        """Row of `plugin` in its category's table; objects that are used twice are packed once."""
        # A light belongs to its shape natively, so one that several shapes share becomes a row for each.
        shared = plugin.category != "emitter"
        if shared and id(plugin) in self.index:
            self.alias(plugin, name, limits)
            return self.index[id(plugin)]
        rows = self.layout.objects[plugin.category]
        if isinstance(plugin, TorchBSDF):
            row = len(rows)
            rows.append((*PLACEHOLDER, name))
            self.layout.torch_bsdfs[row] = self.layout.torch_names[name] = plugin
            self.index[id(plugin)] = row
            return row
        numbers = [self._number(plugin, n, f, f"{name}.{n}", limits) for n, f in plugin.fields().items()]
        row = len(rows)
        rows.append((plugin.model().type, numbers, name))
        self.index[id(plugin)] = row
        if isinstance(plugin, Mesh):
            self._mesh(plugin, name, row)
        return row

    def alias(self, plugin: Plugin, name: str, limits: Limits) -> None:
        """Further names of parameters that are already packed."""
        if isinstance(plugin, TorchBSDF):
            self.layout.torch_names[name] = plugin
        for field_name, declared in plugin.fields().items():
            own = limits.also(plugin.derivative_of(declared))
            if plugin._holds(declared):
                if (id(plugin), field_name) in self.layout.slot_of:
                    self.slot(plugin, field_name, f"{name}.{field_name}", declared.kind, own)
            else:
                child = plugin._child(field_name)
                if isinstance(child, Plugin):
                    self.alias(child, f"{name}.{field_name}", own if declared.kind in LIMITING else limits)

    def _number(self, plugin: Plugin, field_name: str, declared: Any, name: str, limits: Limits) -> int:
        kind = declared.kind
        own = limits.also(plugin.derivative_of(declared))
        if kind == "int":
            if plugin.type == "mesh_attribute" and field_name == "name":
                return self.attribute_id(plugin.__dict__["name"])
            return plugin.encode(field_name)
        if kind == "indices":
            self.layout.index_sources.append(getattr(plugin, field_name))
            return len(self.layout.index_sources) - 1
        if kind in TENSOR_KINDS and plugin._holds(declared):
            if isinstance(plugin, Mesh) and field_name == "vertex_normals" and plugin.face_normals:
                return -1
            if plugin._parameters.get(field_name) is None and getattr(plugin, field_name, None) is None:
                return -1
            return self.slot(plugin, field_name, name, kind, own)
        child = plugin._child(field_name)
        if child is None:
            return -1
        if kind == "spectrum":
            return self.slot(child, "value", f"{name}.value", kind, own)
        return self.add(child, name, own if kind in LIMITING else limits)

    def _mesh(self, mesh: Mesh, name: str, row: int) -> None:
        if mesh.computed_normals and not mesh.face_normals:
            self.layout.smooth_meshes.append(mesh)
        declared = models()["attribute", "attribute"]
        for attribute in mesh.attribute_names:
            data = next(f for f in declared.fields if f.kind == "tensor")
            numbers = []
            for f in declared.fields:
                if f.kind == "shape":
                    numbers.append(row)
                elif f.kind == "tensor":
                    own = COMPLETE.also(data.derivative)
                    numbers.append(self.slot(mesh, attribute, f"{name}.{attribute}", "tensor", own))
                elif f.name == "per_face":
                    numbers.append(int(attribute.startswith("face_")))
                else:
                    numbers.append(self.attribute_id(attribute))
            self.layout.objects["attribute"].append(("attribute", numbers, f"{name}.{attribute}"))


def canonical(name: str) -> str:
    """A dotted name with the words of a scene dict (``ball.interior.phase.g``) in those of the modules."""
    words = {**Shape.aliases, **ScatteringMedium.aliases}
    return ".".join(words.get(part, part) for part in name.split("."))


# Objects that others refer to come first, so that a parameter goes by the id of the object that owns it.
ORDER = ("texture", "volume", "phase", "medium", "bsdf", "emitter", "shape", "sensor")


def top_level(scene: Scene) -> Iterator[tuple[str, Plugin]]:
    """The scene's own objects with their ids, in packing order."""
    found = [(n, m) for n, m in scene._modules.items() if isinstance(m, Plugin)]
    return iter(sorted(found, key=lambda item: ORDER.index(item[1].category)))


def _used(scene: Scene) -> set[int]:
    """Ids of shapes, lights, cameras and of all that they refer to: a material that nothing has is not among them."""
    found: set[int] = set()

    def walk(module: nn.Module) -> None:
        if id(module) not in found:
            found.add(id(module))
            for child in module._modules.values():
                if child is not None:
                    walk(child)

    for _, plugin in top_level(scene):
        if plugin.category in ("shape", "sensor") or (plugin.category == "emitter" and plugin.type not in ON_SHAPES):
            walk(plugin)
    return found


def pack(scene: Scene, placeholders: Iterable[Sensor]) -> Layout:
    """The layout of `scene`, with more sensors that stand for cameras that are no part of it."""
    packer = _Packer()
    lights = []
    for name, plugin in top_level(scene):
        if plugin.type in ON_SHAPES:  # has its row where a shape refers to it
            lights.append((name, plugin))
            continue
        packer.add(plugin, name)
        if isinstance(plugin, Sensor):
            packer.layout.sensors.append(plugin)
    for name, plugin in lights:
        packer.alias(plugin, name, COMPLETE)
    layout = packer.layout
    layout.spectral = scene.variant.startswith("spectral")
    layout.own_sensors = len(layout.sensors)
    for camera in placeholders:
        packer.add(camera, "camera")
        layout.sensors.append(camera)
    free = {id(camera) for camera in placeholders}
    layout.used = _used(scene) | free
    layout.media = any(isinstance(m, Medium) and id(m) in layout.used for m in scene.modules())
    # Placeholders are no part of the scene, so that their parameters have no names.
    layout.by_name = {n: i for n, i in layout.by_name.items() if id(layout.slots[i].module) not in free}
    return layout
