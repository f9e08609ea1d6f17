"""Bands of wavelengths that a film has in place of red, green and blue, and what a sensor responds to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch

from ..errors import describe
from ..functions import unwrapped
from . import spectra
from .context import SAMPLES, Context
from .values import has_tangent

if TYPE_CHECKING:
    from .film import Film

COMPONENTS = 3  # bands that are rendered together, as many as a path has wavelengths


def response(value: Any, ctx: Context) -> torch.Tensor:
    """A response by wavelength as a table (471,) in float64, from a number, a spectrum's dict or a table.

    A table with a derivative stays the tensor that it is, so that steps of an optimiser are seen.
    """
    if isinstance(value, torch.Tensor) and value.shape == (SAMPLES,) and (value.requires_grad or has_tangent(value)):
        _check(unwrapped(value), value, ctx)
        return value
    ctx = replace(ctx, color="spectral", dtype=torch.float64, emission=True, bounded=False)
    table = spectra.spectrum(value, ctx).detach()
    if table.shape not in ((), (SAMPLES,)):
        ctx.error(f"expected a spectrum or a table of {SAMPLES} numbers, got {describe(value)}")
    _check(table, value, ctx)
    return table.expand(SAMPLES).clone()


def _check(table: torch.Tensor, value: Any, ctx: Context) -> None:
    if not table.is_floating_point():
        ctx.error(f"expected a floating-point table, got {describe(value)}")
    if not bool(torch.isfinite(table).all()) or bool((table < 0).any()) or not bool((table > 0).any()):
        ctx.error("expected a response that is finite, not negative, and somewhere positive")


def bands(value: Any, ctx: Context) -> dict[str, torch.Tensor] | None:
    """Responses by name, or None for the standard observer's red, green and blue."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or not value:
        ctx.error(f"expected a dict of spectra by name, got {describe(value)}")
    return {str(name): response(content, ctx.at(str(name))) for name, content in value.items()}


def check_bands(film: Film, srf: torch.Tensor | None, spectral: bool) -> None:
    """ValueError for responses by wavelength in a scene that has none."""
    if spectral or (film.bands is None and srf is None):
        return
    what = "bands" if film.bands is not None else "the sensor's srf"
    raise ValueError(
        f"render: sensor: {what} need wavelengths, which this scene has not; load it with variant='spectral'"
    )


def groups(film: Film) -> list[torch.Tensor | None]:
    """What is rendered together: weights (471, 3) of up to three bands a group, or None for red, green and blue."""
    if film.bands is None:
        return [None]
    tables = [table.double() for table in film.bands.values()]
    tables += [torch.zeros_like(tables[0])] * (-len(tables) % COMPONENTS)
    return [torch.stack(tables[i : i + COMPONENTS], 1) for i in range(0, len(tables), COMPONENTS)]


def joined(parts: list[Any], film: Film) -> Any:
    """The bands of all groups in one image (..., J); of outputs that all groups have, the first's."""
    if film.bands is None:
        return parts[0]
    count = len(film.bands)
    if not isinstance(parts[0], tuple):
        return torch.cat(parts, -1)[..., :count]
    channels = [parts[0][0].ndim == value.ndim for value in parts[0]]
    return tuple(
        torch.cat(found, -1)[..., :count] if by_band else found[0]
        for found, by_band in zip(zip(*parts, strict=True), channels, strict=True)
    )
