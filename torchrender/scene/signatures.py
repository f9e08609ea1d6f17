"""Signatures of the scene's classes, made from the declaration, for `help`, editors and the stub file."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

from .declaration import Field

if TYPE_CHECKING:
    from .plugin import Plugin

# What a value of each kind may be; the names are those of torchrender.typing.
ANNOTATIONS = {
    "spectrum": "Color",
    "texture": "TextureLike",
    "float": "Number",
    "point": "Vector",
    "vector": "Vector",
    "transform": "Matrix",
    "transform2": "Matrix",
    "tensor": "Array",
    "indices": "Array",
    "bsdf": "ObjectLike",
    "emitter": "ObjectLike",
    "shape": "ObjectLike",
    "medium": "ObjectLike",
    "phase": "ObjectLike",
    "volume": "VolumeLike",
}
# Parameters that no native field has, by name.
OTHERS = {
    "alpha_u": "TextureLike",
    "alpha_v": "TextureLike",
    "fov": "Number",
    "fov_axis": "str",
    "focal_length": "Number | str",
    "film": "Film | Mapping[str, Any]",
    "sampler": "Sampler | Mapping[str, Any]",
    "vertices": "Array",
    "vertex_normals": "Array",
    "vertex_texcoords": "Array",
    "attributes": "Mapping[str, Array]",
    "filename": "str | os.PathLike[str]",
    "bitmap": "Any",
    "grid": "Any",
    "use_grid_bbox": "bool",
    "raw": "bool",
    "int_ior": "Number | str",
    "ext_ior": "Number | str",
    "material": "str",
    "origin": "Vector",
    "direction": "Vector",
    "to_world": "Matrix",
    "name": "str",
}


class LazySignature:
    """``__signature__`` of a class, made when somebody asks."""

    def __get__(self, instance: Any, owner: type[Plugin]) -> inspect.Signature:
        return signature_of(owner)


def signature_of(cls: type[Plugin]) -> inspect.Signature:
    """The keyword arguments of `cls`: its explicit ones, then those that a scene dict may give."""
    if not cls.type:
        return inspect.Signature([inspect.Parameter("properties", inspect.Parameter.VAR_KEYWORD, annotation="Any")])
    found = {}
    for parameter in list(inspect.signature(cls.__init__).parameters.values())[1:]:
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            found[parameter.name] = parameter
    fields = cls.fields()
    for name in cls.parameter_names():
        if name in found or name in cls.inert:
            continue
        field = fields.get(cls.aliases.get(name, name))
        annotation = annotation_of(name, field, cls)
        default = default_of(name, field, cls)
        found[name] = inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=annotation + (" | None" if default is None else ""),
        )
    return inspect.Signature(list(found.values()), return_annotation=cls.__name__)


def annotation_of(name: str, field: Field | None, cls: type[Plugin]) -> str:
    """What a parameter of this name may be, in the names of `torchrender.typing`."""
    if field is None:
        return OTHERS.get(name, "Any")
    if field.kind != "int":
        return ANNOTATIONS.get(field.kind, "Any")
    if name in OTHERS:
        return OTHERS[name]
    return type(cls.decode(name, 0)).__name__


def default_of(name: str, field: Field | None, cls: type[Plugin]) -> Any:
    """The declared default where it is a plain value; None where the class finds one, or where there is none."""
    if field is None or field.default is None or field.optional:
        return None
    if name in OTHERS and field.kind != "texture":
        return None
    if field.kind == "int":
        return cls.decode(name, int(field.default))
    if field.kind == "volume" and field.default < 0:  # the core's word for none
        return None
    return field.default if field.kind in ("float", "spectrum", "texture", "volume") else None
