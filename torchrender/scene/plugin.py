"""The one module class behind every BSDF, texture, emitter, shape and sensor.

A `Plugin` is generated from the native declaration of its model: continuous fields are parameters (tensors), static
ones plain attributes, nested models child modules. What a model needs beyond that (other names for a field, values read
from a file) is a subclass that overrides `Plugin.prepare`.

The class says what there is to override. How an object is built is in `construction`, what values become in
`conversion`, which are refused in `validation`, and what happens when one is assigned in `editing`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, cast

import torch
from torch import nn

from ..errors import describe, nearest
from ..settings import is_own
from . import construction, conversion, editing, registry
from .construction import Lookup
from .context import Context, Reference
from .declaration import TENSOR_KINDS, Field, Model, models
from .signatures import LazySignature
from .structure import structure_changed
from .validation import check_fields


@registry.register
class Plugin(nn.Module):
    """Base of all scene objects. Keyword arguments are the model's parameters under their names in a scene dict."""

    __signature__ = LazySignature()
    category: ClassVar[str] = ""
    type: ClassVar[str] = ""
    native: ClassVar[str] = ""  # the native model, where that is not named as `type` is
    renames: ClassVar[dict[str, str]] = {}  # native field -> name in Python
    aliases: ClassVar[dict[str, str]] = {}  # further names, those of a scene dict -> name in Python
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {}  # documented parameters without effect here: accepted values
    noted: ClassVar[dict[str, str]] = {}  # of those, what is said of a value that would have an effect elsewhere
    unsupported: ClassVar[tuple[str, ...]] = ()  # documented parameters that are not supported
    elsewhere: ClassVar[dict[str, str]] = {}  # names that people look for here: what the error says in place of a guess
    words: ClassVar[tuple[str, ...]] = ()  # of scene dicts, which `prepare` turns into fields also when assigned
    open: ClassVar[bool] = False  # whether an object takes attributes of any name, as modules of users do

    _references: list[tuple[str | None, Reference]]
    _described: dict[str, tuple[dict[str, Any], Context]]
    _color: str | None
    _wavelength: float | None

    def __init__(self, *unnamed: Any, **properties: Any) -> None:
        if unnamed:
            raise TypeError(f"{type(self).__name__}: parameters are given by name, but {describe(unnamed[0])} has none")
        context = properties.pop("_context", None) or Context(path=(type(self).__name__,))
        super().__init__()
        self.__dict__[
            "_described"
        ] = {}  # spectra that were given before there was a scene, and with what they were read
        self.__dict__["_references"] = []  # of children that are still to be looked up, with the names of their fields
        self.__dict__["_color"] = context.color
        self.__dict__["_wavelength"] = context.wavelength
        self.__dict__["_built"] = False
        with context.device:  # whatever torch's default is
            construction.construct(self, properties, context)
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

    def _own_context(self, *names: str) -> Context:
        """What a value that is assigned is converted with."""
        return Context(self._color, self._dtype(), path=(type(self).__name__, *names), wavelength=self._wavelength)

    def adopt(self, child: Plugin, ctx: Context) -> None:
        """Put `child` into the first free field of its category."""
        construction.adopt(self, child, ctx)

    def resolve(self, lookup: Lookup, ctx: Context) -> None:
        """Replace references by the objects that `lookup` finds, all or none; `check` is left to the caller."""
        construction.resolve(self, lookup, ctx)

    def _install(self, name: str, field: Field, value: Any, ctx: Context) -> None:
        """Convert `value` and make it that of the field."""
        construction.install(self, name, field, value, ctx)

    def _fill(self, ctx: Context) -> None:
        """Required fields that are still missing. Subclasses add what is not declared natively."""
        construction.check_required(self, ctx)

    @classmethod
    def _holds(cls, field: Field) -> bool:
        """Whether a tensor of this field is a parameter of this module, and not of a nested constant."""
        return field.kind in TENSOR_KINDS and not (field.kind == "spectrum" and cls.category != "texture")

    def _child(self, name: str) -> Plugin | None:
        """The object that stands in a field."""
        return cast("Plugin | None", self._modules.get(name))

    def _waits_for(self, *names: str | None) -> bool:
        """Whether a reference in one of these fields is still to be looked up; None is for the first that is free."""
        return any(name in names for name, _ in self._references)

    # ------------------------------------------------------------------------------------------------ conversion
    def _convert(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        convert = self.convert_tensor if field.kind == "tensor" else conversion.tensor_of
        return convert(field, value, ctx)

    def convert_tensor(self, field: Field, value: Any, ctx: Context) -> torch.Tensor:
        """A tensor of a size of its own; subclasses check its shape."""
        return conversion.tensor_of(field, value, ctx)

    def convert_static(self, name: str, value: Any, ctx: Context) -> bool | str | int:
        """The value of a static field, checked."""
        return conversion.static_value(self.fields()[name], value, ctx)

    def encode(self, name: str) -> int:
        """The static field `name` as the integer that the core takes."""
        return conversion.encode(self.fields()[name], getattr(self, name))

    @classmethod
    def decode(cls, name: str, number: int) -> bool | str | int:
        """The reverse: what the attribute `name` is for an integer of the core."""
        return conversion.decode(cls.fields()[name], number)

    def derivative_of(self, field: Field) -> str:
        """The declaration of the derivative with respect to a field, as it holds for this object."""
        return field.derivative

    # ---------------------------------------------------------------------------------------- checks and edits
    def check(self, ctx: Context) -> None:
        """Values out of their physical range, or not finite, are named with their place in the scene."""
        check_fields(self, ctx)

    def texels(self) -> Iterator[tuple[str, torch.Tensor]]:
        """For a texture or volume: names and tensors of the values that it can take."""
        for name in ("value", "data"):
            tensor = self._parameters.get(name)
            if tensor is not None:
                yield name, tensor

    def adapt(self, ctx: Context) -> None:
        """Take over colour mode and dtype of a scene; parameters keep their identity."""
        editing.adapt(self, ctx)

    def _dtype(self) -> torch.dtype | None:
        return next((tensor.dtype for tensor in self.parameters()), None)

    def _place(self) -> torch.device:
        return next((tensor.device for tensor in self.parameters()), torch.device("cpu"))

    def hint(self, name: str) -> str:
        """For an error message: what is meant by a name that is no parameter."""
        return nearest(name, [*self.fields(), *self.parameter_names()])

    def _stores(self, name: str) -> bool:
        return any(name in store for store in (self._parameters, self._modules, self._buffers))

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(getattr(type(self), name, None), property):
            object.__setattr__(self, name, value)  # also a parameter, which modules would register
            return
        if not self.__dict__.get("_built", False):
            super().__setattr__(name, value)
            return
        name = self.aliases.get(name, name)
        field = self.fields().get(name)
        if field is not None:
            editing.assign(self, name, field, value)
        elif self.open or is_own(self, name) or self._stores(name) or isinstance(value, nn.Module):
            super().__setattr__(name, value)
        else:
            editing.assign_word(self, name, value)

    def __delattr__(self, name: str) -> None:
        super().__delattr__(name)
        structure_changed()

    def takes_shape(self, name: str, tensor: torch.Tensor, state: Mapping[str, Any], prefix: str) -> bool:
        """Whether a checkpoint may bring `tensor`, of another shape, for `name`, as an assignment might."""
        field, own = self.fields().get(name), self._parameters.get(name)
        if field is None or field.kind != "tensor" or own is None or own.ndim != tensor.ndim or 0 in tensor.shape:
            return False
        return own.ndim == 2 or (own.ndim > 2 and tensor.shape[-1] in (1, 1 if self._color == "mono" else 3))

    def _load_from_state_dict(self, state_dict: Mapping[str, Any], prefix: str, *others: Any) -> None:
        taken = [
            (name, state_dict[prefix + name])
            for store in (self._parameters, self._buffers)
            for name, own in store.items()
            if own is not None
            and isinstance(state_dict.get(prefix + name), torch.Tensor)
            and state_dict[prefix + name].shape != own.shape
            and self.takes_shape(name, state_dict[prefix + name], state_dict, prefix)
        ]
        for name, tensor in taken:
            own = self._parameters.get(name)
            if own is None:
                self._buffers[name] = torch.empty_like(tensor)
            else:  # which stays the same one, for optimisers
                own.data, own.grad = own.data.new_empty(tensor.shape), None
        super()._load_from_state_dict(state_dict, prefix, *others)  # type: ignore[arg-type]
        if taken:
            structure_changed()

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
