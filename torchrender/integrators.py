"""Integrators: small modules without weights that say how light transport is computed.

They hold settings only; the work is done by the native core.
"""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import nn

from .errors import SubstitutionWarning, depth_outside, describe, nearest
from .polarization import channel_names
from .settings import boolean, integer, is_own, word

EMITTER_SAMPLING = ("weight", "power")


@functools.cache
def _settings(cls: type) -> frozenset[str]:
    """What the class and its bases are made with."""
    return frozenset(n for base in cls.__mro__[:-1] for n in inspect.signature(base.__init__).parameters) - {"self"}


class Integrator(nn.Module):
    """Base of all integrators. Settings are plain attributes and may be changed between renderings."""

    kind = ""

    def __setattr__(self, name: str, value: Any) -> None:
        if not is_own(self, name) and name not in _settings(type(self)) and not isinstance(value, nn.Module):
            hint = nearest(name, _settings(type(self)))
            raise AttributeError(f"{type(self).__name__} has no setting {name!r}; {hint}")
        super().__setattr__(name, value)

    def config(self) -> dict[str, Any]:
        """The settings as the native core takes them, checked."""
        raise NotImplementedError


class _Paths(Integrator):
    """What path tracers with and without media have in common."""

    def __init__(
        self, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False, emitter_sampling: str = "weight"
    ) -> None:
        super().__init__()
        self.max_depth = max_depth
        self.rr_depth = rr_depth
        self.hide_emitters = hide_emitters
        self.emitter_sampling = emitter_sampling
        self.config()

    def config(self) -> dict[str, Any]:
        name = type(self).__name__
        return {
            "integrator": "path",
            "max_depth": integer(name, "max_depth", self.max_depth, -1),
            "rr_depth": integer(name, "rr_depth", self.rr_depth, 1),
            "hide_emitters": boolean(name, "hide_emitters", self.hide_emitters),
            "emitter_sampling": word(name, "emitter_sampling", self.emitter_sampling, EMITTER_SAMPLING),
            "emitter_samples": 1,
            "bsdf_samples": 1,
        }

    def extra_repr(self) -> str:
        shown = "" if self.emitter_sampling == "weight" else f", emitter_sampling={self.emitter_sampling!r}"
        return f"max_depth={self.max_depth}, rr_depth={self.rr_depth}, hide_emitters={self.hide_emitters}{shown}"


class PathTracer(_Paths):
    """Unidirectional path tracer: emitter and BSDF sampling combined by the power heuristic, Russian roulette.

    Args:
        max_depth: longest path in segments; 1 shows emitters only, 2 adds direct light, -1 is unlimited.
        rr_depth: number of segments after which Russian roulette may end a path, at least 1.
        hide_emitters: emitters are not seen directly by the camera.
        emitter_sampling: ``"weight"``: an emitter is chosen in proportion to its ``sampling_weight``. ``"power"``: to
            that times the power that it sends into the scene, which pays where there are many lights of different
            strength; no power counts for less than a tenth of the mean, so that black lights keep their derivative.
    """

    kind = "path"


class GradientIndexTracer(PathTracer):
    """`PathTracer`, by the name of what it does to rays in media whose index of refraction varies: it bends them.

    Which media do that the scene says (`GradientIndexMedium`), so that either name renders the same, as does the dict
    ``{"type": "path"}``. Where light paths begin at lamps, `ParticleTracer` bends them, too.
    """


