"""The scene as a module: objects by id, parameters by dotted name."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from ..errors import NotDifferentiableError, describe, nearest
from ..integrators import TYPES as INTEGRATORS
from ..integrators import Integrator, VolumetricPathTracer
from ..integrators import from_dict as integrator_from
from . import registry
from .camera import PerspectiveCamera
from .context import Context, Reference
from .derivatives import refusal_of
from .film import SAMPLERS, Film, Sampler
from .native import NativeScene
from .packing import ORDER, Layout, canonical, pack
from .plugin import Plugin, child_of, structure_changed, structure_epoch
from .sensor import Sensor

VARIANTS = ("mono", "rgb")


class Scene(nn.Module):
    """A scene: shapes, materials, lights and cameras by id; every continuous quantity is a parameter.

    Made by `load_dict` and `load_file`. Objects are attributes and items: ``scene.red``, ``scene["red"]``; they are
    added, replaced and removed by ``scene["id"] = dict or object`` and ``del scene["id"]``. Parameters do not require
    gradients until they are told to.
    """

    def __init__(
        self,
        objects: Mapping[str, Any],
        variant: str = "rgb",
        dtype: torch.dtype = torch.float32,
        device: str | torch.device = "cpu",
        folder: Path | None = None,
    ) -> None:
        super().__init__()
        self._variant = variant
        self._dtype = dtype
        self._device = torch.device(device)
        self._native: NativeScene | None = None
        self._epoch = -1
        self._layout: Layout | None = None
        self.statistics: dict[str, Any] = {}
        self.warned: set[str] = set()  # parameters whose incomplete derivative was warned about
        ctx = self._context(folder)
        camera = PerspectiveCamera(film=Film(1, 1), _context=ctx.at("camera"))
        self.__dict__["_stand_ins"] = {camera.kind(): camera}  # of cameras that are no part of the scene
        for name, value in objects.items():
            self._put(name, value, ctx, resolve=False)
        self._resolve(ctx)

    # -------------------------------------------------------------------------------------------------- settings
    @property
    def variant(self) -> str:
        """Colour mode: ``"rgb"`` or ``"mono"``."""
        return self._variant

    @property
    def dtype(self) -> torch.dtype:
        """Precision of all parameters and of the rendering."""
        return self._dtype

    @property
    def device(self) -> torch.device:
        return self._device

    @property
    def channels(self) -> int:
        """Number of colour channels: 3 in rgb, 1 in mono."""
        return 1 if self._variant == "mono" else 3

    @property
    def sensors(self) -> list[Sensor]:
        """Cameras and meters, in the order of the scene."""
        return [m for m in self._modules.values() if isinstance(m, Plugin) and m.category == "sensor"]

    @property
    def integrator(self) -> Integrator | None:
        """The scene's own integrator, or None."""
        return next((m for m in self._modules.values() if isinstance(m, Integrator)), None)

    @property
    def film(self) -> Film | None:
        """The first camera's film, or None."""
        sensors = self.sensors
        return sensors[0].film if sensors else None

    def _context(self, folder: Path | None = None) -> Context:
        return Context(self._variant, self._dtype, self._device, (), folder)

    # --------------------------------------------------------------------------------------------------- objects
    def _put(self, name: str, value: Any, ctx: Context, resolve: bool = True) -> None:
        if not isinstance(name, str) or not name or "." in name:
            ctx.error(f"an id is a string without dots, got {describe(name)}")
        above, ctx = ctx, ctx.at(name)
        if isinstance(value, Mapping):
            kind = value.get("type")
            identifier = value.get("id")
            if isinstance(identifier, str) and kind != "ref" and "." not in identifier and identifier:
                name = identifier
            if kind in INTEGRATORS:
                value = integrator_from(dict(value), ctx.where)
            elif kind in (*SAMPLERS, "hdrfilm"):
                ctx.error(f"a {'sampler' if kind in SAMPLERS else 'film'} ({kind}) belongs into a sensor")
            elif isinstance(kind, str) and kind not in registry.scene_types() and _is_documented_integrator(kind):
                ctx.error(
                    f"the integrator {kind!r} is not supported by this version of torchrender; "
                    f"supported are: {', '.join(INTEGRATORS)}"
                )
        meters = {}
        if isinstance(value, Mapping):  # Mitsuba's place for them is inside of their shape
            nested = {k: v for k, v in value.items() if isinstance(v, Mapping) and v.get("type") == "irradiancemeter"}
            meters = {f"{name}_{k}": {**v, "shape": Reference(name)} for k, v in nested.items()}
            value = {k: v for k, v in value.items() if k not in nested} if nested else value
        if not isinstance(value, Integrator):
            value = child_of(value, None, ctx)
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
        if resolve:
            try:
                self._resolve(self._context())
            except Exception:
                self._modules.clear()
                self._modules.update(before)  # the order too: it numbers the shapes
                raise
        if isinstance(previous, Plugin) and isinstance(value, Plugin):
            self._replace_references(previous, value)
        structure_changed()
        for meter_name, meter in meters.items():
            self._put(meter_name, meter, above, resolve)

    def _safe(self, name: str, value: Any) -> str:
        """`name`, with a trailing underscore where a module already has an attribute of that name."""
        if isinstance(value, Integrator):
            return name
        taken = hasattr(Scene, name) or name in self.__dict__
        return name + "_" if taken and name not in self._modules else name

    def _replace_references(self, old: Plugin, new: Plugin) -> None:
        """Objects that use `old` use `new` from now on, where the category allows it."""
        for module in self.modules():
            for child_name, child in module._modules.items():
                if child is old and module is not self and new.category == old.category:
                    module._modules[child_name] = new

    def _resolve(self, ctx: Context) -> None:
        by_id: dict[str, Plugin] = {}
        for module in self.modules():
            identifier = module.__dict__.get("id")
            if isinstance(module, Plugin) and identifier is not None:
                by_id.setdefault(identifier, module)
        for name, module in self._modules.items():
            if isinstance(module, Plugin):
                by_id[name] = module

        def lookup(identifier: str, where: Context) -> Plugin:
            found = by_id.get(identifier) or by_id.get(identifier + "_")
            if found is None:
                where.error(f"there is no object with the id {identifier!r}; {nearest(identifier, by_id)}")
            return found

        pending: dict[int, tuple[Plugin, Context]] = {}
        for name, module in self._modules.items():
            if isinstance(module, Plugin):
                _collect_references(module, ctx.at(name), pending)
        restores = [module.snapshot() for module, _ in pending.values()]
        try:
            for module, where in pending.values():
                module.resolve(lookup, where)
            for name, module in self._modules.items():
                if isinstance(module, Plugin):
                    _refuse_circles(module, ctx.at(name), set())
            for module, where in pending.values():
                module.check(where)
        except Exception:
            for restore in restores:  # objects that were to be shared can be used again, in a corrected scene
                restore()
            raise
        self._sort()

    def _sort(self) -> None:
        """Objects that others refer to first: a shared parameter's name is then that of its owner."""
        rank = {category: i for i, category in enumerate(ORDER)}
        items = sorted(self._modules.items(), key=lambda kv: rank.get(getattr(kv[1], "category", ""), len(rank)))
        self._modules.clear()
        self._modules.update(items)

    def __getitem__(self, name: str) -> nn.Module:
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

    def __iter__(self) -> Any:
        return iter(list(self._modules))

    def __len__(self) -> int:
        return len(self._modules)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__.get("_modules", {}) and not isinstance(getattr(type(self), name, None), property):
            self[name] = value
        elif isinstance(value, (Plugin, Integrator)) and "_modules" in self.__dict__:
            self[name] = value
        else:
            super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        super().__delattr__(name)
        structure_changed()

    def __getattr__(self, name: str) -> Any:
        try:
            return super().__getattr__(name)
        except AttributeError:
            modules = self.__dict__.get("_modules", {})
            raise AttributeError(f"the scene has no object {name!r}; {nearest(name, modules)}") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a Mitsuba 3 XML file, and ``meshes/*.ply``, ``textures/*.exr`` and ``volumes/*.vol`` beside it.

        `load_file` gives a scene of the same objects, names and values: in single precision its images have the same
        bits. Of a double-precision scene, textures and volumes are rounded; in mono, colours become plain numbers.
        What is not saved: which parameters require gradients, and vertex normals of meshes that are shaded flat.
        Normals are brought to unit length when they are loaded.

        Args:
            path: ends in ``.xml``; its folder is made if it is not there, and files of the same names are overwritten.

        Raises:
            ValueError: naming the object that a scene file has no form for.
        """
        from ..loaders.save import save

        save(self, path)

    # ------------------------------------------------------------------------------------------------ parameters
    def named_modules(self, memo: set | None = None, prefix: str = "", remove_duplicate: bool = True) -> Any:
        """All modules with their dotted names; an object that others use comes once, under its own id, in any case.

        With ``remove_duplicate=False`` torch would list it under every name, and `torch.func.functional_call`, which
        takes its names from there, would then leave its substitutes in the scene when it returns.
        """
        return super().named_modules(memo if remove_duplicate else None, prefix, True)

    def _by_every_name(self) -> dict[str, nn.Parameter]:
        """Parameters by each of their names: those of a material also below the shapes that use it."""
        found: dict[str, nn.Parameter] = {}

        def walk(module: nn.Module, prefix: str) -> None:
            for name, parameter in module._parameters.items():
                if parameter is not None:
                    found[prefix + name] = parameter
            for name, child in module._modules.items():
                if child is not None:
                    walk(child, f"{prefix}{name}.")

        walk(self, "")
        return found

    def get_parameter(self, target: str) -> nn.Parameter:
        """The parameter of this dotted name; AttributeError names the nearest ones."""
        try:
            return super().get_parameter(target)
        except AttributeError:
            known = list(self._by_every_name())
            raise AttributeError(f"the scene has no parameter {target!r}; {nearest(target, known)}") from None

    def train_only(self, *patterns: str) -> list[nn.Parameter]:
        """Let exactly the parameters that match one of the glob `patterns` require gradients, and return them.

        ``scene.train_only("*.reflectance.*")``; called without patterns nothing requires gradients any more. Of the
        parameters that a pattern matches, those that have derivatives are chosen. The ``to_uv`` of a texture is chosen
        by a pattern that names it only: ``"*.reflectance.*"`` means colours. So are ``vertex_normals`` that are
        computed from the positions: they follow these, and what an optimiser writes into them is overwritten.

        Raises:
            ValueError: a pattern matches nothing.
            NotDifferentiableError: nothing that a pattern matches has a derivative.
        """
        if len(patterns) == 1 and not isinstance(patterns[0], str):
            patterns = tuple(patterns[0])
        names: dict[str, nn.Parameter] = self._by_every_name()
        layout = self.layout()
        volumetric = isinstance(self.integrator, VolumetricPathTracer)
        refusals = {n: refusal_of(layout.slots[i], volumetric) for n, i in layout.by_name.items()}
        following = {id(m._parameters.get("vertex_normals")) for m in layout.smooth_meshes}
        chosen: dict[int, nn.Parameter] = {}
        for pattern in patterns:
            if not isinstance(pattern, str):
                raise TypeError(f"train_only: expected glob patterns, got {describe(pattern)}")
            found = [n for n in names if fnmatch.fnmatchcase(n, pattern)]
            found = found or [n for n in names if fnmatch.fnmatchcase(n, canonical(pattern))]
            if not found:
                raise ValueError(f"train_only: no parameter matches {pattern!r}; {nearest(pattern, names)}")
            usable = [n for n in found if not refusals.get(n)]
            if not pattern.rpartition(".")[2].strip("*?"):
                usable = [n for n in usable if not n.endswith(".to_uv")] or usable
            if not pattern.endswith("vertex_normals"):
                usable = [n for n in usable if id(names[n]) not in following] or usable
            if not usable:
                raise NotDifferentiableError(
                    f"train_only: {pattern!r} matches only parameters without a derivative: {', '.join(found)} "
                    f"({refusals[found[0]]})"
                )
            chosen.update((id(names[n]), names[n]) for n in usable)
        for parameter in names.values():
            parameter.requires_grad_(id(parameter) in chosen)
        return list(chosen.values())

    @property
    def updates(self) -> dict[str, int]:
        """How often parts of the core's copy of this scene were made so far; empty before the first rendering.

        ``"scenes"``: the whole, because objects or shapes of parameters changed; ``"meshes"``, ``"quadrics"``: shapes
        whose geometry was set; ``"tree_builds"``: the acceleration structure; ``"mesh_refits"``, ``"mesh_rebuilds"``:
        one mesh's part of it, fitted to moved vertices or made again because that had made it slow;
        ``"environments"``: tables of an environment map; ``"height_fields"``: ranges of heights. What did not change
        is not made again. Counting begins anew when objects come or go.
        """
        return {} if self._native is None else self._native.counters()

    def bounding_box(self) -> torch.Tensor:
        """Smallest axis-aligned box around all shapes: (2, 3), lower and upper corner; ValueError without shapes."""
        boxes = [m.bounds() for m in self._modules.values() if isinstance(m, Plugin) and m.category == "shape"]
        if not boxes:
            raise ValueError("bounding_box: the scene has no shapes")
        stacked = torch.stack(boxes)
        return torch.stack([stacked[:, 0].amin(0), stacked[:, 1].amax(0)])

    # ---------------------------------------------------------------------------------------------------- module
    def forward(self, **kwargs: Any) -> Any:
        """``scene(...)`` is ``render(scene, ...)``."""
        from ..render import render

        return render(self, **kwargs)

    def _apply(self, fn: Any, recurse: bool = True) -> Scene:
        super()._apply(fn, recurse)
        stand_ins = self.__dict__["_stand_ins"].values()
        for camera in stand_ins:
            camera._apply(fn)
        probe = next((p for camera in stand_ins for p in camera.parameters()), None)
        if probe is not None:
            self._dtype, self._device = probe.dtype, probe.device
        structure_changed()
        return self

    def __getstate__(self) -> dict[str, Any]:
        # The native scene is a cache: copies and files go without, and make their own when they render.
        return {**self.__dict__, "_native": None, "_layout": None, "_epoch": -1, "statistics": {}}

    def __repr__(self) -> str:
        from .summary import summarise

        return summarise(self)

    # ---------------------------------------------------------------------------------------------------- packing
    def layout(self) -> Layout:
        """The packed structure, made anew only if some scene object changed since."""
        epoch = structure_epoch()
        if self._layout is None or self._epoch != epoch:
            self._layout = pack(self, self.__dict__["_stand_ins"].values())
            self._epoch = epoch
        return self._layout

    def admit(self, camera: Sensor) -> None:
        """Make room for rendering a camera that is no part of the scene."""
        stand_ins = self.__dict__["_stand_ins"]
        if camera.kind() not in stand_ins:
            stand_ins[camera.kind()] = camera.stand_in(self._context().at("camera"))
            structure_changed()

    def native(self, layout: Layout, shapes: list[tuple[int, ...]]) -> NativeScene:
        """The native scene for this structure and these shapes of parameters, built if there is none yet."""
        native = self._native
        if (
            native is not None
            and native.dtype == self._dtype
            and native.shapes == shapes
            and (native.layout is layout or native.layout.objects == layout.objects)
            and native.index_key == layout.index_key()
        ):
            return native
        native = NativeScene(layout, self._variant, self._dtype, shapes, previous=native)
        self._native = native
        return native


def _collect_references(module: Plugin, ctx: Context, found: dict[int, tuple[Plugin, Context]]) -> None:
    """All objects below `module` that hold references, with their places."""
    if module._references:
        found.setdefault(id(module), (module, ctx))
    for name, child in module._modules.items():
        if isinstance(child, Plugin):
            _collect_references(child, ctx.at(name), found)


def _refuse_circles(module: Plugin, ctx: Context, above: set[int]) -> None:
    if id(module) in above:
        ctx.error("refers to itself")
    for name, child in module._modules.items():
        if isinstance(child, Plugin):
            _refuse_circles(child, ctx.at(name), above | {id(module)})


def _is_documented_integrator(kind: str) -> bool:
    from ..integrators import DOCUMENTED

    return kind in DOCUMENTED


def default_sampler(camera: Sensor) -> Sampler:
    """Number and kind of samples when nothing is said: the camera's own, else 16 independent ones.

    TypeError or ValueError for one that an edit has made wrong.
    """
    sampler, ctx = camera.sampler, Context(path=("sampler",))
    if sampler is None:
        return Sampler()
    if not isinstance(sampler, Sampler):
        raise TypeError(f"{ctx.where}: expected a Sampler or None, got {describe(sampler)}")
    sampler.check(ctx)
    return sampler
