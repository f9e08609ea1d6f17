"""Fallbacks for the parts of a scene that this version does not support, each with a warning that says so.

Only names and types are looked at: a wrong value remains an error of whoever builds the object.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import SubstitutionWarning
from ..integrators import TYPES as INTEGRATORS
from ..integrators import ignored_names
from ..scene import registry
from ..scene.declaration import models
from ..scene.film import _FILM_NAMES, _FORMATS, _RELATED, FILTER_PARAMETERS, FILTERS, SAMPLERS
from ..scene.spectra import is_spectrum

# For BSDFs, the better one first: type -> [(fallback, {its parameter: theirs})].
_BSDFS: dict[str, list[tuple[str, dict[str, str]]]] = {
    "roughconductor": [("conductor", {n: n for n in ("material", "eta", "k", "specular_reflectance")})],
    "plastic": [("diffuse", {"reflectance": "diffuse_reflectance"})],
    "roughplastic": [
        ("plastic", {n: n for n in ("diffuse_reflectance", "specular_reflectance", "int_ior", "ext_ior", "nonlinear")}),
        ("diffuse", {"reflectance": "diffuse_reflectance"}),
    ],
    "pplastic": [
        (
            "roughplastic",
            {n: n for n in ("diffuse_reflectance", "specular_reflectance", "int_ior", "ext_ior", "alpha")},
        ),
        ("diffuse", {"reflectance": "diffuse_reflectance"}),
    ],
    "principled": [("diffuse", {"reflectance": "base_color"})],
    "principledthin": [("principled", {"base_color": "base_color", "roughness": "roughness"})],
    "phong": [("diffuse", {"reflectance": "diffuse_reflectance"})],
    "ward": [("diffuse", {"reflectance": "diffuse_reflectance"})],
    "thindielectric": [("null", {})],
}
_BSDFS["principledthin"].append(("diffuse", {"reflectance": "base_color"}))
_WRAPPERS = ("mask", "bumpmap", "normalmap", "blendbsdf", "coating", "roughcoating", "bump", "mixturebsdf")
_OLD_BSDFS = ("phong", "ward", "coating", "roughcoating", "bump", "mixturebsdf", "hk", "difftrans", "irawan")
_OLD_EMITTERS = ("sky", "sun", "collimated")
_MAX_DEPTH = 20


class _Walker:
    """One pass over a description. `left_out` collects the ids of objects without a fallback."""

    def __init__(self, spectral: bool) -> None:
        self.films = ("hdrfilm", "specfilm") if spectral else ("hdrfilm",)
        self.left_out: set[str] = set()
        self.by_id: dict[str, Mapping[str, Any]] = {}
        self.types = registry.scene_types()
        self.depth = 0

    def warn(self, where: str, text: str) -> None:
        warnings.warn(f"{where}: {text}", SubstitutionWarning, stacklevel=2)

    def collect(self, value: Any, key: str | None) -> None:
        """Find the objects that references may mean."""
        if isinstance(value, Mapping):
            if value.get("type") != "ref":
                for name in (key, value.get("id")):
                    if isinstance(name, str):
                        self.by_id.setdefault(name, value)
            for name, content in value.items():
                self.collect(content, str(name) if value.get("type") == "scene" else None)

    def found(self, value: Mapping[str, Any]) -> Mapping[str, Any] | None:
        """The object that a reference means; any other object itself."""
        return self.by_id.get(str(value.get("id"))) if value.get("type") == "ref" else value

    # -------------------------------------------------------------------------------------------------- objects
    def scene(self, description: Mapping[str, Any]) -> dict[str, Any]:
        result = {}
        for key, value in description.items():
            made = self.value(value, str(key))
            if made is None and value is not None:
                self.left_out.update({key, *([value["id"]] if isinstance(value.get("id"), str) else [])})
            else:
                result[key] = made
        if self.left_out:
            result = {key: self._without_references(value, str(key)) for key, value in result.items()}
        return result

    def value(self, value: Any, where: str) -> Any:
        """The value itself, its fallback, or None where there is none."""
        if not isinstance(value, Mapping) or not isinstance(value.get("type"), str):
            return value
        kind = value["type"]
        if kind == "ref" or is_spectrum(value):
            return value
        if kind == "scene":
            return self.scene(value)
        supported = kind in self.types or kind in (*INTEGRATORS, *SAMPLERS, *FILTERS, *self.films)
        if not supported:
            rule = _RULES.get(_category(kind))
            if rule is None:
                return value  # unknown: building it says so
            return rule(self, value, where)
        return self.parameters(value, where)

    def nested(self, value: Mapping[str, Any], where: str) -> dict[str, Any]:
        """The object with its own nested objects looked at; those without a fallback are left out."""
        result = {}
        for key, content in value.items():
            made = self.value(content, f"{where}.{key}")
            if made is not None or content is None:
                result[key] = made
        return result

    def replaced(self, value: Mapping[str, Any], new: dict[str, Any], where: str, remark: str = "") -> Any:
        """`new` in place of `value`, said in a warning; `new` is looked at in turn."""
        lost = f" without {', '.join(sorted(remark.split()))}" if remark else ""
        self.warn(where, f"{value['type']!r} is not supported and was replaced by {new['type']!r}{lost}")
        if "id" in value:
            new.setdefault("id", value["id"])
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise ValueError(f"{where}: objects that stand in for each other are nested too deeply, or in a circle")
        made = self.value(new, where)
        self.depth -= 1
        return made

    def omitted(self, value: Mapping[str, Any], where: str) -> None:
        self.warn(where, f"{value['type']!r} is not supported and was left out")

    # ------------------------------------------------------------------------------------------------ parameters
    def parameters(self, value: Mapping[str, Any], where: str) -> dict[str, Any]:
        """A supported object without the parameters that it cannot have here."""
        result = self.nested(value, where)
        kind = value["type"]
        accepted = _accepted(kind)
        for name in [n for n in result if n not in ("type", "id")]:
            content = result[name]
            is_object = not isinstance(content, (str, int, float, list, tuple)) and _is_object(content)
            reason = None
            if name not in accepted and not is_object:
                reason = "is not supported"
            elif kind in self.types and (self.types[kind], kind) in models():
                reason = _unusable(kind, self.types[kind], name, content)
                if name == "srf" and "specfilm" not in self.films:
                    reason = "is not supported"
            elif kind in self.films and name in _FORMATS and content not in _FORMATS[name]:
                reason = "has no such value here"
            if reason is not None:
                del result[name]
                shown = f"={content!r}" if isinstance(content, (str, int, float, bool)) else ""
                self.warn(where, f"the parameter {name}{shown} {reason} and was left out")
        return result

    def _without_references(self, value: Any, where: str) -> Any:
        if not isinstance(value, Mapping):
            return value
        result = {}
        for key, content in value.items():
            if isinstance(content, Mapping) and content.get("type") == "ref" and content.get("id") in self.left_out:
                self.warn(f"{where}.{key}", f"refers to {content['id']!r}, which was left out; left out as well")
                continue
            result[key] = self._without_references(content, f"{where}.{key}")
        return result


def with_fallbacks(description: Mapping[str, Any], variant: str = "rgb") -> dict[str, Any]:
    """`description` with fallbacks for all that is not supported; one `SubstitutionWarning` for each."""
    walker = _Walker(variant.startswith("spectral"))
    walker.collect(description, None)
    made = walker.value(description, "scene")
    if made is None:
        raise ValueError(f"load_dict: {description['type']!r} is not supported, and nothing can stand in for it")
    return made


# ------------------------------------------------------------------------------------------------------ rules


def _bsdf(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    kind = value["type"]
    if kind in _WRAPPERS:
        for inner in value.values():
            found = walker.found(inner) if isinstance(inner, Mapping) else None
            if found is not None and found is not value and _category(found.get("type")) == "bsdf":
                return walker.replaced(value, {k: v for k, v in found.items() if k != "id"}, where)
    for name, mapping in _BSDFS.get(kind, []):
        if name in walker.types:
            new = {"type": name, **{ours: value[theirs] for ours, theirs in mapping.items() if theirs in value}}
            lost = [n for n in value if n not in (*mapping.values(), "type", "id")]
            return walker.replaced(value, new, where, " ".join(lost))
    return walker.replaced(value, {"type": "diffuse"}, where)


def _emitter(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    kind = value["type"]
    if kind == "timed_sunsky" and "sunsky" in walker.types:
        kept = {n: v for n, v in value.items() if n in registry.accepted_names("sunsky")}
        lost = [n for n in value if n not in (*kept, "type", "id")]
        return walker.replaced(value, {"type": "sunsky", **kept}, where, " ".join(lost))
    if kind in ("sunsky", "timed_sunsky", "sky", "sun"):
        return walker.replaced(value, {"type": "constant"}, where)
    return walker.omitted(value, where)


def _sensor(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    if value["type"] != "thinlens":
        return walker.omitted(value, where)
    new = {k: v for k, v in value.items() if k not in ("aperture_radius", "focus_distance")}
    return walker.replaced(value, {**new, "type": "perspective"}, where, "aperture_radius")


def _film(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    return walker.replaced(value, {**value, "type": "hdrfilm"}, where)


def _sampler(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    new = {"type": _RELATED.get(value["type"], "independent")}
    return walker.replaced(value, {**new, **{n: value[n] for n in ("sample_count",) if n in value}}, where)


def _filter(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    return walker.replaced(value, {"type": "gaussian"}, where)


def _integrator(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    for inner in value.values():
        if isinstance(inner, Mapping) and inner.get("type") in INTEGRATORS:
            return walker.replaced(value, dict(inner), where)
    kept = {n: value[n] for n in ("max_depth", "rr_depth", "hide_emitters") if n in value}
    return walker.replaced(value, {"type": "path", **kept}, where)


def _texture(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    walker.warn(where, f"{value['type']!r} is not supported and was replaced by the constant 0.5")
    return {"type": "uniform", "value": 0.5}


def _phase(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    return walker.replaced(value, {"type": "isotropic"}, where)


def _omit(walker: _Walker, value: Mapping[str, Any], where: str) -> Any:
    return walker.omitted(value, where)


_RULES: dict[str | None, Callable[[_Walker, Mapping[str, Any], str], Any]] = {
    **{"bsdf": _bsdf, "emitter": _emitter, "sensor": _sensor, "film": _film, "sampler": _sampler, "rfilter": _filter},
    **{"integrator": _integrator, "texture": _texture, "phase": _phase, "shape": _omit},
}


def _category(kind: Any) -> str | None:
    """The category of a type that is known here or documented elsewhere."""
    found = registry.scene_types().get(kind)
    if found is not None:
        return found
    for group, kinds in registry.DOCUMENTED.items():
        if kind in kinds:
            return group
    from ..integrators import DOCUMENTED

    if kind in _OLD_BSDFS:
        return "bsdf"
    if kind in _OLD_EMITTERS:
        return "emitter"
    if kind in ("sobol", "halton", "hammersley"):
        return "sampler"
    return "film" if kind == "ldrfilm" else "integrator" if kind in DOCUMENTED else None


def _is_object(content: Any) -> bool:
    if isinstance(content, Mapping):
        return "type" in content and not is_spectrum(content)
    return hasattr(content, "category")


def _accepted(kind: str) -> tuple[str, ...]:
    """Names that an object of this type takes."""
    if kind in INTEGRATORS:
        return (*INTEGRATORS[kind][1], *ignored_names(kind))
    if kind in SAMPLERS:
        return ("sample_count", "seed", "jitter") if kind == "stratified" else ("sample_count", "seed")
    if kind in FILTERS:
        return FILTER_PARAMETERS[kind]
    if kind in ("hdrfilm", "specfilm"):
        return tuple(_FILM_NAMES)
    return registry.accepted_names(kind)


def _unusable(kind: str, category: str, name: str, content: Any) -> str | None:
    """Why a known parameter cannot have this value here, None if it can."""
    cls = registry.plugin_class(category, kind)
    if name in cls.unsupported:
        return "is not supported"
    if name in cls.inert and name not in cls.noted and cls.inert[name] and content not in cls.inert[name]:
        return "has no such value here"
    if name == "material" and isinstance(content, str):
        try:
            cls(material=content)
        except ValueError:
            return "is not known"
    field = cls.fields().get(cls.aliases.get(name, name))
    is_texture = isinstance(content, Mapping) and content.get("type") != "ref" and not is_spectrum(content)
    if is_texture and field is not None and category != "texture" and field.kind in ("float", "spectrum"):
        return "cannot be a texture here"
    return None