class VolumetricPathTracer(_Paths):
    """Path tracer through media: free flights by delta tracking, light through media by ratio tracking.

    Emitter samples are combined with those of BSDFs and phase functions by the power heuristic. Media are those that
    shapes have as `interior` or `exterior`, and the `medium` of the camera. Surfaces whose BSDF is `null` bound a
    medium and are otherwise invisible: they let light through, and they do not count as segments.

    There are derivatives with respect to media, textures, materials and lights, and to what moves: boundaries of media,
    places of grids, surfaces, lights and cameras, with silhouettes and creases that the camera sees. Those lack the
    motion of edges of shadows, which `MissingTermWarning` says once; around a light within a medium, whose light falls
    off like 1 / r^2, they go like 1 / r^3, and their variance has no bound. With ``render(..., correlated=True)`` image
    and derivative share their samples; no hits are kept.

    Args:
        max_depth: longest path in segments, whose ends are surfaces and collisions in media; 1 shows emitters and
            emission only, 2 adds light that was scattered once, -1 is unlimited.
        rr_depth: number of segments after which Russian roulette may end a path, at least 1.
        hide_emitters: emitters are not seen directly by the camera.
        emitter_sampling: ``"weight"`` or ``"power"``, see `PathTracer`.
    """

    kind = "volpath"

    def config(self) -> dict[str, Any]:
        return {**super().config(), "volumetric": True}


class ParticleTracer(_Paths):
    """Light tracing: paths from the lights, connected to the camera wherever they meet no smooth mirror or glass.

    For caustics, which no path from the camera finds: light through glass, and beams (`directionalarea`). Its blind
    spot is what the camera sees in mirrors, through smooth glass and behind surfaces that are `null`, which is black,
    and lights whose ``sampling_weight`` is 0. Where both converge the image is that of `PathTracer`. ``spp`` times the
    number of pixels of the whole film paths are traced, divided among the lights by their weights, also where only a
    part of the film is wanted; each pixel of the film is a stratum of the unit square that lights are sampled from. The
    camera may be an `irradiancemeter`, which measures what arrives on a surface.

    Derivatives include the motion of what is seen over the film, for which the film needs a smooth filter (Gaussian or
    tent): with a box filter, asking for the derivative of something that moves raises `NotDifferentiableError`. They
    include that of silhouettes and shadows, by paths from the camera (see `visibility` of `render`). These do not find
    edges in the light of smooth mirrors, glass and beams: where such are in the scene, one `MissingTermWarning` names
    them, and one says that an `irradiancemeter` has none of it. Media are refused. There is no alpha and no variance.

    Args:
        max_depth: longest path in segments, the one to the camera included; 1 shows emitters only, 2 adds direct light,
            -1 is unlimited.
        rr_depth: number of segments after which Russian roulette may end a path, at least 1.
        hide_emitters: emitters are not seen directly by the camera.
        emitter_sampling: ``"weight"`` or ``"power"``, see `PathTracer`.
    """

    kind = "ptracer"

    def config(self) -> dict[str, Any]:
        return {**super().config(), "integrator": "ptracer"}


class WavefrontPathTracer(_Paths):
    """Path tracer in PyTorch, for scenes with a `TorchBSDF`: slower than `PathTracer`, and of the same samples.

    It does what `PathTracer` does, as tensor operations on all paths of a chunk at a time; the native core answers ray
    queries and gives the random numbers. Images of one seed are those of `PathTracer` to rounding. It has every native
    model, and BSDFs that are written in PyTorch, also inside of `twosided`, `blendbsdf`, `mask`, `normalmap` and
    `bumpmap`. Scenes with media are refused.

    The derivative is that of autograd: image and derivative have samples of their own, as with `render` in general.
    What is rendered keeps no graph; `backward()` traces the derivative's samples, `chunk` by `chunk`, so that memory
    goes with `chunk` times the length of paths and not with the image. It comprises what the native derivative does:
    textures, materials and lights, and the motion of surfaces and cameras without that of the edges that are seen and
    of those of shadows. Forward mode goes through the graph twice, which everything in a `TorchBSDF` then has to be
    differentiable twice for.

    Args:
        max_depth: longest path in segments; 1 shows emitters only, 2 adds direct light, -1 is unlimited.
        rr_depth: number of segments after which Russian roulette may end a path, at least 1.
        hide_emitters: emitters are not seen directly by the camera.
        chunk: number of paths that are traced together, at least 1.
    """

    kind = "wavefront"
    chunk = 1 << 16

    def __init__(
        self, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False, chunk: int = 1 << 16
    ) -> None:
        super().__init__(max_depth, rr_depth, hide_emitters)
        self.chunk = chunk
        self.config()

    def config(self) -> dict[str, Any]:
        chunk = integer(type(self).__name__, "chunk", self.chunk, 1)
        if self.emitter_sampling != "weight":
            raise ValueError(
                f"{type(self).__name__}: emitter_sampling: expected 'weight', got {self.emitter_sampling!r}; "
                "PathTracer has 'power'"
            )
        return {**super().config(), "integrator": "wavefront", "chunk": chunk}

    def extra_repr(self) -> str:
        return f"{super().extra_repr()}, chunk={self.chunk}"


