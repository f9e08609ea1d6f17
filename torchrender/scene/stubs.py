"""The stub file of the models' classes, ``torchrender/_plugins.pyi``, which `main` writes."""

from __future__ import annotations

from pathlib import Path

from . import registry
from .declaration import CHILD_KINDS, Field
from .plugin import Plugin
from .signatures import signature_of

HEADER = """# The classes of all models; those that no file defines are generated from the native declaration. Made by:
#     python -c "from torchrender.scene import stubs; stubs.main()"
"""


def generated_classes() -> dict[str, type[Plugin]]:
    """Classes that no file defines, by name."""
    found = {}
    for name, (category, kind) in registry.public_classes().items():
        cls = registry.plugin_class(category, kind)
        if cls.__module__ == "torchrender" and cls.__name__ == name:
            found[name] = cls
    return dict(sorted(found.items()))


def written_classes() -> list[str]:
    """Import statements of the others, which `torchrender` gives under their own names."""
    found = set()
    for name, (category, kind) in registry.public_classes().items():
        cls = registry.plugin_class(category, kind)
        if cls.__module__ != "torchrender" and cls.__name__ == name:
            found.add(f"from {cls.__module__.removeprefix('torchrender')} import {name} as {name}")
    return sorted(found)


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
    imports += sorted([*written_classes(), "from .scene.plugin import Plugin"])
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
