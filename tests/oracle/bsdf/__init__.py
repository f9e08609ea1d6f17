"""The native BSDFs once more, as plain tensor operations that autograd differentiates.

`in_pytorch` puts them in the place of the native ones in the path tracer of `torchrender.wavefront`.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from unittest import mock

from torchrender.wavefront import bsdfs
from torchrender.wavefront.bsdf import Bsdf

from .coated import Plastic, PPlastic, RoughPlastic
from .hair import Hair
from .principled import Principled, PrincipledThin
from .redner import RednerMaterial
from .rough import AnisotropicConductor, AnisotropicDielectric, RoughConductor, RoughDielectric
from .smooth import (
    CircularPolarizer,
    Conductor,
    Dielectric,
    Diffuse,
    DispersiveDielectric,
    Null,
    Polarizer,
    Retarder,
    ThinDielectric,
)

MODELS: dict[str, type[Bsdf]] = {
    "diffuse": Diffuse,
    "conductor": Conductor,
    "roughconductor": RoughConductor,
    "anisotropicconductor": AnisotropicConductor,
    "dielectric": Dielectric,
    "dispersivedielectric": DispersiveDielectric,
    "roughdielectric": RoughDielectric,
    "anisotropicdielectric": AnisotropicDielectric,
    "thindielectric": ThinDielectric,
    "plastic": Plastic,
    "roughplastic": RoughPlastic,
    "pplastic": PPlastic,
    "principled": Principled,
    "principledthin": PrincipledThin,
    "redner": RednerMaterial,
    "hair": Hair,
    "null": Null,
    "polarizer": Polarizer,
    "circular": CircularPolarizer,
    "retarder": Retarder,
    "mask": Null,  # what is met of one where it is not
}


def in_pytorch() -> AbstractContextManager[object]:
    """While it is entered, the path tracer in PyTorch evaluates these models, also in derivatives."""
    return mock.patch.dict(bsdfs.BSDFS, MODELS)
