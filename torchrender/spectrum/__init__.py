"""Spectra as tensors: 471 numbers on the last axis, one a nanometre from 360 to 830 nm. Differentiable and batched.

Tables come from measured values (`regular`, `irregular`), light (`d65`, `illuminant_a`, `blackbody`), colours
(`upsample`, `rgb_to_coefficients`, `sigmoid`) and indices of refraction (`cauchy`, `sellmeier`, `abbe`, `glass`,
`from_refractiveindex`). `to_rgb` is the colour that they have.
"""

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
