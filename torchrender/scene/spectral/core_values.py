"""From the tensors of a spectral scene to those that the core takes.

A colour becomes the spectrum that it stands for in PyTorch, so that its derivative is autograd's: a constant a table, a
number a nanometre; texels, voxels and colours of vertices a sigmoid's coefficients and a factor. Light is relative to
daylight, which the weights of the film bring back (`wavelengths`): the rgb of a lamp are its colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from ... import spectrum
from ...functions import functorch, unwrapped
from ..context import LUMINANCE, SAMPLES
from ..gather import has_derivative
from ..packing import Layout
from .roles import BOUNDED, LIGHT, NUMBER, VECTOR, roles_of

if TYPE_CHECKING:
    from ..scene import Scene


def for_core(scene: Scene, layout: Layout, tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    """`tensors` by slot with all colours as the core takes them; those of other variants as they are.

    What has no derivative is converted again only when it has changed.
    """
    result = list(tensors)
    if not layout.spectral:
        return result
    kept: dict[int, tuple[torch.Tensor, int, str, torch.Tensor]] = scene.__dict__.setdefault("_spectra", {})
    for i, role in enumerate(roles_of(layout)):
        given = result[i]
        if role is None or given.ndim == 0 or given.shape[-1] == 1 or role == VECTOR:
            continue
        if has_derivative(given) or functorch.is_functorch_wrapped_tensor(given):
            result[i] = convert(given, role)
            continue
        version = -1 if given.is_inference() else given._version
        old = kept.get(i)
        same = (
            old is not None and version >= 0 and old[0].data_ptr() == given.data_ptr() and old[1:3] == (version, role)
        )
        if old is None or not same or old[0].shape != given.shape or old[0].dtype != given.dtype:
            # the alias holds the memory, so that an equal address means the same
            kept[i] = old = (unwrapped(given), version, role, unwrapped(convert(given.detach(), role)))
        result[i] = old[3]
    return result


def convert(given: torch.Tensor, role: str) -> torch.Tensor:
    """A colour (3,) or table (471,), or rgb texels (..., 3), as a table or as sigmoids (..., 4); numbers (..., 1)."""
    constant = given.ndim == 1
    if constant and given.shape[0] == SAMPLES:
        if role == NUMBER:
            return spectrum.to_rgb(given, spectrum.d65(given)) @ given.new_tensor(LUMINANCE)
        return given / spectrum.d65(given) if role == LIGHT else given
    if role == NUMBER:
        grey = (given * given.new_tensor(LUMINANCE)).sum(-1, keepdim=not constant)
        return grey.contiguous()
    sigmoids = spectrum.upsample(given, exact=constant, light=role != BOUNDED)
    if not constant:
        return sigmoids.contiguous()
    return sigmoids[3] * spectrum.sigmoid(sigmoids[:3])
