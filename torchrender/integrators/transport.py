"""Integrators: small modules without weights that say how light transport is computed.

They hold settings only; the work is done by the native core.
"""

from __future__ import annotations

import functools
import inspect
from typing import Any

from torch import nn

from ..errors import nearest
from ..settings import boolean, integer, is_own, word

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
