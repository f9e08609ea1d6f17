"""Derivatives with respect to what moves, and finite differences of the same samples."""

from __future__ import annotations

import functools

import reference_scenes
import torch

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

SIGNIFICANCE = 0.01  # of all tests of this file together


def direction_of(parameter: str, value: torch.Tensor) -> torch.Tensor:
    """A change of the parameter: matrices turn, move and stretch a little, without touching their last row."""
    generator = torch.Generator().manual_seed(11)
    if value.ndim == 2 and value.shape[0] == value.shape[1] and parameter.endswith(("to_world", "to_uv")):
        rigid = parameter.endswith("to_world")
        n = value.shape[0]
        change = torch.randn(n, n, generator=generator, dtype=torch.float64) * 0.3
        if rigid:
            change[:3, :3] = change[:3, :3] - change[:3, :3].T
        change[-1] = 0
        return change @ value.double()
    return torch.randn(value.shape, generator=generator, dtype=torch.float64)


def weighted(scene, show=None, **settings) -> torch.Tensor:
    """The weighted mean of an image, or of what `show` makes of it."""
    weight = torch.from_numpy(reference_scenes.weight(*scene.sensors[0].film.window[2:]))
    image = tr.render(scene, **settings)
    return ((image if show is None else show(image)) * weight).mean()


def gradients(scene, names: tuple[str, ...], seed: int, spp: int, show=None, **settings) -> dict[str, torch.Tensor]:
    """Those of `weighted` by several parameters, in one pass with samples of this seed."""
    values = {name: scene.get_parameter(name).detach().clone().requires_grad_() for name in names}
    # The samples of the image itself do not matter, so that one is enough.
    mean = weighted(scene, show, params=values, seed=seed + 1000, spp=1, spp_grad=spp, seed_grad=seed, **settings)
    return dict(zip(names, torch.autograd.grad(mean, list(values.values()))))


known_gradients = functools.lru_cache(maxsize=32)(gradients)  # of scenes that are not edited


def compare(
    scene, parameter: str, seeds: int, spp: int, step: float, show=None, together: tuple[str, ...] = (), **settings
) -> tuple[torch.Tensor, torch.Tensor]:
    """Derivatives, with these settings, and finite differences of the weighted mean of the image, by seed.

    `show`: makes an image of what is rendered with these settings. `together`: parameters, this one among them, that
    have their derivatives found in the same pass, which is kept for the tests of the others: of a scene at rest.
    """
    # Few rays weigh much: with these samples their number in a run of so many seeds is known.
    settings = {"sampler": "independent", **settings}
    value = scene.get_parameter(parameter).detach()
    direction = direction_of(parameter, value)
    derivatives, differences = [], []
    for seed in range(seeds):
        find = known_gradients if together else gradients
        gradient = find(scene, together or (parameter,), seed, spp, show, **settings)[parameter]
        derivatives.append(float((gradient * direction).sum()))
        with torch.no_grad():
            ahead, back = (
                weighted(
                    scene, show, params={parameter: value + sign * step * direction}, seed=seed, spp=spp, **settings
                )
                for sign in (1, -1)
            )
            change = ahead - back
        differences.append(float(change) / (2 * step))
    return torch.tensor(derivatives), torch.tensor(differences)


def agrees(derivatives: torch.Tensor, differences: torch.Tensor, rtol: float, tests: int) -> tuple[bool, str]:
    n = len(derivatives)
    gap = derivatives - differences
    error = gap.std() / n**0.5
    # rays start a little off the surface, by an amount whose derivative is left out: 1e-4 of the distances
    excess = (gap.mean().abs() - rtol * differences.mean().abs() - 5e-5).clamp_min(0)
    p = 1.0 if excess == 0 else float(student_p_value(excess / error, n - 1)) if error > 0 else 0.0
    text = f"derivative {derivatives.mean():.5g}, differences {differences.mean():.5g} +- {error:.2g}, p = {p:.2g}"
    return p >= sidak(SIGNIFICANCE, tests), text
