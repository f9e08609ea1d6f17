"""The one module class behind every BSDF, texture, emitter, shape and sensor.

A `Plugin` is generated from the native declaration of its model: continuous fields are parameters (tensors), static
ones plain attributes, nested models child modules. What a model needs beyond that (other names for a field, values read
from a file) is a subclass that overrides `Plugin.prepare`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar, NoReturn

import torch
from torch import nn

from ..errors import describe, nearest
from . import values
from .context import Context, Reference
from .declaration import CHILD_KINDS, TENSOR_KINDS, Field, Model, models
from .signatures import LazySignature

BOOLEANS = frozenset("flip_normals face_normals per_face nonlinear flip_invalid_normals use_shadowing_function".split())
ENUMERATIONS: dict[str, tuple[str, ...]] = {
    "filter_type": ("bilinear", "nearest"),
    "wrap_mode": ("repeat", "mirror", "clamp"),
    "distribution": ("beckmann", "ggx"),
}

_epoch = 0


def structure_epoch() -> int:
    """Grows whenever the structure of any scene object changes; what a scene has packed is then looked at again."""
    return _epoch


def structure_changed() -> None:
    global _epoch
    _epoch += 1


class Plugin(nn.Module):
    """Base of all scene objects. Keyword arguments are the model's parameters under their names in a scene dict."""

    __signature__ = LazySignature()
    category: ClassVar[str] = ""
    type: ClassVar[str] = ""
    native: ClassVar[str] = ""  # the native model, where that is not named as `type` is
    renames: ClassVar[dict[str, str]] = {}  # native field -> name in Python
    aliases: ClassVar[dict[str, str]] = {}  # further names, those of a scene dict -> name in Python
    enumerations: ClassVar[dict[str, tuple[str, ...]]] = ENUMERATIONS
    optional: ClassVar[frozenset[str]] = frozenset()  # absent unless given: the native default applies
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {}  # documented parameters without effect here: accepted values
    unsupported: ClassVar[tuple[str, ...]] = ()  # documented parameters that are not supported

    def __init__(self, *unnamed: Any, **properties: Any) -> None:
        if unnamed:
            raise TypeError(f"{type(self).__name__}: parameters are given by name, but {describe(unnamed[0])} has none")
        context = properties.pop("_context", None) or Context(path=(type(self).__name__,))
        super().__init__()
        self.__dict__["_references"] = []
        self.__dict__["_color"] = context.color
        self.__dict__["_built"] = False
        with context.device:  # whatever torch's default is
            self._setup(properties, context)
        self.__dict__["_built"] = True

    # ---------------------------------------------------------------------------------------------- declaration
    @classmethod
    def model(cls) -> Model:
        """The native declaration of this class."""
        return models()[cls.category, cls.native or cls.type]

    @classmethod
    def fields(cls) -> dict[str, Field]:
        """Declared fields by their name in Python, in packing order."""
        cached = cls.__dict__.get("_fields_cache")
        if cached is None:
            cached = {cls.renames.get(f.name, f.name): f for f in cls.model().fields}
            cls._fields_cache = cached
        return cached

    @classmethod
    def parameter_names(cls) -> list[str]:
        """Names accepted in a scene dict."""
        shown = {name: alias for alias, name in cls.aliases.items()}
        return [*(shown.get(name, name) for name in cls.fields()), *cls.inert]

    # ------------------------------------------------------------------------------------------------- building
    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        """Turn what a scene dict says into values of declared fields. Subclasses override this."""
        return properties

    def context_of(self, name: str, ctx: Context) -> Context:
        """What the value of this name is built with."""
        return ctx

    def _setup(self, properties: dict[str, Any], ctx: Context) -> None:
        for name, accepted in self.inert.items():
            if name in properties:
                value = properties.pop(name)
                if accepted and value not in accepted:
                    ctx.error(f"{name}={value!r} is not supported by this version; it can be {accepted[0]!r}")
        for name in self.unsupported:
            if name in properties:
                ctx.error(f"{self.type}: the documented parameter {name!r} is not supported by this version")
        properties = self._unaliased(self.prepare(properties, ctx), ctx)
        fields = self.fields()
        self._check_names(properties, ctx)
        for name, field in fields.items():
            if name in properties and properties[name] is not None:
                self._install(name, field, properties[name], self.context_of(name, ctx.at(name)))
            else:
                self._install_default(name, field, ctx.at(name))
        for name in [n for n in properties if n not in fields]:
            self._install_nested(properties[name], ctx.at(name))
        self._fill(ctx)
        self.check(ctx)

    def _unaliased(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        """`properties` under the names in Python."""
        for alias, name in self.aliases.items():
            if alias in properties and name in properties:
                ctx.error(f"{self.type}: {alias} and {name} are the same parameter; give one of them")
        return {self.aliases.get(name, name): value for name, value in properties.items()}

    def _check_names(self, properties: Mapping[str, Any], ctx: Context) -> None:
        nested = {f.kind for f in self.fields().values() if f.kind in CHILD_KINDS}
        for name, value in properties.items():
            if name in self.fields() or name in self.aliases:
                continue
            looks_nested = isinstance(value, (Plugin, Reference)) or (isinstance(value, Mapping) and "type" in value)
            if not (nested and looks_nested):
                ctx.error(f"{self.type} has no parameter {name!r}; {nearest(str(name), self.parameter_names())}")

    def _install_default(self, name: str, field: Field, ctx: Context) -> None:
        if field.kind in CHILD_KINDS:
            self._modules[name] = None
        elif field.kind == "int":
            self.__dict__[name] = self._decode(name, 0 if field.default is None else int(field.default))
        elif name in self.optional or (field.default is None and field.kind not in ("transform", "transform2")):
            if field.kind in ("texture", "spectrum") and not self._leaf(field):
                self._modules[name] = None
            else:
                self._parameters[name] = None
        elif field.kind == "transform":
            self._install(name, field, torch.eye(4), ctx)
        elif field.kind == "transform2":
            self._install(name, field, torch.eye(3), ctx)
        elif field.kind in ("point", "vector"):
            self._install(name, field, [field.default] * 3, ctx)
        else:
            self._install(name, field, field.default, ctx)

    def _fill(self, ctx: Context) -> None:
        """Required fields that are still missing. Subclasses add what is not declared natively."""
        for name, field in self.fields().items():
            missing = (
                self._modules.get(name) is None and self._parameters.get(name) is None and name not in self.__dict__
            )
            required = field.default is None and field.kind in ("texture", "spectrum", "float")
            if missing and required and name not in self.optional and not any(r[0] == name for r in self._references):
                ctx.error(f"{self.type}: {name!r} is missing")

    @classmethod
    def _leaf(cls, field: Field) -> bool:
        """Whether a tensor of this field is a parameter of this module, and not of a nested constant."""
        return field.kind in TENSOR_KINDS and not (field.kind == "spectrum" and cls.category != "texture")

    def _install(self, name: str, field: Field, value: Any, ctx: Context) -> None:
        ctx = self._quantity(name, field, ctx)
        if field.kind == "int":
            self.__dict__[name] = self._encode_check(name, value, ctx)
        elif self._leaf(field):
            self._install_tensor(name, value, self._convert(field, value, ctx))
        elif field.kind == "indices":
            self.register_buffer(name, value)
        else:
            category = "texture" if field.kind in ("texture", "spectrum") else field.kind
            child = child_of(value, category, ctx)
            if field.kind == "spectrum" and not (isinstance(child, Plugin) and child.type == "constant"):
                ctx.error("expected a number or a colour: this parameter cannot be a texture")
            self._install_child(name, child)

    def _quantity(self, name: str, field: Field, ctx: Context) -> Context:
        """`ctx` with what spectra in this field stand for."""
        if self.category == "volume" or (self.category, self.type) == ("texture", "constant"):
            return ctx
        if self.category == "texture":
            return replace(ctx, emission=False)
        emission = self.category == "emitter" or name == "emission"
        return replace(ctx, emission=emission, bounded=field.max == 1)

    def _install_child(self, name: str, child: Plugin | Reference) -> None:
        if isinstance(child, Reference):
            self._references.append((name, child))
            self._modules[name] = None
        else:
            self._modules[name] = child

    def _install_tensor(self, name: str, given: Any, tensor: torch.Tensor) -> None:
        self.__dict__.pop(name, None)
        if isinstance(given, nn.Parameter) and tensor is given:
            self._parameters[name] = given
        elif tensor.requires_grad or values.has_tangent(tensor):
            # A tensor that is part of a graph stays one, so that gradients reach where it came from.
            self._parameters.pop(name, None)
            self.__dict__[name] = tensor
        else:
            self._parameters[name] = nn.Parameter(tensor.detach().clone().contiguous(), requires_grad=False)

    def _install_nested(self, value: Any, ctx: Context) -> None:
        """A nested object under a key of the user's choice goes to the first free field of its category."""
        child = child_of(value, None, ctx)
        if isinstance(child, Reference):
            self._references.append((None, child))
        else:
            self.adopt(child, ctx)

    def adopt(self, child: Plugin, ctx: Context) -> None:
        """Put `child` into the first free field of its category."""
        names = [n for n, f in self.fields().items() if f.kind == child.category]
        if not names:
            kinds = sorted({f.kind for f in self.fields().values() if f.kind in CHILD_KINDS})
            ctx.error(f"a {self.type} cannot contain a {child.category} ({child.type}); it takes: {', '.join(kinds)}")
        for name in names:
            if self._modules.get(name) is None and not any(r[0] == name for r in self._references):
                self._modules[name] = child
                return
        ctx.error(f"{self.type}: more than {len(names)} nested objects of category {child.category}")

    def resolve(self, lookup: Any, ctx: Context) -> None:
        """Replace references by the objects that `lookup` finds, all or none; `check` is left to the caller."""
        pending = [(name, r, lookup(r.id, ctx.at(name or "ref"))) for name, r in self._references]
        self.__dict__["_references"] = []
        for name, reference, target in pending:
            if name is None:
                self.adopt(target, ctx)
            else:
                field = self.fields()[name]
                category = "texture" if field.kind in ("texture", "spectrum") else field.kind
                if target.category != category:
                    ctx.at(name).error(f"expected a {category}, but {reference.id!r} is a {target.category}")
                self._modules[name] = target
        if pending:
            structure_changed()

    # ------------------------------------------------------------------------------------------------ conversion
    def _convert(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        if field.kind == "spectrum":
            return values.spectrum(value, ctx)
        if field.kind == "float":
            return values.number(value, ctx)
        if field.kind in ("point", "vector"):
            return values.vector(value, ctx)
        if field.kind == "transform":
            return values.matrix(value, 4, ctx)
        if field.kind == "transform2":
            return values.matrix(value, 3, ctx)
        return self.convert_tensor(field, value, ctx)

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        """A tensor of a size of its own; subclasses check its shape."""
        return values.floating(value, ctx).contiguous()

    def _encode_check(self, name: str, value: Any, ctx: Context) -> Any:
        if name in BOOLEANS:
            return values.boolean(value, ctx)
        if name in self.enumerations:
            return self.enumerations[name][values.choice(value, self.enumerations[name], ctx)]
        return values.integer(value, ctx)

    @classmethod
    def _decode(cls, name: str, value: int) -> Any:
        if name in BOOLEANS:
            return bool(value)
        if name in cls.enumerations:
            return cls.enumerations[name][value]
        return value

    def derivative_of(self, field: Field) -> str:
        """The declaration of the derivative with respect to a field, as it holds for this object."""
        return field.derivative

    def encode(self, name: str) -> int:
        """The static field `name` as the integer that the core takes."""
        value = getattr(self, name)
        if name in self.enumerations:
            return self.enumerations[name].index(value)
        return int(value)

    # --------------------------------------------------------------------------------------------------- checks
    def check(self, ctx: Context) -> None:
        """Values out of their physical range, or not finite, are named with their place in the scene."""
        for name, field in self.fields().items():
            if self._leaf(field):
                tensor = self._parameters.get(name)
                if tensor is not None:
                    check_range(tensor, field, ctx.at(name), constant=tensor.ndim <= 1)
            elif field.kind in ("texture", "spectrum", "volume"):
                child = self._modules.get(name)
                if child is not None:
                    for leaf_name, tensor in child.texels():
                        # Images may go too far here and there; a medium of negative density has no tracking at all.
                        fatal = tensor.ndim <= 1 or field.kind == "volume"
                        check_range(tensor, field, ctx.at(name).at(leaf_name), constant=fatal)

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        """For a texture or volume: names and tensors of the values that it can take."""
        for name in ("value", "data"):
            tensor = self._parameters.get(name)
            if tensor is not None:
                yield name, tensor

    # ---------------------------------------------------------------------------------------------------- editing
    def __setattr__(self, name: str, value: Any) -> None:
        if not self.__dict__.get("_built", False) or isinstance(getattr(type(self), name, None), property):
            super().__setattr__(name, value)
            return
        name = self.aliases.get(name, name)
        field = self.fields().get(name)
        if field is None:
            super().__setattr__(name, value)
            return
        ctx = Context(self._color, self._dtype(), path=(type(self).__name__, name))
        if value is None:
            if self._leaf(field) and name not in self.optional:
                ctx.error("None removes a parameter, but this one is required")
            (self._parameters if self._leaf(field) else self._modules)[name] = None
        elif isinstance(value, torch.Tensor) and value.requires_grad and not value.is_leaf:
            ctx.error("a tensor that is the result of a computation is passed with render(..., params={name: tensor})")
        else:
            kept = self._parameters.get(name)
            restore = self.snapshot()
            # Of a leaf the numbers are taken and the wish for gradients: the scene's parameter stays a parameter.
            asks = isinstance(value, torch.Tensor) and value.requires_grad and not self._same(field, value, ctx)
            try:
                with ctx.device:
                    self._install(name, field, value.detach() if asks else value, self.context_of(name, ctx))
                self._settle(name, ctx)
                self.check(Context(path=(type(self).__name__,)))
            except Exception:
                restore()
                raise
            new = self._parameters.get(name)
            if asks:
                child = self._modules.get(name)
                for tensor in [new] if child is None else [t for _, t in child.texels()]:
                    tensor.requires_grad_()
            elif kept is not None and new is not None and not isinstance(value, nn.Parameter):
                new.requires_grad_(kept.requires_grad)
        structure_changed()

    def _same(self, field: Field, value: torch.Tensor, ctx: Context) -> bool:
        """Whether `value` is a parameter that becomes this object's own, as it is."""
        if not isinstance(value, nn.Parameter):
            return False
        return not self._leaf(field) or self._convert(field, value, ctx) is value

    def _settle(self, name: str, ctx: Context) -> None:
        """After an assignment of a child: there is no scene here in which a reference could be looked up."""
        for missing in [r for n, r in self._references if n == name and self._modules.get(name) is None]:
            _refuse_reference(missing, ctx)
        child = self._modules.get(name)
        if isinstance(child, Plugin):
            for module in child.modules():
                if isinstance(module, Plugin) and module._references:
                    _refuse_reference(module._references[0][1], ctx)
            # One from before that was still waiting for its scene gives way to this child.
            self.__dict__["_references"] = [r for r in self._references if r[0] != name]

    def snapshot(self) -> Callable[[], None]:
        """A function that gives this object its present tensors, children and references back, in their order."""
        stores = [(store, dict(store)) for store in (self._parameters, self._modules, self._buffers)]
        own = {n: self.__dict__[n] for n in self.fields() if n in self.__dict__}
        references = list(self._references)

        def restore() -> None:
            for store, content in stores:
                store.clear()
                store.update(content)
            for name in self.fields():
                self.__dict__.pop(name, None)
            self.__dict__.update(own, _references=references)

        return restore

    def __delattr__(self, name: str) -> None:
        super().__delattr__(name)
        structure_changed()

    def _dtype(self) -> torch.dtype | None:
        for tensor in self.parameters():
            return tensor.dtype
        return None

    def adapt(self, ctx: Context) -> None:
        """Take over colour mode, dtype and device of a scene; parameters keep their identity."""
        recolor = self._color != ctx.color and ctx.color == "mono"
        for name, parameter in list(self._parameters.items()):
            if parameter is None:
                continue
            data = parameter.data
            if recolor and name in ("value", "data") and data.ndim in (1, 3, 4) and data.shape[-1] == 3:
                data = values.luminance(data)
            parameter.data = data.to(dtype=ctx.dtype, device=ctx.device).contiguous()
        for name in self.fields():
            tensor = self.__dict__.get(name)
            if isinstance(tensor, torch.Tensor):  # part of a graph, which this extends
                if recolor and name in ("value", "data") and tensor.ndim in (1, 3, 4) and tensor.shape[-1] == 3:
                    tensor = values.luminance(tensor)
                self.__dict__[name] = tensor.to(dtype=ctx.dtype, device=ctx.device)
        self.__dict__["_color"] = ctx.color
        for name, child in self._modules.items():
            if child is not None:
                child.adapt(self.context_of(name, ctx))

    def __getattr__(self, name: str) -> Any:
        try:
            return super().__getattr__(name)
        except AttributeError:
            if name in self.aliases:
                return getattr(self, self.aliases[name])
            known = [*self._parameters, *self._modules, *self._buffers]
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}; {nearest(name, known)}") from None

    def __setitem__(self, name: str, value: Any) -> None:
        setattr(self, name, value)

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def extra_repr(self) -> str:
        lines = []
        for name, field in self.fields().items():
            if field.kind == "int":
                lines.append(f"{name}={getattr(self, name)!r}")
        return ", ".join(lines)


def _refuse_reference(reference: Reference, ctx: Context) -> NoReturn:
    ctx.error(
        f"references are looked up when a scene is loaded and in scene[NAME] = ...; "
        f"here assign the object itself: scene[{reference.id!r}]"
    )


def check_range(tensor: torch.Tensor, field: Field, ctx: Context, constant: bool) -> None:
    """ValueError for values that are not finite, or, for constants, out of the field's range; a warning for images."""
    with torch.no_grad():
        low, high = torch.aminmax(tensor) if tensor.numel() else (torch.zeros(()), torch.zeros(()))
    low, high = float(low), float(high)
    if not (abs(low) < float("inf") and abs(high) < float("inf")):
        ctx.error("has values that are not finite")
    minimum = -float("inf") if field.min is None else field.min
    maximum = float("inf") if field.max is None else field.max
    slack = 0.0 if field.kind == "volume" else 1e-6 * max(1.0, abs(maximum) if maximum < float("inf") else 1.0)
    if low >= minimum and high <= maximum + slack:
        return
    value = low if low < minimum else high
    text = f"{value:.6g} is outside the range [{minimum:g}, {maximum:g}] of {field.name}"
    if constant:
        ctx.error(text)
    warnings.warn(f"{ctx.where}: {text}", stacklevel=2)


def child_of(value: Any, category: str | None, ctx: Context) -> Plugin | Reference:
    """`value` as an object of `category` (any if None).

    Built objects, dicts and references; numbers and arrays as textures or volumes where these are wanted.
    """
    from . import registry

    if isinstance(value, Plugin):
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
        if values.is_spectrum(value):
            if category == "volume":
                return registry.build({"type": "constvolume", "value": value}, ctx, category)
            if category != "texture":
                ctx.error(f"expected a {category or 'nested object'}, got a colour")
            return registry.constant(value, ctx)
        return registry.build(value, ctx, category)
    if category == "texture":
        tensor = values.floating(value, ctx)
        if tensor.ndim == 3:
            return registry.build({"type": "bitmap", "data": value, "raw": True}, ctx, "texture")
        return registry.constant(value, ctx)
    if category == "volume":
        if values.floating(value, ctx).ndim in (3, 4):
            return registry.build({"type": "gridvolume", "data": value}, ctx, "volume")
        return registry.build({"type": "constvolume", "value": value}, ctx, "volume")
    ctx.error(f"expected a {category or 'nested object'} (a dict or a built object), got {describe(value)}")
