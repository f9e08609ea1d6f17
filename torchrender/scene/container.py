"""What a scene holds: objects by id, in an order in which none comes before what it refers to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import nn

from ..errors import describe, nearest
from ..integrators import DOCUMENTED, TYPES, Integrator, from_dict
from ..settings import is_own
from . import registry, spectra
from .construction import child_of
from .context import Context, Reference
from .film import SAMPLERS
from .host_memory import move
from .packing import ORDER
from .plugin import Plugin
from .references import replace_references, resolve_references
from .structure import structure_changed


class Container(nn.Module):
    """Objects as attributes and items: ``scene.red``, ``scene["red"]``.

    An id that modules have another use for gets an underscore: ``scene["train"]`` is ``scene.train_``.
    """

    @property
    def device(self) -> torch.device:
        """Where the tensors of its objects lie."""
        raise NotImplementedError

    def _context(self) -> Context:
        """What objects are built with that come into the scene."""
        raise NotImplementedError

    def _put(self, name: str, value: Any, ctx: Context, resolve: bool = True) -> None:
        """Add an object, or replace the one of this id; without `resolve` references are left for later."""
        if not isinstance(name, str) or not name or "." in name:
            ctx.error(f"an id is a string without dots, got {describe(name)}")
        above, ctx, key = ctx, ctx.at(name), name
        meters: dict[str, Any] = {}
        if isinstance(value, Mapping):
            check_names(value, ctx)
            identifier = value.get("id")
            if isinstance(identifier, str) and value.get("type") != "ref" and "." not in identifier and identifier:
                name = identifier
            value = _integrator_or_dict(value, ctx)
        if isinstance(value, Mapping):  # Mitsuba's place for meters is inside of their shape
            nested = {k: v for k, v in value.items() if isinstance(v, Mapping) and v.get("type") == "irradiancemeter"}
            meters = {f"{name}_{k}": {**v, "shape": Reference(name)} for k, v in nested.items()}
            value = {k: v for k, v in value.items() if k not in nested} if nested else value
        if not isinstance(value, Integrator):
            is_spectrum = spectra.is_spectrum(value)  # as an object that others refer to
            value = child_of(value, "texture" if is_spectrum else None, ctx)
            if isinstance(value, Reference):
                ctx.error("a reference at the top level of a scene has nothing to belong to")
        name = self._safe(name, value)
        previous = self._modules.get(name)
        if previous is not None and not resolve:
            ctx.error(f"two objects have the id {name!r}")
        before = dict(self._modules)
        if isinstance(value, Integrator):  # there is one
            for other in [n for n, m in self._modules.items() if isinstance(m, Integrator)]:
                del self._modules[other]
        self._modules[name] = value
        if key != name and isinstance(value, Plugin):
            value.__dict__["_key"] = key  # by which references of the dict may go, too
        if resolve:
            try:
                self._resolve(self._context())
            except Exception:
                self._modules.clear()
                self._modules.update(before)  # the order too: it numbers the shapes
                raise
        move(value, self.device)
        if isinstance(previous, Plugin) and isinstance(value, Plugin):
            replace_references(self, previous, value)
        structure_changed()
        for meter_name, meter in meters.items():
            self._put(meter_name, meter, above, resolve)

    def _safe(self, name: str, value: Any) -> str:
        """`name`, with a trailing underscore where a module already has an attribute of that name."""
        if isinstance(value, Integrator):
            return name
        taken = hasattr(type(self), name) or name in self.__dict__
        return name + "_" if taken and name not in self._modules else name

    def _resolve(self, ctx: Context) -> None:
        """Look up all references, and put objects that others refer to first: parameters go by their owners' ids."""
        resolve_references(self, ctx)
        rank = {category: i for i, category in enumerate(ORDER)}
        items = sorted(self._modules.items(), key=lambda kv: rank.get(getattr(kv[1], "category", ""), len(rank)))
        self._modules.clear()
        self._modules.update(items)

    def __getitem__(self, name: str) -> Plugin | Any:
        found = self._modules.get(name) or self._modules.get(f"{name}_")
        if found is None:
            raise KeyError(f"the scene has no object {name!r}; {nearest(str(name), self._modules)}")
        return found

    def __setitem__(self, name: str, value: Any) -> None:
        name = f"{name}_" if f"{name}_" in self._modules and name not in self._modules else name
        self._put(name, value, self._context())

    def __delitem__(self, name: str) -> None:
        key = name if name in self._modules else f"{name}_"
        if key not in self._modules:
            raise KeyError(f"the scene has no object {name!r}; {nearest(str(name), self._modules)}")
        del self._modules[key]
        structure_changed()

    def __contains__(self, name: object) -> bool:
        return name in self._modules or f"{name}_" in self._modules

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._modules))

    def __len__(self) -> int:
        return len(self._modules)

    def __setattr__(self, name: str, value: Any) -> None:
        modules = self.__dict__.get("_modules")
        if modules is None or (is_own(self, name) and not isinstance(value, (Plugin, Integrator))):
            super().__setattr__(name, value)
        elif name in modules or isinstance(value, (Plugin, Integrator, Mapping)):
            self[name] = value
        else:
            known = nearest(name, [*modules, *(n for n, v in vars(type(self)).items() if isinstance(v, property))])
            raise AttributeError(
                f"the scene has no object {name!r}, and {describe(value)} is none (a dict with a 'type', or a built "
                f"object); {known}"
            )

    def __delattr__(self, name: str) -> None:
        super().__delattr__(name)
        structure_changed()

    def __getattr__(self, name: str) -> Any:
        try:
            return super().__getattr__(name)
        except AttributeError:
            modules = self.__dict__.get("_modules", {})
            raise AttributeError(f"the scene has no object {name!r}; {nearest(name, modules)}") from None


