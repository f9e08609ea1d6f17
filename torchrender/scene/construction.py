"""How an object is built from what a scene dict says: every field gets a value, a default, a child or a reference."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import torch
from torch import nn

from ..errors import SubstitutionWarning, depth_outside, describe, nearest
from . import registry, spectra, values
from .context import Context, Reference
from .declaration import CHILD_KINDS, Field
from .structure import structure_changed

if TYPE_CHECKING:
    from .plugin import Plugin

Lookup: TypeAlias = "Callable[[str, Context], Plugin]"
"""Finds the object of an id, or raises an error that names the place where it is referred to."""


def construct(plugin: Plugin, properties: dict[str, Any], ctx: Context) -> None:
    """Give a new object its fields, from `properties` under their names in a scene dict."""
    for name in plugin.inert:
        if name in properties:
            check_inert(plugin, name, properties.pop(name), ctx)
    for name in plugin.unsupported:
        if name in properties:
            ctx.error(f"{plugin.type}: the documented parameter {name!r} is not supported by this version")
    properties = _unaliased(plugin, plugin.prepare(properties, ctx), ctx)
    fields = plugin.fields()
    check_names(plugin, properties, ctx)
    for name, field in fields.items():
        if name in properties and properties[name] is not None:
            plugin._install(name, field, properties[name], plugin.context_of(name, ctx.at(name)))
        else:
            _install_default(plugin, name, field, ctx.at(name))
    for name in [n for n in properties if n not in fields]:
        _install_nested(plugin, properties[name], ctx.at(name))
    plugin._fill(ctx)
    plugin.check(ctx)


def _unaliased(plugin: Plugin, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
    """`properties` under the names in Python."""
    for alias, name in plugin.aliases.items():
        if alias in properties and name in properties:
            ctx.error(f"{plugin.type}: {alias} and {name} are the same parameter; give one of them")
    return {plugin.aliases.get(name, name): value for name, value in properties.items()}


def check_inert(plugin: Plugin, name: str, value: Any, ctx: Context) -> None:
    """A value of a documented parameter without effect that would have one elsewhere: a warning, or ValueError."""
    accepted = plugin.inert[name]
    if name in plugin.noted and values.boolean(value, ctx.at(name)) not in accepted:
        substituted(ctx, f"{name}={value!r} {plugin.noted[name]}")
    elif accepted and value not in accepted:
        ctx.error(f"{name}={value!r} is not supported by this version; it can be {accepted[0]!r}")


def substituted(ctx: Context, text: str) -> None:
    """A `SubstitutionWarning` for the caller of this package, with the place in the scene."""
    warnings.warn(f"{ctx.where}: {text}" if ctx.path else text, SubstitutionWarning, stacklevel=depth_outside())


def check_names(plugin: Plugin, properties: Mapping[str, Any], ctx: Context) -> None:
    """ValueError for a name that is no parameter; objects may be nested under any name where they have a place."""
    nested = {f.kind for f in plugin.fields().values() if f.kind in CHILD_KINDS}
    for name, value in properties.items():
        if name in plugin.fields() or name in plugin.aliases:
            continue
        is_built = registry.is_plugin(value) or isinstance(value, Reference)
        if not (nested and (is_built or (isinstance(value, Mapping) and "type" in value))):
            hint = plugin.elsewhere.get(name) or nearest(str(name), plugin.parameter_names())
            ctx.error(f"{plugin.type} has no parameter {name!r}; {hint}")


def check_required(plugin: Plugin, ctx: Context) -> None:
    """ValueError for a field that has no default and was not given."""
    for name, field in plugin.fields().items():
        missing = (
            plugin._modules.get(name) is None and plugin._parameters.get(name) is None and name not in plugin.__dict__
        )
        required = field.default is None and field.kind in ("texture", "spectrum", "float")
        if missing and required and not field.optional and not plugin._waits_for(name):
            ctx.error(f"{plugin.type}: {name!r} is missing")


# ------------------------------------------------------------------------------------------------------ fields
def install(plugin: Plugin, name: str, field: Field, value: Any, ctx: Context) -> None:
    """Convert `value` and make it that of the field."""
    ctx = quantity(plugin, name, field, ctx)
    if field.kind == "int":
        plugin.__dict__[name] = plugin.convert_static(name, value, ctx)
    elif plugin._holds(field):
        install_tensor(plugin, name, value, plugin._convert(field, value, ctx))
        plugin._described.pop(name, None)
        if ctx.color is None and isinstance(value, Mapping):
            plugin._described[name] = (dict(value), ctx)  # for a scene in which it is no rgb colour
    elif field.kind == "indices":
        plugin.register_buffer(name, value)
    else:
        child = child_of(value, _category(field), ctx)
        if field.kind == "spectrum" and (isinstance(child, Reference) or child.type != "constant"):
            ctx.error("expected a number or a colour: this parameter cannot be a texture")
        if isinstance(child, Reference):
            plugin._references.append((name, child))
            plugin._modules[name] = None
        else:
            plugin._modules[name] = child


def _category(field: Field) -> str:
    """Of the child that stands in a field."""
    return "texture" if field.kind in ("texture", "spectrum") else field.kind


def quantity(plugin: Plugin, name: str, field: Field, ctx: Context) -> Context:
    """`ctx` with what spectra in this field stand for."""
    if plugin.category == "volume" or (plugin.category, plugin.type) == ("texture", "constant"):
        return ctx
    if plugin.category == "texture":
        return replace(ctx, emission=False)
    emission = plugin.category == "emitter" or name == "emission"
    return replace(ctx, emission=emission, bounded=field.max == 1)


def install_tensor(plugin: Plugin, name: str, given: Any, tensor: torch.Tensor) -> None:
    """Let `tensor`, which was made from what was `given`, be the parameter of this name."""
    plugin.__dict__.pop(name, None)
    if isinstance(given, nn.Parameter) and tensor is given:
        plugin._parameters[name] = given
    elif tensor.requires_grad or values.has_tangent(tensor):
        # A tensor that is part of a graph stays one, so that gradients reach where it came from.
        plugin._parameters.pop(name, None)
        plugin.__dict__[name] = tensor
    else:
        plugin._parameters[name] = nn.Parameter(tensor.detach().clone().contiguous(), requires_grad=False)


def _install_default(plugin: Plugin, name: str, field: Field, ctx: Context) -> None:
    if field.kind in CHILD_KINDS:
        plugin._modules[name] = None
    elif field.kind == "int":
        plugin.__dict__[name] = plugin.decode(name, 0 if field.default is None else int(field.default))
    elif field.optional or (field.default is None and field.kind not in ("transform", "transform2")):
        if field.kind in ("texture", "spectrum") and not plugin._holds(field):
            plugin._modules[name] = None
        else:
            plugin._parameters[name] = None
    elif field.kind == "transform":
        plugin._install(name, field, torch.eye(4), ctx)
    elif field.kind == "transform2":
        plugin._install(name, field, torch.eye(3), ctx)
    elif field.kind in ("point", "vector"):
        plugin._install(name, field, [field.default] * 3, ctx)
    else:
        plugin._install(name, field, field.default, ctx)


# ---------------------------------------------------------------------------------------------------- children
def _install_nested(plugin: Plugin, value: Any, ctx: Context) -> None:
    """A nested object under a key of the user's choice goes to the first free field of its category."""
    child = child_of(value, None, ctx)
    if isinstance(child, Reference):
        plugin._references.append((None, child))
    else:
        plugin.adopt(child, ctx)


