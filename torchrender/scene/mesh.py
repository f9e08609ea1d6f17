"""Triangle meshes from arrays, and the cube."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import nn

from ..errors import describe, nearest
from . import values
from .construction import install_tensor
from .context import Context
from .declaration import Field
from .host_memory import numbers_on_host, on_host
from .normals import vertex_normals
from .plugin import Plugin
from .registry import builder, register
from .shapes import SILHOUETTE, Shape
from .structure import structure_changed


@register
class Mesh(Shape):
    """A triangle mesh in world space.

    Args:
        vertices: (V, 3) positions.
        faces: (F, 3) integer indices.
        vertex_normals: (V, 3) for smooth shading; without them every triangle is flat.
        vertex_texcoords: (V, 2).
        face_normals: shade flat although there are vertex normals.
        flip_normals: turn normals around.
        bsdf, emitter: material and area light.
        interior, exterior: media inside and outside; the mesh is closed then, with normals that point outside.
        to_world: 4x4 matrix applied once, when the mesh is made.
        attributes: colours by name, ``vertex_*`` (V, C) or ``face_*`` (F, C), for `mesh_attribute` textures.

    Computed normals, those of files that have none and of `compute_normals`, always follow the positions: an edit of
    them in place is overwritten by the next rendering. Assigning ``vertex_normals`` gives the mesh normals of its own.
    Positions of another number of vertices are taken if faces, and normals, texture coordinates and attributes that
    the mesh has, still fit; ValueError says which of them do not.
    """

    type = "mesh"
    aliases: ClassVar[dict[str, str]] = {**Shape.aliases, "vertices": "vertex_positions"}
    renames: ClassVar[dict[str, str]] = {
        **Shape.renames,
        "vertices": "vertex_positions",
        "normals": "vertex_normals",
        "texcoords": "vertex_texcoords",
    }

    def __init__(
        self,
        vertices: Any = None,
        faces: Any = None,
        vertex_normals: Any = None,
        vertex_texcoords: Any = None,
        face_normals: bool = False,
        bsdf: Any = None,
        emitter: Any = None,
        to_world: Any = None,
        **properties: Any,
    ) -> None:
        named = {
            "vertices": vertices,
            "faces": faces,
            "vertex_normals": vertex_normals,
            "vertex_texcoords": vertex_texcoords,
            "bsdf": bsdf,
            "emitter": emitter,
            "to_world": to_world,
        }
        given = {k: v for k, v in named.items() if v is not None}
        super().__init__(face_normals=face_normals, **given, **properties)

    @classmethod
    def parameter_names(cls) -> list[str]:
        mine = ["vertices", "faces", "vertex_normals", "vertex_texcoords", "face_normals", "flip_normals"]
        return [*mine, "to_world", "attributes", "bsdf", "emitter", "interior", "exterior"]

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        positions = properties.pop("vertices", properties.pop("vertex_positions", None))
        if type(positions).__module__.partition(".")[0] == "trimesh" and hasattr(positions, "faces"):
            ctx.at("vertices").error(
                f"got {describe(positions)}: give its arrays, tr.Mesh(mesh.vertices, mesh.faces), or make it a scene "
                "with its material by tr.from_trimesh(mesh)"
            )
        if positions is None or "faces" not in properties:
            ctx.error("a mesh needs vertices (V, 3) and faces (F, 3)")
        positions = _rows(positions, 3, ctx.at("vertices"))
        if not bool(torch.isfinite(positions.detach()).all()):
            ctx.at("vertices").error("has values that are not finite")
        if positions.shape[0] == 0:
            ctx.at("vertices").error("the mesh is empty: it has no vertices")
        faces = faces_of(properties.pop("faces"), positions.shape[0], ctx.at("faces"))
        normals = properties.pop("vertex_normals", None)
        texcoords = properties.pop("vertex_texcoords", None)
        if normals is not None:
            normals = _rows(normals, 3, ctx.at("vertex_normals"), positions.shape[0])
        if texcoords is not None:
            texcoords = _rows(texcoords, 2, ctx.at("vertex_texcoords"), positions.shape[0])
        to_world = properties.pop("to_world", None)
        if to_world is not None:
            # In double precision, so that the same dict gives the same mesh whatever the scene's own is.
            double = Context(ctx.color, torch.float64, ctx.device, ctx.path, ctx.folder)
            matrix = values.matrix(to_world, 4, double.at("to_world"))
            moved = positions.to(torch.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            positions = moved.to(positions.dtype)
            if normals is not None:
                inverse, info = torch.linalg.inv_ex(matrix[:3, :3])
                if int(info) != 0:
                    ctx.at("to_world").error("the matrix is singular")
                turned = normals.to(torch.float64) @ inverse
                normals = torch.nn.functional.normalize(turned, dim=1).to(normals.dtype)
        properties = {**properties, "vertex_positions": positions, "faces": faces}
        if normals is not None:
            properties["vertex_normals"] = normals
        if texcoords is not None:
            properties["vertex_texcoords"] = texcoords
        self._attributes_given = properties.pop("attributes", None) or {}
        return properties

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        self.__dict__.setdefault("attribute_names", [])
        self.__dict__.setdefault("computed_normals", False)
        for name, data in self.__dict__.pop("_attributes_given", {}).items():
            self._add_attribute(name, data, ctx.at(name))

    def add_attribute(self, name: str, data: Any) -> None:
        """Give the mesh colours: `data` (V, C) for a name beginning with ``vertex_``, (F, C) for ``face_``."""
        self._add_attribute(name, data, self._own_context(name))
        structure_changed()

    def _add_attribute(self, name: str, data: Any, ctx: Context) -> None:
        if not isinstance(name, str) or not name.startswith(("vertex_", "face_")) or name in self.fields():
            ctx.error(f"an attribute's name begins with 'vertex_' or 'face_', got {name!r}")
        if "." in name:
            ctx.error(f"an attribute's name has no dots, got {name!r}")
        rows = self.vertex_positions.shape[0] if name.startswith("vertex_") else self.faces.shape[0]
        tensor = values.floating(data, ctx)
        if tensor.ndim == 1:
            tensor = tensor[:, None]
        if tensor.ndim != 2 or tensor.shape[0] != rows or tensor.shape[1] not in (1, 3, 4):
            ctx.error(f"expected an array of shape ({rows}, 1) or ({rows}, 3), got {describe(data)}")
        if not bool(torch.isfinite(tensor.detach()).all()):
            ctx.error("has values that are not finite")
        install_tensor(self, name, data, values.to_channels(tensor, ctx))
        if name not in self.attribute_names:
            self.attribute_names.append(name)

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        width = 2 if field.name == "texcoords" else 3
        known = self._parameters.get("vertex_positions")
        rows = None if field.name == "vertices" or known is None else known.shape[0]
        return _rows(value, width, ctx, rows)

    def _install(self, name: str, field: Field, value: Any, ctx: Context) -> None:
        if field.kind == "indices":
            value = faces_of(value, self.vertex_positions.shape[0], ctx)
            self._buffers[name] = value
            return
        if name == "vertex_positions" and self.__dict__.get("_built", False):
            self._check_count(_rows(value, 3, ctx).shape[0], ctx)
        super()._install(name, field, value, ctx)

    def _check_count(self, count: int, ctx: Context) -> None:
        """ValueError if something else of the mesh does not fit to `count` new vertices."""
        if count == self.vertex_positions.shape[0]:
            return
        advice = "for a mesh of another kind assign a new one: scene[NAME] = Mesh(...)"
        if count == 0 or int(self.faces.max()) >= count:
            ctx.error(
                f"{count} vertices, but faces has the index {int(self.faces.max())}: assign faces of fewer vertices "
                f"first; {advice}"
            )
        for name in ("vertex_normals", "vertex_texcoords", *self.attribute_names):
            tensor = getattr(self, name, None)
            if tensor is None or name.startswith("face_") or (name == "vertex_normals" and self.computed_normals):
                continue
            first = "" if name in self.attribute_names else f"assign {name} = None first, and new ones afterwards; "
            ctx.error(f"{count} vertices, but {name} has {tensor.shape[0]} rows: {first}{advice}")

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name == "vertex_normals" and self.__dict__.get("_built", False):
            self.__dict__["computed_normals"] = False
        elif (
            name == "vertex_positions"
            and self.__dict__.get("computed_normals", False)
            and self.vertex_normals.shape != self.vertex_positions.shape
        ):
            self.refresh_normals()

    def takes_shape(self, name: str, tensor: torch.Tensor, state: Mapping[str, Any], prefix: str) -> bool:
        """Another topology, if everything that the checkpoint brings goes together."""
        own = {**self._parameters, **self._buffers}
        found = {n: state.get(prefix + n, t) for n, t in own.items() if t is not None}
        n_vertices, faces = found["vertex_positions"].shape[0], found["faces"]
        fits = faces.ndim == 2 and faces.shape[1:] == (3,) and len(faces) > 0
        fits = fits and int(faces.min()) >= 0 and int(faces.max()) < n_vertices
        for n, t in found.items():
            rows = faces.shape[0] if n.startswith("face") else n_vertices
            fits = fits and t.ndim == 2 and t.shape == (rows, own[n].shape[1])  # type: ignore[union-attr]
        return bool(fits)

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        computed = self.computed_normals
        super()._load_from_state_dict(*args, **kwargs)
        self.__dict__["computed_normals"] = computed  # loading with assign=True is no assignment of the user's

    def derivative_of(self, field: Field) -> str:
        if field.name == "normals" and all(kind in ("diffuse", "twosided") for kind in self._bsdf_types()):
            return "interior"  # nothing is seen through the surface
        return super().derivative_of(field)

    def _bsdf_types(self) -> list[str]:
        bsdf = self._child("bsdf")
        return [m.type for m in bsdf.modules() if isinstance(m, Plugin) and m.category == "bsdf"] if bsdf else []

    def normals_from_positions(self, positions: torch.Tensor) -> torch.Tensor:
        """Vertex normals (V, 3) of the mesh with other `positions`, weighted by the angles at each corner."""
        return vertex_normals(positions, on_host(self.faces) if positions.device.type == "cpu" else self.faces)

    def compute_normals(self) -> None:
        """Shade smooth, with normals that are computed from the positions and follow them from now on."""
        positions, faces = numbers_on_host(self.vertex_positions), numbers_on_host(self.faces)
        normals = vertex_normals(positions, faces)
        install_tensor(self, "vertex_normals", None, normals.to(self.vertex_positions.device))
        self.__dict__["computed_normals"] = True
        self.__dict__["_normals_of"] = (positions.clone(), faces.clone(), normals.clone())
        structure_changed()

    def refresh_normals(self, computed: torch.Tensor | None = None) -> None:
        """Computed normals after an edit of positions, faces or themselves; `computed` are they, if known already."""
        normals = self._parameters.get("vertex_normals")
        if not isinstance(normals, nn.Parameter):  # a substitute for one call, which is not ours to write to
            return
        positions, faces = numbers_on_host(self.vertex_positions), numbers_on_host(self.faces)
        # Numbers are compared, not version counters, which writes through `.data` do not advance.
        old_positions, old_faces, known = self.__dict__["_normals_of"]
        same = old_positions.dtype == positions.dtype and known.dtype == normals.dtype
        if not (same and torch.equal(old_positions, positions) and torch.equal(old_faces, faces)):
            known = vertex_normals(positions, faces) if computed is None else computed.detach()
            known = known.to("cpu", normals.dtype, copy=True)
            self.__dict__["_normals_of"] = (positions.clone(), faces.clone(), known)
        if normals.shape != known.shape:  # another number of vertices
            normals.data, normals.grad = torch.empty_like(known, device=normals.device), None
        if not torch.equal(numbers_on_host(normals), known):
            with torch.no_grad():
                normals.copy_(known)

    def adapt(self, ctx: Context) -> None:
        if self._color != ctx.color and ctx.color == "mono":
            for name in self.attribute_names:
                colours = self._parameters.get(name)
                if colours is not None and colours.shape[-1] == 3:
                    colours.data = values.luminance(colours.data)
        super().adapt(ctx)

    def bounds(self) -> torch.Tensor:
        positions = self.vertex_positions.detach()
        return torch.stack([positions.amin(0), positions.amax(0)])

    def extra_repr(self) -> str:
        return f"{self.vertex_positions.shape[0]} vertices, {self.faces.shape[0]} faces, " + super().extra_repr()


def _rows(value: Any, width: int, ctx: Context, rows: int | None = None) -> torch.Tensor:
    tensor = values.floating(value, ctx)
    if tensor.ndim != 2 or tensor.shape[1] != width or (rows is not None and tensor.shape[0] != rows):
        ctx.error(f"expected an array of shape ({'V' if rows is None else rows}, {width}), got {describe(value)}")
    return tensor.contiguous()


def faces_of(value: Any, n_vertices: int, ctx: Context) -> torch.Tensor:
    """Indices (F, 3) as contiguous int32, checked against the number of vertices."""
    try:
        tensor = value if isinstance(value, torch.Tensor) else torch.as_tensor(_integers(value))
    except (TypeError, ValueError, RuntimeError):
        ctx.error(f"expected integer indices of shape (F, 3), got {describe(value)}")
    if tensor.is_floating_point() or tensor.is_complex() or tensor.dtype == torch.bool:
        ctx.error(f"expected integer indices, got {describe(value)}")
    if tensor.ndim != 2 or tensor.shape[1] != 3:
        ctx.error(f"expected indices of shape (F, 3), got {describe(value)}")
    if tensor.shape[0] == 0:
        ctx.error("the mesh is empty: it has no faces")
    tensor = tensor.to(torch.int64)
    low, high = int(tensor.min()), int(tensor.max())
    if low < 0 or high >= n_vertices:
        row = int(((tensor < 0) | (tensor >= n_vertices)).any(1).nonzero()[0])
        ctx.error(f"face {row} has the index {low if low < 0 else high}, but there are {n_vertices} vertices")
    return tensor.to(torch.int32).contiguous()


def _integers(value: Any) -> Any:
    array = np.asarray(value)
    return array.astype("int64") if array.dtype.kind in "iu" else np.array(array)


def _faces_of_cube() -> tuple[list[list[float]], list[list[float]], list[list[float]], list[list[int]]]:
    # Each side: normal, then four corners in an order whose triangles (0, 1, 2), (3, 0, 2) face outside.
    sides: list[tuple[list[int], list[list[int]]]] = [
        ([0, -1, 0], [[1, -1, -1], [1, -1, 1], [-1, -1, 1], [-1, -1, -1]]),
        ([0, 1, 0], [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]]),
        ([1, 0, 0], [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]]),
        ([0, 0, 1], [[1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1]]),
        ([-1, 0, 0], [[-1, -1, 1], [-1, 1, 1], [-1, 1, -1], [-1, -1, -1]]),
        ([0, 0, -1], [[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]]),
    ]
    vertices = [[float(x) for x in corner] for _, corners in sides for corner in corners]
    normals = [[float(x) for x in normal] for normal, _ in sides for _ in range(4)]
    texcoords = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]] * 6
    faces = [[4 * s + i for i in triangle] for s in range(6) for triangle in ((0, 1, 2), (3, 0, 2))]
    return vertices, normals, texcoords, faces


class Cube(Mesh):
    """The cube [-1, 1]^3 under `to_world`, a mesh of 24 vertices.

    Args:
        to_world: 4x4 matrix.
        flip_normals: normals point inside.
        bsdf, emitter: material and area light.
        interior, exterior: media inside and outside.
    """

    def __init__(self, **properties: Any) -> None:
        for name in ("vertices", "faces", "vertex_normals", "vertex_texcoords", "face_normals"):
            if name in properties:
                ctx = properties.get("_context") or Context(path=("Cube",))
                ctx.error(f"cube has no parameter {name!r}; {nearest(name, self.parameter_names())}")
        vertices, normals, texcoords, faces = _faces_of_cube()
        super().__init__(
            vertices=vertices, faces=faces, vertex_normals=normals, vertex_texcoords=texcoords, **properties
        )

    @classmethod
    def parameter_names(cls) -> list[str]:
        return ["to_world", "flip_normals", "bsdf", "emitter", "interior", "exterior", "attributes"]


@builder("cube", "shape", (*Cube.parameter_names(), *SILHOUETTE))
def _cube(properties: dict[str, Any], ctx: Context) -> Plugin:
    return Cube(**properties, _context=ctx)
