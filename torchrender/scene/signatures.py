"""Signatures of the scene's classes, made from the declaration, for help, editors and type checkers.

`main` writes ``torchrender/_plugins.pyi``, the types of those classes that exist only as declarations.
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .declaration import CHILD_KINDS, Field

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
    "film": "ObjectLike",
    "sampler": "ObjectLike",
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
    if field is None:
        return OTHERS.get(name, "Any")
    if field.kind != "int":
        return ANNOTATIONS.get(field.kind, "Any")
    if name in OTHERS:
        return OTHERS[name]
    return type(cls._decode(name, 0)).__name__


def default_of(name: str, field: Field | None, cls: type[Plugin]) -> Any:
    """The declared default where it is a plain value; None where the class finds one, or where there is none."""
    if field is None or field.default is None or name in cls.optional:
        return None
    if name in OTHERS and field.kind != "texture":
        return None
    if field.kind == "int":
        return cls._decode(name, int(field.default))
    if field.kind == "volume" and field.default < 0:  # the core's word for none
        return None
    return field.default if field.kind in ("float", "spectrum", "texture", "volume") else None


HEADER = """# Types of the classes that are generated from the native declaration, made by:
#     python -c "from torchrender.scene import signatures; signatures.main()"
"""


def generated_classes() -> dict[str, type[Plugin]]:
    """Classes that no file defines, by name."""
    from . import registry

    found = {}
    for name, (category, kind) in registry.public_classes().items():
        cls = registry.plugin_class(category, kind)
        if cls.__module__ == "torchrender" and cls.__name__ == name:
            found[name] = cls
    return dict(sorted(found.items()))


def stub() -> str:
    """The text of ``_plugins.pyi``."""
    lines = []
    for name, cls in generated_classes().items():
        lines += ["", f"class {name}(Plugin):", f'    """{cls.model().doc}"""', "", "    def __init__("]
        keywords = [p for p in signature_of(cls).parameters.values() if p.kind is p.KEYWORD_ONLY]
        lines += ["        self,", "        *,"] if keywords else ["        self,"]
        lines += [f"        {p.name}: {p.annotation} = {p.default!r}," for p in keywords]
        lines += ["        **properties: Any,", "    ) -> None: ..."]
        lines += [f"    {field_name}: {_attribute(field)}" for field_name, field in cls.fields().items()]
    body = "\n".join(lines)
    names = [
        n
        for n in ("Array", "Color", "Matrix", "Number", "ObjectLike", "TextureLike", "Vector", "VolumeLike")
        if f": {n}" in body
    ]
    imports = ["from typing import Any\n"]
    if "torch.Tensor" in body:
        imports.append("import torch\n")
    imports.append("from .scene.plugin import Plugin")
    imports.append(f"from .typing import {', '.join(names)}")
    return HEADER + "\n" + "\n".join(imports) + "\n" + body + "\n"


def _attribute(field: Field) -> str:
    """What reading the attribute of a built object gives."""
    if field.kind in ("spectrum", "texture", *CHILD_KINDS):
        return "Any"  # an object of any class of that category, with attributes of its own
    return "Any" if field.kind == "int" else "torch.Tensor"


def main() -> None:
    """Write the types where type checkers look for them."""
    path = Path(__file__).resolve().parent.parent / "_plugins.pyi"
    path.write_text(stub())