class DirectIllumination(Integrator):
    """Direct light only: emitter and BSDF sampling at the first hit, combined by the power heuristic.

    Args:
        shading_samples: number of both kinds of samples, 1 if nothing is said.
        emitter_samples, bsdf_samples: numbers of each; one of them may be 0. Not together with `shading_samples`.
        hide_emitters: emitters are not seen directly by the camera.
        emitter_sampling: ``"weight"`` or ``"power"``, see `PathTracer`.
    """

    kind = "direct"

    def __init__(
        self,
        shading_samples: int | None = None,
        emitter_samples: int | None = None,
        bsdf_samples: int | None = None,
        hide_emitters: bool = False,
        emitter_sampling: str = "weight",
    ) -> None:
        super().__init__()
        if shading_samples is not None and (emitter_samples is not None or bsdf_samples is not None):
            raise ValueError(
                "DirectIllumination: give shading_samples, or emitter_samples and bsdf_samples, but not both"
            )
        both = 1 if shading_samples is None else integer("DirectIllumination", "shading_samples", shading_samples, 1)
        self.emitter_samples = both if emitter_samples is None else emitter_samples
        self.bsdf_samples = both if bsdf_samples is None else bsdf_samples
        self.hide_emitters = hide_emitters
        self.emitter_sampling = emitter_sampling
        self.config()

    def config(self) -> dict[str, Any]:
        emitter = integer("DirectIllumination", "emitter_samples", self.emitter_samples, 0)
        bsdf = integer("DirectIllumination", "bsdf_samples", self.bsdf_samples, 0)
        if emitter + bsdf == 0:
            raise ValueError("DirectIllumination: emitter_samples and bsdf_samples are both 0")
        return {
            "integrator": "direct",
            "max_depth": 2,
            "rr_depth": 1 << 20,
            "hide_emitters": boolean("DirectIllumination", "hide_emitters", self.hide_emitters),
            "emitter_sampling": word("DirectIllumination", "emitter_sampling", self.emitter_sampling, EMITTER_SAMPLING),
            "emitter_samples": emitter,
            "bsdf_samples": bsdf,
        }

    def extra_repr(self) -> str:
        shown = "" if self.emitter_sampling == "weight" else f", emitter_sampling={self.emitter_sampling!r}"
        return (
            f"emitter_samples={self.emitter_samples}, bsdf_samples={self.bsdf_samples}, "
            f"hide_emitters={self.hide_emitters}{shown}"
        )