def with_settings(objects: Mapping[str, Any]) -> dict[str, Any]:
    """`objects` without films and samplers of the top level that sensors refer to, which get them in their place."""
    settings: dict[str, str] = {}  # id -> name
    for name, value in objects.items():
        if isinstance(value, Mapping) and isinstance(value.get("type"), str) and _is_setting(value["type"]):
            settings[value.get("id", name)] = name
    used: set[str] = set()

    def replaced(value: Any) -> Any:
        if isinstance(value, Mapping) and value.get("type") == "ref" and value.get("id") in settings:
            used.add(value["id"])
            return objects[settings[value["id"]]]
        return value

    if not settings:
        return dict(objects)
    found = {n: {k: replaced(v) for k, v in o.items()} if isinstance(o, Mapping) else o for n, o in objects.items()}
    return {name: value for name, value in found.items() if name not in {settings[i] for i in used}}


def _is_setting(kind: str) -> bool:
    return kind in (*SAMPLERS, *registry.DOCUMENTED["sampler"], *registry.DOCUMENTED["film"])


def _integrator_or_dict(value: Mapping[str, Any], ctx: Context) -> Integrator | Mapping[str, Any]:
    """The integrator that a dict describes, else the dict; ValueError for what has no place in a scene by itself."""
    kind = value.get("type")
    if kind in TYPES:
        return from_dict(dict(value), ctx.where)
    if isinstance(kind, str):
        registry.check_part(kind, ctx)
        if kind not in registry.scene_types() and kind in DOCUMENTED:
            ctx.error(
                f"the integrator {kind!r} is not supported by this version of torchrender"
                f"; supported are: {', '.join(TYPES)}"
            )
    return value


def check_names(value: Mapping[Any, Any], ctx: Context) -> None:
    """ValueError for keys of a description, at any depth, that are no strings, and types that are none."""
    for key, content in value.items():
        if not isinstance(key, str):
            ctx.error(f"expected names, got {describe(key)}")
        if key == "type" and not isinstance(content, str):
            ctx.at(key).error(f"expected a word, got {describe(content)}")
        if isinstance(content, Mapping):
            check_names(content, ctx.at(key))
