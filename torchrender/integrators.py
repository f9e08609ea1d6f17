"""Integrators: small modules without weights that say how light transport is computed.

They hold settings only; the work is done by the native core.
"""

from __future__ import annotations

from typing import Any

from torch import nn

from .errors import describe, nearest


def _integer(owner: str, name: str, value: Any, minimum: int) -> int:
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        if not (isinstance(value, float) and value.is_integer()):
            raise TypeError(f"{owner}: {name}: expected an integer, got {describe(value)}")
    value = int(value)
    if value < minimum:
        raise ValueError(f"{owner}: {name}: expected at least {minimum}, got {value}")
    return value


def _boolean(owner: str, name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{owner}: {name}: expected True or False, got {describe(value)}")
    return value


class Integrator(nn.Module):
    """Base of all integrators. Settings are plain attributes and may be changed between renderings."""

    kind = ""

    def config(self) -> dict[str, Any]:
        """The settings as the native core takes them, checked."""
        raise NotImplementedError


class PathTracer(Integrator):
    """Unidirectional path tracer: emitter and BSDF sampling combined by the power heuristic, Russian roulette.

    Args:
        max_depth: longest path in segments; 1 shows emitters only, 2 adds direct light, -1 is unlimited.
        rr_depth: number of segments after which Russian roulette may end a path, at least 1.
        hide_emitters: emitters are not seen directly by the camera.
    """

    kind = "path"

    def __init__(self, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False) -> None:
        super().__init__()
        self.max_depth = max_depth
        self.rr_depth = rr_depth
        self.hide_emitters = hide_emitters
        self.config()

    def config(self) -> dict[str, Any]:
        return {
            "integrator": "path",
            "max_depth": _integer("PathTracer", "max_depth", self.max_depth, -1),
            "rr_depth": _integer("PathTracer", "rr_depth", self.rr_depth, 1),
            "hide_emitters": _boolean("PathTracer", "hide_emitters", self.hide_emitters),
            "emitter_samples": 1,
            "bsdf_samples": 1,
        }

    def extra_repr(self) -> str:
        return f"max_depth={self.max_depth}, rr_depth={self.rr_depth}, hide_emitters={self.hide_emitters}"


class DirectIllumination(Integrator):
    """Direct light only: emitter and BSDF sampling at the first hit, combined by the power heuristic.

    Args:
        shading_samples: number of both kinds of samples, 1 if nothing is said.
        emitter_samples, bsdf_samples: numbers of each; one of them may be 0. Not together with `shading_samples`.
        hide_emitters: emitters are not seen directly by the camera.
    """

    kind = "direct"

    def __init__(
        self,
        shading_samples: int | None = None,
        emitter_samples: int | None = None,
        bsdf_samples: int | None = None,
        hide_emitters: bool = False,
    ) -> None:
        super().__init__()
        if shading_samples is not None and (emitter_samples is not None or bsdf_samples is not None):
            raise ValueError(
                "DirectIllumination: give shading_samples, or emitter_samples and bsdf_samples, but not both"
            )
        both = 1 if shading_samples is None else _integer("DirectIllumination", "shading_samples", shading_samples, 1)
        self.emitter_samples = both if emitter_samples is None else emitter_samples
        self.bsdf_samples = both if bsdf_samples is None else bsdf_samples
        self.hide_emitters = hide_emitters
        self.config()

    def config(self) -> dict[str, Any]:
        emitter = _integer("DirectIllumination", "emitter_samples", self.emitter_samples, 0)
        bsdf = _integer("DirectIllumination", "bsdf_samples", self.bsdf_samples, 0)
        if emitter + bsdf == 0:
            raise ValueError("DirectIllumination: emitter_samples and bsdf_samples are both 0")
        return {
            "integrator": "direct",
            "max_depth": 2,
            "rr_depth": 1 << 20,
            "hide_emitters": _boolean("DirectIllumination", "hide_emitters", self.hide_emitters),
            "emitter_samples": emitter,
            "bsdf_samples": bsdf,
        }

    def extra_repr(self) -> str:
        return (
            f"emitter_samples={self.emitter_samples}, bsdf_samples={self.bsdf_samples}, "
            f"hide_emitters={self.hide_emitters}"
        )


_PATH = ("max_depth", "rr_depth", "hide_emitters")
_DIRECT = ("shading_samples", "emitter_samples", "bsdf_samples", "hide_emitters")

# type -> (class, accepted names, defaults that differ from the class)
TYPES: dict[str, tuple[type[Integrator], tuple[str, ...], dict[str, Any]]] = {
    "path": (PathTracer, _PATH, {}),
    "prb": (PathTracer, _PATH, {"max_depth": 6}),
    "prb_basic": (PathTracer, _PATH, {"max_depth": 6}),
    "prb_projective": (PathTracer, _PATH, {"max_depth": 6}),
    "direct": (DirectIllumination, _DIRECT, {}),
    "direct_projective": (DirectIllumination, ("hide_emitters",), {}),
}
DOCUMENTED = (
    "aov depth emission moment ptracer stokes volpath volpathmis prbvolpath direct_reparam prb_reparam bdpt"
).split()


def from_dict(properties: dict[str, Any], path: str) -> Integrator:
    """The integrator that a dict describes; `path` is its place in the scene, for messages."""
    properties = {k: v for k, v in properties.items() if k != "id"}
    kind = properties.pop("type")
    cls, accepted, defaults = TYPES[kind]
    for name in properties:
        if name not in accepted:
            raise ValueError(f"{path}: {kind} has no parameter {name!r}; {nearest(name, accepted)}")
    try:
        return cls(**{**defaults, **properties})
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from None