class Stack(Integrator):
    """Base of integrators whose image has further channels besides those of a nested integrator."""

    integrator: Integrator | None
    second_moment = False  # whether the nested one's is wanted

    def config(self) -> dict[str, Any]:
        return (self.integrator or PathTracer()).config()

    def outputs(self) -> list[str]:
        """The names of `torchrender.outputs` of first hits that the channels are made of."""
        return []

    def wants_alpha(self, film: Any) -> bool:
        """Whether coverage follows radiance: the film's pixel format says so."""
        return self.integrator is not None and film.formats.get("pixel_format") in ("rgba", "luminance_alpha", "xyza")

    def stacked(self, found: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """One image of the outputs by name, channels last."""
        raise NotImplementedError


class Moment(Stack):
    """An image and, as further channels, the second moment of its samples: (H, W, 2 C).

    The second moment is ``sum(w x^2) / sum(w)`` over the samples x of a pixel, of weights w by the reconstruction
    filter. Only the image has a derivative. ``render(..., outputs=("rgb", "second_moment"))`` gives the two apart, and
    ``"variance"`` that of the image's values.

    Args:
        integrator: the nested one, `PathTracer` if none is given. Light tracing has no moments of a pixel.
    """

    kind = "moment"
    second_moment = True

    def __init__(self, integrator: Integrator | None = None) -> None:
        super().__init__()
        integrator = PathTracer() if integrator is None else integrator
        if not isinstance(integrator, (PathTracer, VolumetricPathTracer, DirectIllumination)):
            raise TypeError(f"Moment: integrator: expected one such as PathTracer(), got {describe(integrator)}")
        self.integrator = integrator

    def stacked(self, found: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return torch.cat([found["rgb"], found["second_moment"]], dim=-1)

    def wants_alpha(self, film: Any) -> bool:
        return False

    def channel_names(self, channels: int = 3) -> list[str]:
        """Names of the image's channels: ``"R"``, ``"G"``, ``"B"``, ``"m2.R"``, ``"m2.G"``, ``"m2.B"``."""
        color = "RGB" if channels == 3 else "Y"
        return [*color, *(f"m2.{c}" for c in color)]

    def __repr__(self) -> str:
        return f"Moment({self.integrator!r})"


class AOV(Stack):
    """Outputs besides radiance as further channels of the image, in Mitsuba's way of asking for them.

    The image is (H, W, C + n): that of the nested integrator, if there is one, then the channels of `aovs` in their
    order. As there, and other than with ``render(..., outputs=...)``, they are averages over all samples of a pixel, to
    which those that hit nothing add zeros, and ``depth`` is the length of the ray from the near plane. ``prim_index``
    and ``shape_index`` are those of the ray through the pixel's centre, -1 where it hits nothing; ``duv_dx`` and
    ``duv_dy`` are those of that ray, for a whole pixel, however many samples there are.

    Args:
        aovs: comma-separated pairs ``"name:type"``; types are ``depth``, ``position``, ``uv``, ``geo_normal``,
            ``sh_normal``, ``dp_du``, ``dp_dv``, ``duv_dx``, ``duv_dy``, ``albedo``, ``prim_index``, ``shape_index``.
        integrator: the nested one; without it there is no radiance.
    """

    kind = "aov"
    # Mitsuba's name: (ours, suffixes of its channels)
    QUANTITIES: ClassVar[dict[str, tuple[str, str]]] = {
        "depth": ("ray_length", "T"),
        "position": ("position", "XYZ"),
        "uv": ("uv", "UV"),
        "geo_normal": ("normal", "XYZ"),
        "sh_normal": ("shading_normal", "XYZ"),
        "dp_du": ("dp_du", "XYZ"),
        "dp_dv": ("dp_dv", "XYZ"),
        "duv_dx": ("duv_dx", "UV"),
        "duv_dy": ("duv_dy", "UV"),
        "albedo": ("albedo", "RGB"),
        "prim_index": ("prim_id", "I"),
        "shape_index": ("shape_id", "I"),
    }
    UNSUPPORTED: ClassVar[tuple[str, ...]] = ("boundary_test",)

    def __init__(self, aovs: str, integrator: Integrator | None = None) -> None:
        super().__init__()
        self.aovs = aovs
        if integrator is not None and (not isinstance(integrator, Integrator) or isinstance(integrator, Stack)):
            raise TypeError(f"AOV: integrator: expected an integrator such as PathTracer(), got {describe(integrator)}")
        self.integrator = integrator
        self.pairs()

    def pairs(self) -> list[tuple[str, str]]:
        """Names and types, checked."""
        if not isinstance(self.aovs, str):
            raise TypeError(f"AOV: aovs: expected a string such as 'dd:depth,nn:sh_normal', got {describe(self.aovs)}")
        found = []
        for pair in self.aovs.split(","):
            name, colon, kind = (part.strip() for part in pair.partition(":"))
            if not (name and colon and kind):
                raise ValueError(f"AOV: aovs: expected pairs 'name:type', got {pair.strip()!r}")
            if kind in self.UNSUPPORTED:
                raise ValueError(
                    f"AOV: aovs: {kind!r} is not supported by this version; supported are: {', '.join(self.QUANTITIES)}"
                )
            if kind not in self.QUANTITIES:
                raise ValueError(f"AOV: aovs: unknown type {kind!r}; {nearest(kind, self.QUANTITIES)}")
            found.append((name, kind))
        return found

    def outputs(self) -> list[str]:
        """The names of `torchrender.outputs` that the channels are made of."""
        return [self.QUANTITIES[kind][0] for _, kind in self.pairs()]

    def stacked(self, found: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """One image of the outputs by name, channels last."""
        names = [n for n in ("rgb", "alpha") if n in found] + self.outputs()
        plain = ("alpha", "ray_length", "prim_id", "shape_id")
        parts = [found[n].unsqueeze(-1) if n in plain else found[n] for n in names]
        real = next((p.dtype for p in parts if p.is_floating_point()), torch.float32)
        return torch.cat([p.to(real) for p in parts], dim=-1)

    def channel_names(self, channels: int = 3, alpha: bool = False) -> list[str]:
        """Names of the image's channels as in Mitsuba: ``"R"``, ``"G"``, ``"B"``, ``"dd.T"``, ``"nn.X"``, ...

        `channels` is the number of a colour's, `alpha` says whether coverage is among them.
        """
        color = "RGB" if channels == 3 else "Y"
        first = [] if self.integrator is None else [*color, *("A" if alpha else "")]
        suffixes = [(n, color if kind == "albedo" else self.QUANTITIES[kind][1]) for n, kind in self.pairs()]
        return first + [f"{name}.{suffix}" for name, some in suffixes for suffix in some]

    def __repr__(self) -> str:
        return f"AOV(aovs={self.aovs!r}, integrator={self.integrator!r})"


class Depth(Stack):
    """How far away what is seen is: (H, W, 1), the length of the ray from the near plane, 0 where it hits nothing.

    As with `AOV`, the average over all samples of a pixel. ``render(..., outputs=("depth",))`` leaves those out that
    hit nothing.
    """

    kind = "depth"
    integrator = None

    def outputs(self) -> list[str]:
        return ["ray_length"]

    def stacked(self, found: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return found["ray_length"].unsqueeze(-1)

    def channel_names(self, channels: int = 3) -> list[str]:
        """The name of the image's channel."""
        return ["depth.T"]

    def __repr__(self) -> str:
        return "Depth()"


class Stokes(Stack):
    """Polarised light: the image is (H, W, C, 4), the Stokes vectors (I, Q, U, V) of each colour.

    ``render(..., outputs=("stokes",))`` gives the same with any scene and integrator that has polarised light; see
    `torchrender.polarization`.

    Args:
        integrator: the nested one, `PathTracer` if none is given.
    """

    kind = "stokes"

    def __init__(self, integrator: Integrator | None = None) -> None:
        super().__init__()
        integrator = PathTracer() if integrator is None else integrator
        if not isinstance(integrator, (PathTracer, VolumetricPathTracer, DirectIllumination)):
            raise TypeError(f"Stokes: integrator: expected one such as PathTracer(), got {describe(integrator)}")
        self.integrator = integrator

    def channel_names(self, channels: int = 3) -> list[str]:
        """Names of an image (H, W, C, 4) whose last two axes are one, channel by channel: ``"S0.R"``, ``"S1.R"``."""
        return channel_names("RGB" if channels == 3 else "Y")

    def __repr__(self) -> str:
        return f"Stokes({self.integrator!r})"


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
