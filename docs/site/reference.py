"""Pages of the reference, from the interface itself: every public name of torchrender is on exactly one of them."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

import torchrender as tr

# Pages of names that are said by hand; other names go by their category, or by the module that has them.
PAGES: dict[str, tuple[str, list[str]]] = {
    "scenes": ("Scenes", ["load_dict", "load_file", "load_colmap", "from_trimesh", "variants", "Scene", "Transform"]),
    "rendering": (
        "Rendering",
        "render Renderer reattach ray_intersect ray_occluded denoise tonemap show log_images progress "
        "show_config".split(),
    ),
    "integrators": ("Integrators", []),
    "shapes": ("Shapes", []),
    "bsdfs": ("BSDFs", ["TorchBSDF", "native_bsdf"]),
    "textures": ("Textures", []),
    "emitters": ("Emitters", []),
    "sensors": ("Sensors, film, samplers", ["Film", "ReconstructionFilter", "Sampler", "SAMPLERS"]),
    "media": ("Media, volumes, phase functions", []),
    "errors": ("Errors and warnings", []),
}
# What functions of these pages return.
RESULTS: dict[str, list[str]] = {
    "rendering": ["torchrender.queries.Hits"],
    "bsdfs": [
        "torchrender.scene.torch_bsdf.SurfaceInteraction",
        "torchrender.bsdfs.NativeBSDF",
        "torchrender.bsdfs.BsdfSamples",
    ],
    "sensors": ["torchrender.scene.camera_rays.Rays"],
    "testing": [
        f"torchrender.testing.probes.{name}"
        for name in ("BsdfEvaluation", "BsdfSamples", "EmitterDensity", "EmitterSamples")
    ],
}
CATEGORIES = {
    "shape": "shapes",
    "bsdf": "bsdfs",
    "texture": "textures",
    "emitter": "emitters",
    "sensor": "sensors",
    "medium": "media",
    "volume": "media",
    "phase": "media",
}
MODULES = (
    "backends constraints daylight distributed gradientindex heightfield integrators io optim polarization rotation "
    "sdfgrid spectrum testing typing"
).split()


def public_names() -> list[str]:
    """What ``from torchrender import *`` brings."""
    return [name for name in dir(tr) if not name.startswith("_")]


def public_of(module: str) -> list[str]:
    """Names that a module of torchrender gives its users: `__all__`, what `dir` says, or what is defined there."""
    found = importlib.import_module(f"torchrender.{module}")
    if hasattr(found, "__all__"):
        return list(found.__all__)
    inside = found.__name__ + "." if hasattr(found, "__path__") else found.__name__
    names = [name for name in dir(found) if not name.startswith("_")]
    objects = {name: getattr(found, name) for name in names}
    return [
        name
        for name, value in objects.items()
        if (inspect.isfunction(value) or inspect.isclass(value))
        and value.__module__.startswith(inside)
        and inspect.getdoc(value)
    ]


def page_of(name: str) -> str:
    """The page of the reference on which a public name is described."""
    for page, (_, names) in PAGES.items():
        if name in names:
            return page
    value = getattr(tr, name)
    if inspect.ismodule(value):
        return name
    if isinstance(value, type) and issubclass(value, (Exception, Warning)):
        return "errors"
    if isinstance(value, type) and issubclass(value, tr.Integrator):
        return "integrators"
    if getattr(value, "category", None) in CATEGORIES:
        return CATEGORIES[value.category]
    for module in MODULES:
        if getattr(value, "__module__", "").startswith(f"torchrender.{module}"):
            return module
    raise ValueError(f"torchrender.{name} belongs to no page of the reference (docs/site/reference.py)")


def described() -> dict[str, list[str]]:
    """The names on every page, with the module that they are reached by."""
    pages: dict[str, list[str]] = {page: [] for page in [*PAGES, *(m for m in MODULES if m not in PAGES)]}
    for name in public_names():
        page = page_of(name)
        if page in PAGES and not inspect.ismodule(getattr(tr, name)):
            pages[page].append(f"torchrender.{name}")
    for page, (_, names) in PAGES.items():  # in the order in which they are given
        given = [f"torchrender.{name}" for name in names]
        pages[page] = given + [name for name in pages[page] if name not in given]
    for module in MODULES:
        if module not in PAGES:
            pages[module] = [f"torchrender.{module}.{name}" for name in public_of(module)]
    for page, names in RESULTS.items():
        pages[page] += names
    return pages


def directive(name: str) -> str:
    """How Sphinx is told to describe a name."""
    module, _, attribute = name.rpartition(".")
    value = getattr(importlib.import_module(module), attribute)
    if isinstance(value, type):
        return f".. autoclass:: {name}\n   :members:\n"
    return f".. auto{'function' if callable(value) else 'data'}:: {name}\n"


def heading(title: str) -> str:
    return f"{title}\n{'=' * len(title)}\n"


def module_page(module: str, names: list[str]) -> str:
    """A page of a module: what it says of itself, a table of its names, and each of them."""
    if module == "typing":
        body = ".. automodule:: torchrender.typing\n   :members:\n   :undoc-members:\n   :member-order: bysource\n"
        return f"{heading('torchrender.typing')}\n{body}"
    name = f"torchrender.{module}"
    return f"{heading(name)}\n.. automodule:: {name}\n\n{names_of(names, name)}"


def names_of(names: list[str], module: str) -> str:
    """A table of these names, as seen from a module, and what each has to say."""
    summary = "\n".join("   " + name.removeprefix(module + ".") for name in names)
    return f".. autosummary::\n   :nosignatures:\n\n{summary}\n\n" + "\n".join(directive(name) for name in names)


def write_reference(folder: Path) -> list[str]:
    """Write the pages as reStructuredText, in which docstrings are; returns their names."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = described()
    for page, names in pages.items():
        if page in PAGES:
            text = f"{heading(PAGES[page][0])}\n.. py:currentmodule:: torchrender\n\n{names_of(names, 'torchrender')}"
        else:
            text = module_page(page, names)
        (folder / f"{page}.rst").write_text(text)
    entries = "\n".join(f"   {page}" for page in pages)
    words = (
        "Every public name with shapes, units, ranges and errors, from its docstring. "
        ":doc:`The interface, chapter by chapter <../api>` has the same in examples. In Python: ``help(tr.render)``.\n"
    )
    (folder / "index.rst").write_text(f"{heading('Reference')}\n{words}\n.. toctree::\n   :maxdepth: 1\n\n{entries}\n")
    return ["index", *pages]
