"""Writes a scene as a Mitsuba 3 XML file, with its meshes, textures and volumes in folders beside it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import torch

from .. import io
from ..integrators import TYPES, Integrator
from ..io._files import as_path
from ..io.curves import write_curves
from ..scene.context import SAMPLES, SHORTEST
from ..scene.curves import Curve
from ..scene.declaration import CHILD_KINDS
from ..scene.film import FILTER_PARAMETERS, Film
from ..scene.mesh import Mesh
from ..scene.plugin import Plugin
from ..scene.scene import Scene
from ..scene.torch_bsdf import TorchBSDF
from .materials import identifier
from .ply import write_ply

_INDENT = "    "


def save(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write `scene` to an XML file, and ``meshes/*.ply``, ``textures/*.exr``, ``volumes/*.vol`` beside it.

    See `Scene.save`.
    """
    path = as_path(path)
    if path.suffix.lower() != ".xml":
        raise ValueError(f"save: expected a name that ends in .xml, got {str(path)!r}")
    _refuse_torch(scene)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = _Writer(scene, path).text()
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def _refuse_torch(scene: Scene) -> None:
    """ValueError for what is written in PyTorch, before anything is written to files."""
    for name, module in scene.named_modules():
        if isinstance(module, TorchBSDF) or (isinstance(module, Integrator) and module.kind not in TYPES):
            raise ValueError(f"save: {name}: a {type(module).__name__} has no form in a scene file")


def number(value: torch.Tensor) -> str:
    """A scalar tensor as the shortest text that gives its bits back."""
    if value.dtype == torch.float64:
        return repr(float(value))
    single = np.float32(value.item())
    text = str(single)
    # By way of double precision, as it will be read; where that rounds otherwise, all digits.
    return text if np.float32(float(text)) == single else repr(float(single))


