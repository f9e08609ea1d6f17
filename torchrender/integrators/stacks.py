"""Integrators whose image has other channels than radiance: those of a nested integrator, and of first hits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch

from ..errors import describe, nearest
from ..polarization import channel_names
from .transport import DirectIllumination, Integrator, PathTracer, VolumetricPathTracer


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

    def channel_names(self, channels: int = 3) -> list[str]:
        """Names of the image's channels; `channels` is the number of a colour's."""
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
