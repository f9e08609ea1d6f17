"""Polarised light in `render`: what of it there is, the call that renders it, and the outputs that are made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from . import polarization
from .errors import warn_once
from .first_hit_call import STOKES_OUTPUTS
from .integrators import Stack, VolumetricPathTracer, WavefrontPathTracer
from .render_call import RenderCall
from .scene.packing import Layout

# What polarises in nature, and does not here: surfaces, and phase functions that are tables of real particles.
GLOSSY = ("principled", "principledthin", "hair", "redner")
PARTICLES = ("tabphase",)

# What polarises nothing, nor changes what is polarised otherwise than by its weight.
UNPOLARIZED = {
    "bsdf": ("diffuse", "null", *GLOSSY, "twosided", "blendbsdf", "mask", "normalmap", "bumpmap"),
    "phase": ("isotropic", "hg", *PARTICLES, "blendphase"),
}


def polarizes(packed: Layout) -> bool:
    """Whether anything of the scene may polarise light. If not, its Stokes vectors are (I, 0, 0, 0)."""
    return any(
        kind not in unpolarized
        for category, unpolarized in UNPOLARIZED.items()
        for kind, _, _ in packed.objects[category]
    ) or any(slot.name.endswith(".stokes") for slot in packed.slots)


def check_polarized(
    integrator: Any, packed: Layout, names: Sequence[str], adaptive_grad: bool, warned: set[str]
) -> None:
    """ValueError for what has no polarised light; one warning about what should polarise and does not."""
    if isinstance(integrator, (WavefrontPathTracer, Stack)):
        raise ValueError(
            f"render: outputs: {type(integrator).__name__} has no polarised light ({', '.join(STOKES_OUTPUTS)}); "
            "PathTracer, VolumetricPathTracer, DirectIllumination and ParticleTracer have it"
        )
    if packed.bending:
        raise ValueError("render: outputs: light that gradientindex media bend has no polarisation")
    for name in ("variance", "second_moment"):
        if name in names:
            raise ValueError(f"render: outputs: polarised light has no {name!r}; radiance alone has")
    if adaptive_grad:
        raise ValueError("render: adaptive_grad: it is for radiance, not for polarised light")
    glossy = [f"{path} ({kind})" for kind, _, path in packed.objects["bsdf"] if kind in GLOSSY]
    if isinstance(integrator, VolumetricPathTracer):
        glossy += [f"{path} ({kind})" for kind, _, path in packed.objects["phase"] if kind in PARTICLES]
    if glossy:
        text = f"{', '.join(glossy[:4])}: what this scatters is unpolarised here; see docs/polarisation.md"
        warn_once(warned, "depolarised", text)


def polarized_call(call: RenderCall, packed: Layout) -> RenderCall:
    """The call that renders the Stokes vectors of this rendering, or intensities, where nothing polarises."""
    stokes = polarizes(packed)
    return replace(
        call,
        config={**call.config, "stokes": stokes},
        stokes=stokes,
        alpha=False,
        variance=False,
        second_moment=False,
        keep_hits=call.keep_hits and not stokes,
        requirements=replace(call.requirements, alpha=False),
    )


def stokes_image(parts: Sequence[torch.Tensor], channels: int, stokes: bool) -> torch.Tensor:
    """The Stokes vectors (..., C, 4) of all groups of bands, of which the first C are wanted.

    Each group is (..., 4 C'), or, without `stokes`, (..., C') of unpolarised light.
    """
    if not stokes:
        return torch.nn.functional.pad(torch.cat(list(parts), -1)[..., :channels, None], (0, 3))
    split = [part.unflatten(-1, (4, -1)).transpose(-1, -2) for part in parts]
    return torch.cat(split, -2)[..., :channels, :]


def stokes_outputs(stokes: torch.Tensor, names: Sequence[str]) -> dict[str, torch.Tensor]:
    """Those of `names` that Stokes vectors (..., C, 4) are enough for."""
    functions = {"dolp": polarization.dolp, "aolp": polarization.aolp, "docp": polarization.docp}
    found = {name: functions[name](stokes) for name in names if name in functions}
    if "stokes" in names:
        found["stokes"] = stokes
    if "rgb" in names:
        found["rgb"] = stokes[..., 0]
    return found
