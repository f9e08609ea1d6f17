"""Media: what fills the space inside or outside of shapes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from ..errors import nearest
from .context import Context, Reference
from .plugin import Plugin
from .registry import build, plugin_class, register, scene_types
from .spectra import is_spectrum

VOLUMES = ("sigma_t", "albedo", "emission")


class Medium(Plugin):
    """What all media share. An object of this class may be the medium of several shapes and cameras."""

    category = "medium"
    filled: ClassVar[tuple[str, ...]] = ()  # volumes that have their default where none is given

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        for name in self.filled:
            if self._child(name) is None and not self._waits_for(name):
                self._modules[name] = build({"type": "constvolume", "value": self.fields()[name].default}, ctx.at(name))

    def resolve(self, lookup: Any, ctx: Context) -> None:
        super().resolve(lookup, ctx)
        self._fill(ctx)

    def adopt(self, child: Plugin, ctx: Context) -> None:
        if child.category == "volume":
            names = [n for n in VOLUMES if n in self.fields()]
            ctx.error(f"a volume goes by the name of what it stands for: {', '.join(names)}")
        super().adopt(child, ctx)

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if value is None and self.__dict__.get("_built", False) and self.aliases.get(name, name) in self.fields():
            self._fill(self._own_context())  # the default is back


class ScatteringMedium(Medium):
    """A medium that light travels through in straight lines until it is scattered."""

    filled: ClassVar[tuple[str, ...]] = ("sigma_t", "albedo")
    aliases: ClassVar[dict[str, str]] = {"phase": "phase_function"}
    renames: ClassVar[dict[str, str]] = {"phase": "phase_function"}
    # Of how emitters are sampled the noise alone depends, and the extinction itself says whether it has colours.
    inert: ClassVar[dict[str, tuple[Any, ...]]] = {
        "sample_emitters": (True, False),
        "has_spectral_extinction": (True, False),
    }

    def prepare(self, properties: dict[str, Any], ctx: Context) -> dict[str, Any]:
        # Phase functions may go by any name, volumes by their own only: there are several.
        for name, value in properties.items():
            if name not in self.fields() and name not in self.aliases and not _may_be_phase(value):
                ctx.error(f"{self.type} has no parameter {name!r}; {nearest(str(name), self.parameter_names())}")
        return properties

    def _fill(self, ctx: Context) -> None:
        super()._fill(ctx)
        if self._child("phase_function") is None and not self._waits_for(None, "phase_function"):
            self._modules["phase_function"] = plugin_class("phase", "isotropic")(_context=ctx.at("phase_function"))

    def extra_repr(self) -> str:
        return ""


def _may_be_phase(value: Any) -> bool:
    if isinstance(value, Plugin):
        return value.category == "phase"
    if isinstance(value, Mapping) and "type" in value and not is_spectrum(value):
        return scene_types().get(value["type"], "phase") in ("phase",) or value["type"] == "ref"
    return isinstance(value, Reference)


@register
class HomogeneousMedium(ScatteringMedium):
    """A medium whose extinction is the same everywhere.

    Args:
        sigma_t: extinction per unit length (a number or a colour), not negative; default 1.
        albedo: the part of the extinction that is scattering, 0 to 1 (number, colour or volume); default 0.75.
        emission: radiance emitted per unit length, not negative (number, colour or volume); none by default.
        scale: a factor of the extinction, not negative; default 1.
        phase: the phase function, isotropic if none is given; it may have any name.
    """

    type = "homogeneous"

    def check(self, ctx: Context) -> None:
        super().check(ctx)
        extinction = self._child("sigma_t")
        if extinction is not None and extinction.type != "constvolume":
            ctx.at("sigma_t").error(
                f"the extinction of a homogeneous medium is a number or a colour, got a {extinction.type}; "
                "a heterogeneous one may have a grid"
            )


@register
class HeterogeneousMedium(ScatteringMedium):
    """A medium whose extinction may be a grid, outside of whose cube there is no medium: no extinction, no emission.

    Args:
        sigma_t: extinction per unit length, not negative (number, colour or volume); default 1.
        albedo: the part of the extinction that is scattering, 0 to 1 (number, colour or volume); default 0.75.
        emission: radiance emitted per unit length, not negative (number, colour or volume); none by default.
        scale: a factor of the extinction, not negative; default 1.
        phase: the phase function, isotropic if none is given; it may have any name.
    """

    type = "heterogeneous"
