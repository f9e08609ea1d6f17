# Types of the classes that are generated from the native declaration, made by:
#     python -c "from torchrender.scene import signatures; signatures.main()"

from typing import Any

import torch

from .scene.plugin import Plugin
from .typing import Array, Color, Matrix, Number, TextureLike

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

class Constvolume(Plugin):
    """The same value everywhere."""

    def __init__(
        self,
        *,
        value: Color = 1.0,
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

class Gridvolume(Plugin):
    """Voxels, trilinear or nearest."""

    def __init__(
        self,
        *,
        data: Array | None = None,
        to_world: Matrix | None = None,
        filter_type: str = 'bilinear',
        wrap_mode: str = 'clamp',
        **properties: Any,
    ) -> None: ...
    data: torch.Tensor
    to_world: torch.Tensor
    filter_type: Any
    wrap_mode: Any

class Heterogeneous(Plugin):
    """A medium whose extinction may be a grid."""

    def __init__(
        self,
        *,
        sigma_t: Any | None = None,
        albedo: Any | None = None,
        emission: Any | None = None,
        scale: Number = 1.0,
        phase: Any | None = None,
        **properties: Any,
    ) -> None: ...
    sigma_t: torch.Tensor
    albedo: torch.Tensor
    emission: torch.Tensor
    scale: torch.Tensor
    phase: torch.Tensor

class Hg(Plugin):
    """Henyey and Greenstein's phase function."""

    def __init__(
        self,
        *,
        g: Number = 0.8,
        **properties: Any,
    ) -> None: ...
    g: torch.Tensor

class Homogeneous(Plugin):
    """A medium whose extinction is the same everywhere."""

    def __init__(
        self,
        *,
        sigma_t: Any | None = None,
        albedo: Any | None = None,
        emission: Any | None = None,
        scale: Number = 1.0,
        phase: Any | None = None,
        **properties: Any,
    ) -> None: ...
    sigma_t: torch.Tensor
    albedo: torch.Tensor
    emission: torch.Tensor
    scale: torch.Tensor
    phase: torch.Tensor

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
