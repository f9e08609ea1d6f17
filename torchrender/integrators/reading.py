"""Integrators from dicts and scene files."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from ..errors import SubstitutionWarning, depth_outside, nearest
from .stacks import AOV, Depth, Moment, Stack, Stokes
from .transport import (
    DirectIllumination,
    Integrator,
    ParticleTracer,
    PathTracer,
    VolumetricPathTracer,
)

_PATH = ("max_depth", "rr_depth", "hide_emitters", "emitter_sampling")
_DIRECT = ("shading_samples", "emitter_samples", "bsdf_samples", "hide_emitters", "emitter_sampling")

# type -> (class, accepted names, defaults that differ from the class)
TYPES: dict[str, tuple[type[Integrator], tuple[str, ...], dict[str, Any]]] = {
    "path": (PathTracer, _PATH, {}),
    "prb": (PathTracer, _PATH, {"max_depth": 6}),
    "prb_basic": (PathTracer, _PATH, {"max_depth": 6}),
    "prb_projective": (PathTracer, _PATH, {"max_depth": 6}),
    "volpath": (VolumetricPathTracer, _PATH, {}),
    "volpathmis": (VolumetricPathTracer, _PATH, {}),
    "prbvolpath": (VolumetricPathTracer, _PATH, {"max_depth": 6}),
    "ptracer": (ParticleTracer, _PATH, {}),
    "direct": (DirectIllumination, _DIRECT, {}),
    "direct_projective": (DirectIllumination, ("hide_emitters",), {}),
    "aov": (AOV, ("aovs",), {}),
    "moment": (Moment, (), {}),
    "depth": (Depth, (), {}),
    "stokes": (Stokes, (), {}),
}
DOCUMENTED = ("emission direct_reparam prb_reparam bdpt").split()

# Documented parameters without a counterpart. Those of how work is divided change no image; the rest is said.
_DIVISION = ("samples_per_pass", "block_size", "use_spectral_mis")
_EDGES = ("sppc", "sppp", "sppi", "guiding", "guiding_proj", "guiding_rounds", "project_seed")


def ignored_names(kind: str) -> tuple[str, ...]:
    """Parameters that a dict of this type may have, and that nothing is made of."""
    return (*_DIVISION, "timeout", *(_EDGES if kind.endswith("_projective") else ()))


def _without_ignored(kind: str, properties: dict[str, Any], path: str) -> dict[str, Any]:
    """`properties` without those that nothing is made of, and one warning about those that do something elsewhere."""
    said = []
    if kind.endswith("_projective"):
        counts = [name for name in _EDGES[:3] if name in properties]
        if counts:
            numbers = ", ".join(f"{name}={properties[name]}" for name in counts)
            said.append(f"{numbers}: left out; to render they are spp_grad=sppc and spp_visibility=(sppp, sppi)")
        needless = [name for name in _EDGES[3:] if name in properties]
        if needless:
            said.append(f"{', '.join(needless)}: left out; there is nothing to guide")
    if isinstance(properties.get("timeout"), (int, float)) and properties["timeout"] > 0:
        said.append(f"timeout: without a counterpart in {kind}, and left out")
    if said:
        warnings.warn(f"{path}: {'; '.join(said)}", SubstitutionWarning, stacklevel=depth_outside())
    return {name: value for name, value in properties.items() if name not in ignored_names(kind)}


def from_dict(properties: dict[str, Any], path: str) -> Integrator:
    """The integrator that a dict describes; `path` is its place in the scene, for messages."""
    properties = {k: v for k, v in properties.items() if k != "id"}
    kind = properties.pop("type")
    cls, accepted, defaults = TYPES[kind]
    properties = _without_ignored(kind, properties, path)
    nested = {}
    if issubclass(cls, Stack) and cls is not Depth:
        nested = _nested(properties, path)
        properties = {k: v for k, v in properties.items() if k not in nested}
        if kind == "aov" and "aovs" not in properties:
            raise ValueError(f"{path}: aov needs the parameter 'aovs', such as 'dd:depth,nn:sh_normal'")
    for name in properties:
        if name not in accepted:
            raise ValueError(f"{path}: {kind} has no parameter {name!r}; {nearest(name, accepted)}")
    try:
        return cls(**{**defaults, **properties}, **({"integrator": next(iter(nested.values()))} if nested else {}))
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from None


def _nested(properties: Mapping[str, Any], path: str) -> dict[str, Integrator]:
    """The one integrator among the values, by its key."""
    found: dict[str, Integrator] = {}
    for name, value in properties.items():
        if isinstance(value, Integrator):
            found[name] = value
        elif isinstance(value, Mapping):
            kind = value.get("type")
            if kind not in TYPES or issubclass(TYPES[kind][0], Stack):
                raise ValueError(f"{path}.{name}: expected an integrator, one of {', '.join(TYPES)}, got {kind!r}")
            found[name] = from_dict(dict(value), f"{path}.{name}")
    if len(found) > 1:
        raise ValueError(f"{path}: one nested integrator is supported, got {', '.join(found)}")
    return found
