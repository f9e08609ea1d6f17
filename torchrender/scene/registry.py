"""From a type name to a class: hand-written classes where a model needs one, generated ones elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, TypeVar

from ..errors import describe, nearest
from .context import Context
from .declaration import Model, categories, models

if TYPE_CHECKING:  # objects are built by way of this file, so that it is imported first
    from .plugin import Plugin

Builder: TypeAlias = "Callable[[dict[str, Any], Context], Plugin]"
PluginClass = TypeVar("PluginClass", bound="type[Plugin]")

_classes: dict[tuple[str, str], type[Plugin]] = {}  # by category and native model; the base of all under ("", "")
_builders: dict[str, tuple[str, Builder]] = {}  # scene types that are no native model: name -> (category, function)
_builder_names: dict[str, tuple[str, ...]] = {}

PARTS: dict[str, tuple[str, str]] = {}  # what only others have: by type, what it is and whose

INTERNAL = frozenset({"attribute"})  # categories that have no class of their own

# What Mitsuba 3 documents, to tell "not supported here" from "unknown".
DOCUMENTED: dict[str, tuple[str, ...]] = {
    "bsdf": tuple(
        "blendbsdf bumpmap circular conductor dielectric diffuse hair mask measured measured_polarized normalmap null "
        "plastic polarizer pplastic principled principledthin retarder roughconductor roughdielectric roughplastic "
        "thindielectric twosided".split()
    ),
    "emitter": tuple(
        "area constant directional directionalarea envmap point projector spot sunsky timed_sunsky volumelight".split()
    ),
    "shape": tuple(
        "bsplinecurve cube cylinder disk ellipsoids ellipsoidsmesh instance linearcurve merge obj ply rectangle "
        "sdfgrid serialized shapegroup sphere".split()
    ),
    "texture": ("bitmap", "checkerboard", "mesh_attribute", "volume"),
    "sensor": tuple("batch distant irradiancemeter orthographic perspective radiancemeter thinlens".split()),
    "medium": ("heterogeneous", "homogeneous"),
    "volume": ("constvolume", "gridvolume"),
    "phase": tuple("blendphase hg isotropic rayleigh sggx tabphase".split()),
    "film": ("hdrfilm", "specfilm"),
    "sampler": tuple("independent ldsampler multijitter orthogonal stratified".split()),
    "rfilter": tuple("box catmullrom gaussian lanczos mitchell tent".split()),
}


# What to do about types that are documented there and not here.
ADVICE = {
    "measured": "tables of measured materials are not read; a fitted roughconductor or principled comes nearest",
    "measured_polarized": "tables of measured materials are not read, and light is rendered without polarisation",
    "ellipsoids": "a mesh for each of the ellipsoids takes their place",
    "ellipsoidsmesh": "a mesh with the shells' vertices and faces takes its place",
    "timed_sunsky": "there are no averages over days and hours; sunsky is the light of one time",
    "volumelight": "light from a volume is the parameter 'emission' of a medium",
    "sggx": "hg with a g near 0 comes nearest; unsupported='substitute' takes isotropic",
}


def register(cls: PluginClass) -> PluginClass:
    """Class decorator: use this class for its category and native model, as a base if it names none."""
    _classes[cls.category, cls.native or cls.type] = cls
    return cls


def is_plugin(value: Any) -> TypeGuard[Plugin]:
    """Whether `value` is a built object of a scene."""
    return isinstance(value, _classes["", ""])


def builder(kind: str, category: str, names: Iterable[str] = ()) -> Callable[[Builder], Builder]:
    """Decorator: use this function for a scene type that is no native model of its own; it takes these parameters."""

    def add(function: Builder) -> Builder:
        _builders[kind] = (category, function)
        _builder_names[kind] = tuple(names)
        return function

    return add


def accepted_names(kind: str) -> tuple[str, ...]:
    """The parameters that a scene dict of this type may have, in all spellings."""
    if kind in _builders:
        return _builder_names[kind]
    cls = plugin_class(scene_types()[kind], kind)
    return (*cls.parameter_names(), *cls.fields(), *cls.aliases, *cls.inert)


def plugin_class(category: str, kind: str) -> type[Plugin]:
    """The class of a model, generated on first use if nobody wrote one."""
    found = _classes.get((category, kind))
    if found is None:
        model = models()[category, kind]
        name = class_name(model)
        lines = [f"{model.doc}\n\nArgs:"] + [f"    {f.name}: {f.doc} ({f.kind})" for f in model.fields]
        found = type(
            name,
            (_classes["", ""],),
            {
                "category": category,
                "type": kind,
                "__doc__": "\n".join(lines),
                "__module__": "torchrender",
                "__qualname__": name,
            },
        )
        _classes[category, kind] = found
    return found


def class_name(model: Model) -> str:
    """Of the class in Python: the declared name, or the type in capitals."""
    return model.class_name or _camel(model.type)


def _camel(kind: str) -> str:
    return "".join(part.capitalize() for part in kind.split("_"))


def declared_classes() -> dict[str, tuple[str, str]]:
    """Names of all generated and hand-written classes, and for each its category and type."""
    return {class_name(model): key for key, model in models().items() if model.category not in INTERNAL}


def public_classes() -> dict[str, tuple[str, str]]:
    """The same with further names."""
    names = declared_classes()
    for category, kind in models():  # the type name in capitals works too where it is free: tr.Envmap
        if category not in INTERNAL and (category, kind) != ("texture", "constant"):
            names.setdefault(_camel(kind), (category, kind))
    return names


def scene_types() -> dict[str, str]:
    """Every type name that a scene dict may use, and its category."""
    found = {}
    for category, kinds in categories().items():
        if category in INTERNAL:
            continue
        for kind in kinds:
            if (category, kind) != ("texture", "constant"):  # in a scene, "constant" is the emitter
                found[kind] = category
    for kind, (category, _) in _builders.items():
        found[kind] = category
    return found


def build(value: Mapping[str, Any], ctx: Context, category: str | None = None) -> Plugin:
    """The object that a dict describes, of `category` if that is given."""
    kind = value.get("type")
    if not isinstance(kind, str):
        ctx.error(f"a dict that describes an object needs a 'type', got {describe(dict(value))}")
    types = scene_types()
    if kind not in types or (category is not None and types[kind] != category):
        unknown_type(kind, ctx, category, types)
    for key in value:
        if not isinstance(key, str):
            ctx.error(f"names in a scene are strings, got {describe(key)}")
    properties = {k: v for k, v in value.items() if k not in ("type", "id")}
    if kind in _builders:
        made = _builders[kind][1](properties, ctx)
    else:
        made = plugin_class(types[kind], kind)(**properties, _context=ctx)
    identifier = value.get("id")
    if identifier is not None:
        if not isinstance(identifier, str):
            ctx.error(f"id: expected a string, got {describe(identifier)}")
        made.__dict__["id"] = identifier
    return made


def check_part(kind: str, ctx: Context) -> None:
    """ValueError for what stands in a sensor or a film alone."""
    if kind in PARTS:
        what, owner = PARTS[kind]
        ctx.error(f"a {what} ({kind}) belongs into a {owner}")


def unknown_type(kind: str, ctx: Context, category: str | None, types: Mapping[str, str]) -> None:
    """ValueError that says whether `kind` is misplaced, not supported yet, or misspelt."""
    what = category or "object"
    if kind in types:
        ctx.error(f"expected a {what}, got {kind!r}, which is a {types[kind]}")
    check_part(kind, ctx)
    for group, kinds in DOCUMENTED.items():
        if kind in kinds:
            have = sorted(k for k, c in types.items() if c == group)
            listing = f"; supported are: {', '.join(have)}" if have else ""
            listing = f": {ADVICE[kind]}{listing}" if kind in ADVICE else listing
            ctx.error(f"the {group} {kind!r} is not supported by this version of torchrender{listing}")
    known = [k for k, c in types.items() if category in (None, c)]
    ctx.error(f"unknown {what} type {kind!r}; {nearest(kind, known)}")


def constant(value: Any, ctx: Context) -> Plugin:
    """A texture of one colour."""
    return plugin_class("texture", "constant")(value=value, _context=ctx)
