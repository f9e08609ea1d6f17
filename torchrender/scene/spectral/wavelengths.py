"""At which wavelengths a spectral scene is looked at, and what they add to the film.

Wavelengths have half of their density from what the film responds to, and half from that times the scene's light, so
that narrow lines of lamps are found; a little is everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ... import spectrum
from ...functions import unwrapped
from ..context import SAMPLES
from ..host_memory import on_host
from ..packing import Layout
from .roles import LIGHT, roles_of

if TYPE_CHECKING:
    from ..scene import Scene

INTERVALS = 512  # of the inverse distribution, for each of the three thirds
EVERYWHERE = 0.02  # the share of wavelengths that are spread evenly


def wavelength_config(
    scene: Scene, layout: Layout, tensors: Sequence[torch.Tensor], weights: torch.Tensor | None = None
) -> tuple[tuple[int, int, int], tuple[torch.Tensor, ...]]:
    """What the core's settings say of wavelengths, addresses, and the tensors at these addresses.

    `tensors` are those for the core. Of lights that change there are new densities. `weights` (471, 3) are the film's,
    see `film_weights`, which None means; densities have no derivative by them.
    """
    lights = [
        (i, unwrapped(tensors[i]))
        for i, role in enumerate(roles_of(layout))
        if role == LIGHT and tensors[i].ndim == 1 and tensors[i].shape[0] == SAMPLES
    ]
    key = [(i, t.data_ptr(), -1 if t.is_inference() else t._version) for i, t in lights]
    old: Any = scene.__dict__.get("_wavelengths")
    changed = old is None or old[0] != key or old[1].dtype != scene.dtype or any(v < 0 for _, _, v in key)
    if changed or weights is not None:
        with torch._C._DisableFuncTorch():
            tables, of_film = [t for _, t in lights], film_weights() if weights is None else unwrapped(weights)
            seen = of_film.abs()
            if weights is not None:  # each band counts alike
                seen = seen / seen.sum(0).clamp(min=torch.finfo(seen.dtype).tiny)
            # the tensors are kept, too: equal addresses then mean equal contents
            old = (key, positions(tables, seen.sum(1)).to(scene.dtype), of_film.to(scene.dtype).contiguous(), tables)
        if weights is None:
            scene.__dict__["_wavelengths"] = old
    assert old is not None
    config = (old[1].data_ptr(), INTERVALS, old[2].data_ptr())
    return config, (old[1], old[2])


def film_weights() -> torch.Tensor:
    """(471, 3): red, green and blue of light that is relative to daylight, a nanometre at a time; float64."""
    d65 = spectrum.d65(torch.zeros((), dtype=torch.float64))
    weights = spectrum.responses(torch.float64) * d65[:, None]
    weights[[0, -1]] *= 2  # the ends have half a nanometre
    return weights


def sensor_weights(responses: torch.Tensor | None, srf: torch.Tensor | None) -> torch.Tensor | None:
    """The same of up to three `responses` (471, 3), None for the standard observer, and a sensor's response (471,)."""
    srf = None if srf is None else on_host(srf)
    if responses is None:
        return None if srf is None else film_weights() * srf.double()[:, None]
    responses = on_host(responses)
    if srf is not None:
        responses = responses * srf.double()[:, None]
    return responses * spectrum.d65(responses)[:, None]


def positions(lights: Sequence[torch.Tensor], seen: torch.Tensor) -> torch.Tensor:
    """The inverse of the wavelengths' distribution: nm above 360 at 3 * INTERVALS + 1 equally spaced numbers, float64.

    Args:
        lights: tables (471,) relative to daylight.
        seen: (471,) how much the film responds to them.
    """
    response = seen.double().numpy()
    shares = [response / response.sum()] if response.any() else [np.full(SAMPLES, 1 / SAMPLES)]
    light = np.zeros(SAMPLES)
    for table in lights:
        shown = response * table.double().abs().numpy()
        if 0 < shown.sum() < np.inf:
            light += shown / shown.sum()
    if light.sum() > 0:
        shares.append(light / light.sum())
    density = EVERYWHERE / SAMPLES + (1 - EVERYWHERE) * sum(shares) / len(shares)
    # of the piecewise linear density, on a finer grid
    fine = np.linspace(0, SAMPLES - 1, 20 * (SAMPLES - 1) + 1)
    values = np.interp(fine, np.arange(SAMPLES), density)
    cumulative = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2)])
    numbers = np.linspace(0, 1, 3 * INTERVALS + 1)
    return torch.from_numpy(np.interp(numbers, cumulative / cumulative[-1], fine))