def adopt(plugin: Plugin, child: Plugin, ctx: Context) -> None:
    """Put `child` into the first free field of its category."""
    names = [n for n, f in plugin.fields().items() if f.kind == child.category]
    if not names:
        kinds = sorted({f.kind for f in plugin.fields().values() if f.kind in CHILD_KINDS})
        ctx.error(f"a {plugin.type} cannot contain a {child.category} ({child.type}); it takes: {', '.join(kinds)}")
    for name in names:
        if plugin._modules.get(name) is None and not plugin._waits_for(name):
            plugin._modules[name] = child
            return
    ctx.error(f"{plugin.type}: more than {len(names)} nested objects of category {child.category}")


def resolve(plugin: Plugin, lookup: Lookup, ctx: Context) -> None:
    """Replace references by the objects that `lookup` finds, all or none; `check` is left to the caller."""
    pending = [(name, r, lookup(r.id, ctx.at(name or "ref"))) for name, r in plugin._references]
    plugin.__dict__["_references"] = []
    for name, reference, target in pending:
        if name is None:
            plugin.adopt(target, ctx)
        else:
            category = _category(plugin.fields()[name])
            if target.category != category:
                ctx.at(name).error(f"expected a {category}, but {reference.id!r} is a {target.category}")
            plugin._modules[name] = target
    if pending:
        structure_changed()