class _Writer:
    """The lines of one file, and the names taken so far."""

    def __init__(self, scene: Scene, path: Path) -> None:
        self.scene = scene
        self.folder = path.parent
        self.stem = identifier(path.stem, set())
        self.lines: list[str] = []
        self.files: set[str] = set()
        self.ids = {id(m): name for name, m in scene._modules.items() if not _inline(m)}
        self.top = set(self.ids)
        self.written: set[int] = set()
        self.meters = self._nested_meters()
        self._name_shared()

    def _nested_meters(self) -> dict[int, dict[str, Plugin]]:
        """Meters of irradiance by the shape that they lie on: Mitsuba's place for them is inside of it.

        Only if all sensors are such meters, and come back with the same names in the same order.
        """
        result: dict[int, dict[str, Plugin]] = {}
        names, order = [], []
        for name, sensor in self.scene._modules.items():
            if not isinstance(sensor, Plugin) or sensor.category != "sensor":
                continue
            shape = sensor._child("shape")
            stem = f"{self.ids.get(id(shape))}_"
            if shape is None or id(shape) not in self.top or not name.startswith(stem) or name == stem:
                return {}
            result.setdefault(id(shape), {})[name.removeprefix(stem)] = sensor
            names.append(name)
        for shape in self.scene._modules.values():
            order += [f"{self.ids[id(shape)]}_{key}" for key in result.get(id(shape), {})]
        return result if names == order else {}

    def _name_shared(self) -> None:
        """Ids for objects that several others hold and that are none of the scene's own."""
        seen: set[int] = set()
        taken = {*self.scene._modules}

        def walk(module: torch.nn.Module) -> None:
            for name, child in module._modules.items():
                if not isinstance(child, Plugin) or _inline(child):
                    continue
                if id(child) in seen and id(child) not in self.ids:
                    self.ids[id(child)] = identifier(str(child.__dict__.get("id") or f"shared_{name}"), taken)
                if id(child) not in seen:
                    seen.add(id(child))
                    walk(child)

        walk(self.scene)

    def text(self) -> str:
        self.lines = ['<?xml version="1.0" encoding="utf-8"?>', '<scene version="3.0.0">']
        nested = {id(meter) for meters in self.meters.values() for meter in meters.values()}
        for name, module in self.scene._modules.items():
            if id(module) in nested:
                continue
            if isinstance(module, Integrator):
                self.integrator(module, 1, id=name)
            elif isinstance(module, Plugin) and not _inline(module):
                self.plugin(module, 1, name)
        return "\n".join([*self.lines, "</scene>", ""])

    # ------------------------------------------------------------------------------------------------- elements
    def line(self, depth: int, tag: str, close: bool = True, **attributes: Any) -> None:
        given = "".join(f" {k}={quoteattr(str(v))}" for k, v in attributes.items() if v is not None)
        self.lines.append(f"{_INDENT * depth}<{tag}{given}{'/' if close else ''}>")

    def end(self, depth: int, tag: str) -> None:
        """Close an element; one without content in a single line."""
        opening = f"{_INDENT * depth}<{tag} "
        if self.lines[-1].startswith(opening) and not self.lines[-1].endswith("/>"):
            self.lines[-1] = self.lines[-1][:-1] + "/>"
        else:
            self.lines.append(f"{_INDENT * depth}</{tag}>")

    def value(self, depth: int, name: str, content: Any) -> None:
        """A plain Python value."""
        kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
        text = str(content).lower() if isinstance(content, bool) else content
        self.line(depth, kinds[type(content)], name=name, value=text)

    def matrix(self, depth: int, name: str, matrix: torch.Tensor) -> None:
        if torch.equal(matrix, torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)):
            return
        if len(matrix) == 3:  # of texture coordinates: rows and columns 0, 1 and 3 hold the planar map
            keep = torch.tensor([0, 1, 3])
            full = torch.eye(4, dtype=matrix.dtype)
            full[keep[:, None], keep] = matrix.cpu()
            matrix = full
        self.line(depth, "transform", close=False, name=name)
        self.line(depth + 1, "matrix", value=" ".join(number(v) for v in matrix.reshape(-1)))
        self.end(depth, "transform")

    def file(self, folder: str, name: str, ending: str) -> tuple[Path, str]:
        """A free name for a file in `folder`: as a path, and as the scene says it."""
        name = identifier(f"{self.stem}_{name}" if self.stem != "scene" else name, self.files)
        (self.folder / folder).mkdir(exist_ok=True)
        return self.folder / folder / f"{name}{ending}", f"{folder}/{name}{ending}"

    # -------------------------------------------------------------------------------------------------- objects
    def plugin(self, plugin: Plugin, depth: int, name: str, where: str = "") -> None:
        """An object of the scene (`where` is empty) or one that another holds under `name`."""
        nested: dict[str, Any] = {"name": name} if where else {}
        if id(plugin) in self.written or (where and id(plugin) in self.top):
            self.line(depth, "ref", id=self.ids[id(plugin)], **nested)
            return
        self.written.add(id(plugin))
        where = f"{where}_{name}" if where else name
        kind = "ply" if isinstance(plugin, Mesh) else plugin.type
        self.line(depth, plugin.category, close=False, type=kind, id=self.ids.get(id(plugin)), **nested)
        done: set[str] = set()
        if isinstance(plugin, Mesh):
            done = self.mesh(plugin, depth + 1, where)
        elif isinstance(plugin, Curve):
            done = self.curve(plugin, depth + 1, where)
        done |= self.field_of_view(plugin, depth + 1)
        if plugin.category == "sensor":
            done |= self.sensor(plugin, depth + 1)
        shown = {theirs: ours for ours, theirs in plugin.aliases.items()}
        for field_name, field in plugin.fields().items():
            if field_name not in done:
                self.field(plugin, field_name, shown.get(field_name, field_name), field, depth + 1, where)
        for key, meter in self.meters.get(id(plugin), {}).items():
            self.line(depth + 1, meter.category, close=False, type=meter.type, name=key)
            self.sensor(meter, depth + 2)
            self.end(depth + 1, meter.category)
        self.end(depth, plugin.category)

    def field(self, plugin: Plugin, name: str, shown: str, field: Any, depth: int, where: str) -> None:
        content = getattr(plugin, name, None)
        if content is None:
            return
        if isinstance(content, Plugin):
            if _inline(content):
                self.constant(depth, shown, content)
            else:
                self.plugin(content, depth, shown, where)
            return
        if field.kind == "int":
            if field.default is None or plugin.encode(name) != int(field.default):
                self.value(depth, shown, content)
            return
        tensor = content.detach().cpu()
        if field.kind in ("transform", "transform2"):
            self.matrix(depth, shown, tensor)
        elif field.kind in ("point", "vector"):
            x, y, z = (number(v) for v in tensor)
            self.line(depth, field.kind, name=shown, x=x, y=y, z=z)
        elif field.kind == "float":
            if name == "eta" and "int_ior" in plugin.parameter_names():
                self.line(depth, "float", name="int_ior", value=number(tensor))
                self.line(depth, "float", name="ext_ior", value="1")
            elif field.default is None or float(tensor) != field.default:
                self.line(depth, "float", name=shown, value=number(tensor))
        elif field.kind == "spectrum":
            self.colour(depth, shown, tensor)
        elif field.kind == "tensor":
            self.tensor(plugin, shown, tensor, depth, where)
        elif field.kind not in CHILD_KINDS:
            raise ValueError(f"save: {where}.{shown}: a parameter of kind {field.kind!r} has no form in a scene file")

    def constant(self, depth: int, name: str, plugin: Plugin) -> None:
        """A texture or volume of one colour, in place."""
        value = plugin.value
        if isinstance(value, Plugin):  # a volume's is a texture
            value = value.value
        self.colour(depth, name, value.detach().cpu())

    def colour(self, depth: int, name: str, value: torch.Tensor) -> None:
        if value.numel() == 1:
            self.line(depth, "float", name=name, value=number(value.reshape(())))
        elif value.numel() == SAMPLES:
            self.line(depth, "spectrum", name=name, value=_pairs(value))
        else:
            self.line(depth, "rgb", name=name, value=", ".join(number(v) for v in value))

    def tensor(self, plugin: Plugin, name: str, tensor: torch.Tensor, depth: int, where: str) -> None:
        """An image or a grid in a file of its own, a table in place."""
        if plugin.category in ("volume", "medium") or plugin.type == "sdfgrid":
            path, said = self.file("volumes", where, ".vol")
            io.write_volume(path, tensor)
        elif tensor.ndim == 1:
            self.line(depth, "string", name=name, value=", ".join(number(v) for v in tensor))
            return
        elif "filename" in plugin.parameter_names() and tensor.ndim in (2, 3):
            path, said = self.file("textures", where, ".exr")
            channels = tensor.shape[2] if tensor.ndim == 3 else 1
            names = None if channels in (1, 3, 4) else [f"c{i:03d}" for i in range(channels)]
            io.write_image(path, tensor, channels=names)
        else:
            raise ValueError(f"save: {where}.{name}: a {plugin.type} has no form in a scene file")
        self.line(depth, "string", name="filename", value=said)
        if "raw" in plugin.parameter_names() and plugin.category == "texture":
            self.value(depth, "raw", True)

    def mesh(self, mesh: Mesh, depth: int, where: str) -> set[str]:
        """The mesh as a PLY file; returns the fields that are done with that."""
        path, said = self.file("meshes", where, ".ply")
        normals, given = mesh.vertex_normals, {}
        flat = normals is None or mesh.face_normals
        if normals is not None and not flat and not mesh.computed_normals:
            given["normals"] = normals
        if mesh.vertex_texcoords is not None:
            given["texcoords"] = mesh.vertex_texcoords
        arrays = {key: value.detach().cpu().numpy() for key, value in given.items()}
        attributes = {name: getattr(mesh, name).detach().cpu().numpy() for name in mesh.attribute_names}
        write_ply(path, mesh.vertex_positions.detach().cpu().numpy(), mesh.faces.cpu().numpy(), **arrays,
                  attributes=attributes)  # fmt: skip
        self.line(depth, "string", name="filename", value=said)
        if flat:
            self.value(depth, "face_normals", True)
        return {"vertex_positions", "faces", "vertex_normals", "vertex_texcoords", "face_normals"}

    def curve(self, curve: Curve, depth: int, where: str) -> set[str]:
        """The curve as a text file; returns the fields that are done with that."""
        path, said = self.file("curves", where, ".txt")
        points, radii, segments = (
            t.detach().cpu().numpy() for t in (curve.control_points, curve.radii, curve.segment_indices)
        )
        write_curves(path, points, radii, segments, curve.order)
        self.line(depth, "string", name="filename", value=said)
        return {"control_points", "radii", "segment_indices"}

    # ------------------------------------------------------------------------------------- what is no parameter
    def field_of_view(self, plugin: Plugin, depth: int) -> set[str]:
        """Of a camera or projector; returns the fields that are done with that."""
        if "x_fov" not in plugin.fields():
            return set()
        self.line(depth, "float", name="fov", value=number(plugin.x_fov.detach().cpu()))
        self.value(depth, "fov_axis", "x")
        return {"x_fov"}

    def sensor(self, sensor: Plugin, depth: int) -> set[str]:
        """Target, film and sampler; returns the fields that are done with that."""
        done = set()
        target = getattr(sensor, "target", None)
        if target is not None:
            x, y, z = (number(v) for v in target.detach().cpu())
            self.line(depth, "point", name="target", x=x, y=y, z=z)
            done.add("target")
        film = sensor.__dict__.get("film")
        if film is not None:
            self.film(film, depth)
        if sensor.__dict__.get("srf") is not None:
            self.line(depth, "spectrum", name="srf", value=_pairs(sensor.srf))
        sampler = sensor.__dict__.get("sampler")
        if sampler is not None:
            self.line(depth, "sampler", close=False, type=sampler.type)
            self.value(depth + 1, "sample_count", sampler.sample_count)
            self.end(depth, "sampler")
        return done

    def film(self, film: Film, depth: int) -> None:
        kind = "hdrfilm" if film.bands is None else "specfilm"
        self.line(depth, "film", close=False, type=kind)
        settings: dict[str, Any] = {"width": film.width, "height": film.height, **film.formats}
        if film.crop is not None:
            names = ("crop_offset_y", "crop_offset_x", "crop_height", "crop_width")
            settings |= dict(zip(names, film.crop, strict=True))
        if film.sample_border:
            settings["sample_border"] = True
        for name, content in settings.items():
            self.value(depth + 1, name, content)
        self.line(depth + 1, "rfilter", close=False, type=film.filter.type)
        for parameter in FILTER_PARAMETERS[film.filter.type]:
            self.value(depth + 2, parameter, getattr(film.filter, parameter))
        self.end(depth + 1, "rfilter")
        for name, table in (film.bands or {}).items():
            self.line(depth + 1, "spectrum", name=name, value=_pairs(table))
        self.end(depth, "film")

    def integrator(self, integrator: Integrator, depth: int, **attributes: str) -> None:
        self.line(depth, "integrator", close=False, type=integrator.kind, **attributes)
        for name in TYPES[integrator.kind][1]:
            content = getattr(integrator, name, None)
            if content is not None and (name, content) != ("emitter_sampling", "weight"):
                self.value(depth + 1, name, content)
        for name, child in integrator._modules.items():
            if isinstance(child, Integrator):
                self.integrator(child, depth + 1, name=name)
        self.end(depth, "integrator")


def _pairs(table: torch.Tensor) -> str:
    """A table as wavelengths in nm and values."""
    return ", ".join(f"{SHORTEST + i:g}:{number(value)}" for i, value in enumerate(table.detach()))


def _inline(module: Any) -> bool:
    """Whether an object is a colour, which has no element of its own."""
    kind = (getattr(module, "category", ""), getattr(module, "type", ""))
    return kind in (("texture", "constant"), ("volume", "constvolume"))
