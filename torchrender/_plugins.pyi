# Types of the classes that are generated from the native declaration, made by:
#     python -c "from torchrender.scene import stubs; stubs.main()"

from typing import Any

import torch

from .scene.plugin import Plugin
from .typing import Color, Number, TextureLike

class AreaLight(Plugin):
    """An emitting shape."""

    def __init__(
        self,
        *,
        radiance: TextureLike = 1.0,
        sampling_weight: Number = 1.0,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor

class ConstantLight(Plugin):
    """A constant environment."""

    def __init__(
        self,
        *,
        radiance: Color = 1.0,
        sampling_weight: Number = 1.0,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor

class ConstantTexture(Plugin):
    """A colour that is the same everywhere."""

    def __init__(
        self,
        *,
        value: Color | None = None,
        **properties: Any,
    ) -> None: ...
    value: Any

class Diffuse(Plugin):
    """Ideal diffuse (Lambertian) reflection, one-sided."""

    def __init__(
        self,
        *,
        reflectance: TextureLike = 0.5,
        **properties: Any,
    ) -> None: ...
    reflectance: Any

class DirectionalAreaLight(Plugin):
    """A shape that emits along its normal."""

    def __init__(
        self,
        *,
        radiance: TextureLike = 1.0,
        sampling_weight: Number = 1.0,
        **properties: Any,
    ) -> None: ...
    radiance: Any
    sampling_weight: torch.Tensor

class HenyeyGreenstein(Plugin):
    """Henyey and Greenstein's phase function."""

    def __init__(
        self,
        *,
        g: Number = 0.8,
        **properties: Any,
    ) -> None: ...
    g: torch.Tensor

class Isotropic(Plugin):
    """Scatters alike in all directions."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...

class Null(Plugin):
    """Rays pass through unchanged."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...

class Rayleigh(Plugin):
    """Rayleigh's phase function, of particles like molecules."""

    def __init__(
        self,
        **properties: Any,
    ) -> None: ...
