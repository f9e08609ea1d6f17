"""Spectra as tensors: 471 numbers on the last axis, one a nanometre from 360 to 830 nm. Differentiable and batched.

Tables come from measured values (`regular`, `irregular`), light (`d65`, `illuminant_a`, `blackbody`), colours
(`upsample`, `rgb_to_coefficients`, `sigmoid`) and indices of refraction (`cauchy`, `sellmeier`, `abbe`, `glass`,
`from_refractiveindex`). `to_rgb` is the colour that they have.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what __getattr__ below finds
    from .glasses import glass as glass
    from .indices import abbe as abbe
    from .indices import abbe_number as abbe_number
    from .indices import cauchy as cauchy
    from .indices import sellmeier as sellmeier
    from .lights import blackbody as blackbody
    from .lights import d65 as d65
    from .lights import illuminant_a as illuminant_a
    from .observer import responses as responses
    from .observer import to_rgb as to_rgb
    from .observer import wavelengths as wavelengths
    from .refractiveindex import from_refractiveindex as from_refractiveindex
    from .sampled import irregular as irregular
    from .sampled import regular as regular
    from .sigmoids import sigmoid as sigmoid
    from .upsampling import rgb_to_coefficients as rgb_to_coefficients
    from .upsampling import upsample as upsample

# Imported when first used: scenes without spectra need none of these.
_NAMES = {
    "abbe": "indices",
    "abbe_number": "indices",
    "blackbody": "lights",
    "cauchy": "indices",
    "d65": "lights",
    "from_refractiveindex": "refractiveindex",
    "glass": "glasses",
    "illuminant_a": "lights",
    "irregular": "sampled",
    "regular": "sampled",
    "responses": "observer",
    "rgb_to_coefficients": "upsampling",
    "sellmeier": "indices",
    "sigmoid": "sigmoids",
    "to_rgb": "observer",
    "upsample": "upsampling",
    "wavelengths": "observer",
}


def __getattr__(name: str) -> Any:
    if name not in _NAMES:
        from ..errors import close_to

        hint = "" if name.startswith("_") else close_to(name, _NAMES)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    value = getattr(importlib.import_module(f".{_NAMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(_NAMES)