def _daylight(value: Mapping[str, Any], ctx: Context) -> Plugin | Reference:
    """The texture in a ``d65``, times its `scale`: daylight is white by convention."""
    nested = {k: v for k, v in value.items() if k not in ("type", "id", "scale")}
    if len(nested) > 1:
        ctx.error(f"d65: expected a colour or one texture, got {', '.join(nested)}")
    ((name, content),) = nested.items()
    is_object = registry.is_plugin(content) or isinstance(content, (Reference, Mapping))
    if not is_object:
        ctx.error(f"d65 has no parameter {name!r}; {nearest(str(name), ('color', 'scale'))}")
    child = child_of(content, "texture", ctx.at(str(name)))
    scale = values.number(value.get("scale", 1.0), ctx.at("scale"))
    if float(scale.detach()) != 1:
        if isinstance(child, Reference) or registry.is_plugin(content) or scale.requires_grad:
            ctx.at("scale").error("expected 1 with a texture that is not described here; give that its scale")
        factors = [tensor for _, tensor in child.texels()] or [child.scale]
        with torch.no_grad():
            for tensor in factors:
                tensor.mul_(scale)
    return child


def _refuse_word(word: str, category: str | None, ctx: Context) -> NoReturn:
    """ValueError for a word where an object belongs, with the dict that is probably meant."""
    types = registry.scene_types()
    hint = f"the object with this id is {{'type': 'ref', 'id': {word!r}}}"
    if word in types and category in (None, types[word]):
        hint = f"an object of this type is {{'type': {word!r}}}"
    elif category == "texture" and "." in word:
        hint = f"an image file is {{'type': 'bitmap', 'filename': {word!r}}}"
    elif category == "volume" and "." in word:
        hint = f"a file of voxels is {{'type': 'gridvolume', 'filename': {word!r}}}"
    expected = {
        "texture": "a number, a colour, texels or a texture",
        "volume": "a number, a colour, voxels or a volume",
    }
    what = expected.get(category or "", f"a {category or 'nested object'} (a dict or a built object)")
    ctx.error(f"expected {what}, got {describe(word)}; {hint}")


def child_of(value: Any, category: str | None, ctx: Context) -> Plugin | Reference:
    """`value` as an object of `category` (any if None).

    Built objects, dicts and references; numbers and arrays as textures or volumes where these are wanted.
    """
    if registry.is_plugin(value):
        if category is not None and value.category != category:
            ctx.error(f"expected a {category}, got a {value.category} ({value.type})")
        if ctx.color is not None:
            value.adapt(ctx)
        return value
    if isinstance(value, Reference):
        return value
    if isinstance(value, nn.Module) and category in (None, "bsdf"):
        ctx.error(f"to be a BSDF, a torch.nn module has to be derived from tr.TorchBSDF; got {describe(value)}")
    if isinstance(value, Mapping):
        if value.get("type") == "ref":
            extra = [k for k in value if k not in ("type", "id")]
            if extra or not isinstance(value.get("id"), str):
                ctx.error(f"a reference is {{'type': 'ref', 'id': NAME}}, got {describe(dict(value))}")
            return Reference(value["id"])
        if spectra.is_spectrum(value):
            if (
                value["type"] == "d65"
                and category == "texture"
                and not value.keys() <= {"type", "id", "color", "scale"}
            ):
                return _daylight(value, ctx)
            if category == "volume":
                return registry.build({"type": "constvolume", "value": value}, ctx, category)
            if category != "texture":
                ctx.error(f"expected a {category or 'nested object'}, got a colour")
            return registry.constant(value, ctx)
        return registry.build(value, ctx, category)
    if isinstance(value, str):
        _refuse_word(value, category, ctx)
    if category == "texture":
        if type(value).__module__.partition(".")[0] == "PIL":
            return registry.build({"type": "bitmap", "bitmap": value}, ctx, "texture")
        dimensions = values.floating(value, ctx).ndim
        if dimensions == 3:
            return registry.build({"type": "bitmap", "data": value}, ctx, "texture")
        if dimensions > 1:
            ctx.error(
                f"expected a number, a colour of three numbers or texels (H, W, C), got {describe(value)}"
                + ("; texels (H, W) of one channel are value[..., None]" if dimensions == 2 else "")
            )
        return registry.constant(value, ctx)
    if category == "volume":
        dimensions = values.floating(value, ctx).ndim
        if dimensions in (3, 4):
            return registry.build({"type": "gridvolume", "data": value}, ctx, "volume")
        if dimensions > 1:
            ctx.error(
                "expected a number, a colour of three numbers or voxels (Z, Y, X) or (Z, Y, X, C), got "
                f"{describe(value)}"
            )
        return registry.build({"type": "constvolume", "value": value}, ctx, "volume")
    if type(value).__module__.partition(".")[0] == "trimesh":
        ctx.error(f"{describe(value)} becomes a shape by tr.Mesh(vertices=mesh.vertices, faces=mesh.faces)")
    hint = f"; it is a class, of which {value.__name__}(...) makes an object" if isinstance(value, type) else ""
    ctx.error(f"expected a {category or 'nested object'} (a dict or a built object), got {describe(value)}{hint}")
