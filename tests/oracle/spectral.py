"""Images of spectral scenes: at its three wavelengths each sample sees a scene of three colours, and is traced alone.

The wavelengths are the native ones (csrc/core/color/spectral.h), by their hash once more, of the same distribution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from unittest import mock

import torch

import torchrender as tr
from torchrender.scene.camera import Rays
from torchrender.scene.gather import gather
from torchrender.scene.spectral.core_values import for_core
from torchrender.scene.spectral.roles import NUMBER, VECTOR, roles_of
from torchrender.scene.spectral.wavelengths import wavelength_config
from torchrender.wavefront import bsdfs
from torchrender.wavefront.path import Vertices
from torchrender.wavefront.world import World

from .bsdf import in_pytorch
from .bsdf.smooth import DispersiveDielectric
from .film import camera_samples, numbers_of, splat
from .polarized import PolarizedTracer

SAMPLES = 471
BLOCK, WORD = 0x3FFFFFFE, 0xFFFFFFFF


class SplittingDielectric(DispersiveDielectric):
    """Of a path's wavelengths the first one is refracted for all of them."""

    def chance(self, reflectances: torch.Tensor) -> torch.Tensor:
        return super().chance(reflectances) if self.world.single else reflectances.mean(1)

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        first = self.eta.new_tensor([1.0 if self.world.single else 3.0, 0.0, 0.0])
        return super().eval(wi, wo, lobe) * torch.where((lobe == 0)[:, None], 1.0, first)


class SpectralTracer(PolarizedTracer):
    """Traces one path; `world.single` says whether but one of its wavelengths is left."""

    def throughput(
        self, number: int, vertices: Vertices, d: torch.Tensor, lobe: torch.Tensor, value: torch.Tensor
    ) -> torch.Tensor:
        found = super().throughput(number, vertices, d, lobe, value)
        if isinstance(self.bsdf(number, vertices), SplittingDielectric) and bool(lobe != 0):
            self.world.single = True
        return found


def philox(counter: list[int], key: tuple[int, int]) -> list[int]:
    """Philox4x32 with 7 rounds: Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3", SC 2011."""
    a, b, c, d = counter
    k, m = key
    for _ in range(7):
        left, right = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b, c, d = (right >> 32) ^ b ^ k, right & WORD, (left >> 32) ^ d ^ m, left & WORD
        k, m = (k + 0x9E3779B9) & WORD, (m + 0xBB67AE85) & WORD
    return [a, b, c, d]


def wavelengths(positions: torch.Tensor, seed: int, pixel: int, sample: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Three wavelengths in nm above 360, and for each 1 / (3 density): (3,) and (3,)."""
    intervals = (len(positions) - 1) // 3
    v, h, _, _ = philox([pixel, 0, BLOCK, 0], (seed & WORD, seed >> 32))
    place = (((v + sample * 0x9E3779B9) & WORD) >> 8) / 2**24 * intervals
    third = ((sample + (h >> 1)) & WORD) % 3
    index = torch.tensor([math.floor(place) + (third + c) % 3 * intervals for c in range(3)])
    low, high = positions[index], positions[index + 1]
    return low + (place - math.floor(place)) * (high - low), (high - low) * intervals


def at(table: torch.Tensor, waves: torch.Tensor) -> torch.Tensor:
    """A table (471, ...) at wavelengths (3,): (3, ...), by straight lines."""
    index = waves.floor().long().clamp(0, SAMPLES - 2)
    share = (waves - index).reshape(-1, *[1] * (table.ndim - 1))
    return table[index] * (1 - share) + table[index + 1] * share


def colours(tensor: torch.Tensor, waves: torch.Tensor) -> torch.Tensor:
    """Tables (471,) or sigmoids (..., 4) at wavelengths (3,): (3,) or (..., 3)."""
    if tensor.ndim == 1 and len(tensor) == SAMPLES:
        return at(tensor, waves)
    if tensor.ndim < 2 or tensor.shape[-1] != 4:
        return tensor
    a, b, c, factor = tensor.unsqueeze(-2).unbind(-1)
    x = waves / (SAMPLES - 1)
    q = (a * x + b) * x + c
    return factor * (0.5 + q / (2 * torch.sqrt(1 + q * q)))


def stokes_image(
    scene: tr.Scene,
    *,
    seed: int,
    spp: int,
    params: Mapping[str, torch.Tensor] | None = None,
    derivative: bool = False,
) -> torch.Tensor:
    """(H, W, 3, 4), attached to `params`: see oracle.polarized.stokes_image."""
    layout = scene.layout()
    tensors = for_core(scene, layout, gather(scene, layout, params))
    native = scene.native(layout, [tuple(t.shape) for t in tensors])
    _, (positions, of_film) = wavelength_config(scene, layout, tensors)
    is_colour = [role not in (None, NUMBER, VECTOR) for role in roles_of(layout)]
    whole = World(scene, layout, native, tensors, moving=True)
    place, rays, pixel, sample = camera_samples(whole, seed, spp, 0)
    config = {**tr.PathTracer().config(), **(scene.integrator or tr.PathTracer()).config()}
    random = numbers_of(scene, spp, seed, 0)
    found = []
    with in_pytorch(), mock.patch.dict(bsdfs.BSDFS, {"dispersivedielectric": SplittingDielectric}):
        for i in range(len(pixel)):
            waves, inverse = wavelengths(positions, seed, int(pixel[i]), int(sample[i]))
            seen = [colours(t, waves) if coloured else t for t, coloured in zip(tensors, is_colour, strict=True)]
            world = World(scene, layout, native, seen, moving=True)
            world.plain, world.single = whole.plain, False  # (the native scene has tensors of these shapes)
            one = Rays(*(t[i : i + 1] for t in rays))
            stokes, _ = SpectralTracer(world, config, random, derivative).trace(
                one, pixel[i : i + 1], sample[i : i + 1]
            )
            weights = at(of_film, waves) * inverse[:, None]
            found.append(torch.einsum("wj,nws->njs", weights, stokes))
    sums, share = splat(scene.sensors[0].film, *place.unbind(1), torch.cat(found).flatten(1))
    return (sums / share).unflatten(-1, (-1, 4))
