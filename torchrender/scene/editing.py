"""Edits of built objects: a field gets a new value, and an object the dtype and colour mode of the scene it joins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

import torch
from torch import nn

from ..errors import nearest
from . import construction, spectra, values
from .construction import check_inert
from .context import SAMPLES, Context, Reference
from .declaration import Field
from .host_memory import move
from .structure import structure_changed

if TYPE_CHECKING:
    from .plugin import Plugin


def assign(plugin: Plugin, name: str, field: Field, value: Any) -> None:
    """``plugin.name = value``, converted and checked as when the object was built; an error leaves it as it was."""
    ctx, place = plugin._own_context(name), plugin._place()
    if isinstance(value, torch.Tensor):
        ctx = replace(ctx, device=place)
    if value is None:
        if plugin._holds(field) and not field.optional:
            ctx.error("None removes a parameter, but this one is required")
        (plugin._parameters if plugin._holds(field) else plugin._modules)[name] = None
    elif isinstance(value, torch.Tensor) and value.requires_grad and not value.is_leaf:
        ctx.error("a tensor that is the result of a computation is passed with render(..., params={name: tensor})")
    else:
        kept = plugin._parameters.get(name)
        restore = snapshot(plugin)
        # Of a leaf the numbers are taken and the wish for gradients: the scene's parameter stays a parameter.
        asks = isinstance(value, torch.Tensor) and value.requires_grad and not _is_own(plugin, field, value, ctx)
        try:
            with ctx.device:
                plugin._install(name, field, value.detach() if asks else value, plugin.context_of(name, ctx))
            _settle(plugin, name, ctx)
            plugin.check(Context(path=(type(plugin).__name__,)))
        except Exception:
            restore()
            raise
        new, child = plugin._parameters.get(name), plugin._child(name)
        if new is not None and new.device != place:
            plugin._parameters[name] = new = nn.Parameter(new.detach().to(place), requires_grad=new.requires_grad)
        if child is not None:
            move(child, place)
        if asks:
            for tensor in [new] if child is None else [t for _, t in child.texels()]:
                if tensor is not None:
                    tensor.requires_grad_()
        elif kept is not None and new is not None and not isinstance(value, nn.Parameter):
            new.requires_grad_(kept.requires_grad)
    structure_changed()


def assign_word(plugin: Plugin, name: str, value: Any) -> None:
    """``plugin.name = value`` for what is no field: a word of scene dicts that stands for fields, else an error."""
    ctx = plugin._own_context(name)
    if name in plugin.inert:
        check_inert(plugin, name, value, ctx)
    elif name in plugin.words:
        with ctx.device:
            found = plugin.prepare({name: value}, ctx)
        for field, content in found.items():
            setattr(plugin, field, content)
    elif name in plugin.parameter_names():
        ctx.error(
            f"{name!r} is read when the object is made; assign {nearest('', plugin.fields()).partition(': ')[2]}, "
            "or another object in its place"
        )
    else:
        raise AttributeError(f"{type(plugin).__name__} has no parameter {name!r}; {plugin.hint(name)}")


def _is_own(plugin: Plugin, field: Field, value: torch.Tensor, ctx: Context) -> bool:
    """Whether `value` is a parameter that becomes the object's own, as it is."""
    if not isinstance(value, nn.Parameter):
        return False
    return not plugin._holds(field) or plugin._convert(field, value, ctx) is value


def _settle(plugin: Plugin, name: str, ctx: Context) -> None:
    """After the assignment of a child: there is no scene here in which a reference could be looked up."""
    child = plugin._child(name)
    if child is None:
        for missing in [r for n, r in plugin._references if n == name]:
            _refuse_reference(missing, ctx)
        return
    for module in child.modules():
        for _, reference in getattr(module, "_references", ()):
            _refuse_reference(reference, ctx)
    # A reference that was still waiting for its scene gives way to this child.
    plugin.__dict__["_references"] = [r for r in plugin._references if r[0] != name]


def _refuse_reference(reference: Reference, ctx: Context) -> NoReturn:
    ctx.error(
        f"references are looked up when a scene is loaded and in scene[NAME] = ...; "
        f"here assign the object itself: scene[{reference.id!r}]"
    )


def snapshot(plugin: Plugin) -> Callable[[], None]:
    """A function that gives the object its present tensors, children and references back, in their order."""
    stores: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (store, dict(store)) for store in (plugin._parameters, plugin._modules, plugin._buffers)
    ]
    own = {n: plugin.__dict__[n] for n in plugin.fields() if n in plugin.__dict__}
    references = list(plugin._references)

    def restore() -> None:
        for store, content in stores:
            store.clear()
            store.update(content)
        for name in plugin.fields():
            plugin.__dict__.pop(name, None)
        plugin.__dict__.update(own)
        plugin.__dict__["_references"] = references

    return restore


def adapt(plugin: Plugin, ctx: Context) -> None:
    """Take over colour mode and dtype of a scene, down to all children; parameters keep their identity."""
    recolor = plugin._color != ctx.color and ctx.color == "mono"

    def adapted(name: str, tensor: torch.Tensor) -> torch.Tensor:
        field = plugin.fields().get(name)
        if field is not None and field.kind == "spectrum" and plugin._color != ctx.color:
            tensor = _as_described(plugin, name, tensor, ctx)
        if recolor and name in ("value", "data") and tensor.ndim in (1, 3, 4) and tensor.shape[-1] == 3:
            tensor = values.luminance(tensor)
        return tensor.to(dtype=ctx.dtype)

    for name, parameter in plugin._parameters.items():
        if parameter is not None:
            parameter.data = adapted(name, parameter.data).contiguous()
    for name in plugin.fields():
        tensor = plugin.__dict__.get(name)
        if isinstance(tensor, torch.Tensor):  # part of a graph, which this extends
            plugin.__dict__[name] = adapted(name, tensor)
    plugin.__dict__["_color"] = ctx.color
    plugin.__dict__["_wavelength"] = ctx.wavelength
    for name in plugin._modules:
        child = plugin._child(name)
        if child is not None:
            field = plugin.fields().get(name)
            inner = plugin.context_of(name, ctx)
            child.adapt(inner if field is None else construction.quantity(plugin, name, field, inner))


def _as_described(plugin: Plugin, name: str, tensor: torch.Tensor, ctx: Context) -> torch.Tensor:
    """A colour in another colour mode: by the spectrum that it was described with, if it still is its colour."""
    if tensor.shape == (SAMPLES,):
        return spectra.from_table(tensor, ctx)
    described = plugin._described.get(name)
    if not (ctx.color == "spectral" or ctx.wavelength) or described is None or tensor.requires_grad:
        return tensor
    value, before = described
    before = replace(before, dtype=tensor.dtype, device=tensor.device)
    if not torch.equal(spectra.from_dict(value, before), tensor):
        return tensor
    return spectra.from_dict(value, replace(before, color=ctx.color, wavelength=ctx.wavelength))
