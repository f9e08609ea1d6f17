"""Spectral scenes of a few objects for which what is seen has a closed form, and tests of means."""

from __future__ import annotations

import math
from typing import Any

import torch

import torchrender as tr

DOUBLE = torch.float64
GRID = torch.arange(360, 831, dtype=DOUBLE)  # nm
SIGNIFICANCE = 1e-4  # of each test of a mean: so often a right renderer fails it


def waves(seed: int, low: float = 0.1, high: float = 0.9) -> torch.Tensor:
    """A table (471,) between `low` and `high` with a few hills, which is linear between wavelengths."""
    phase = torch.rand(3, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE) * 2 * torch.pi
    length = torch.tensor([190.0, 83.0, 41.0], dtype=DOUBLE)
    wave = torch.sin(2 * torch.pi * GRID[:, None] / length + phase).mean(1)
    return low + (high - low) * (wave + 1) / 2


def colour(*rgb: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(rgb)}


def diffuse(reflectance: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def camera(
    size: int = 16, fov: float = 2.0, origin=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0), film=None
) -> dict[str, Any]:
    """A camera whose pixels are independent."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, **(film or {})}
    place = tr.Transform.look_at(list(origin), list(target), [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": place, "film": film}


def load(objects: dict[str, Any], variant: str = "spectral", dtype=DOUBLE, depth: int = 2, **settings) -> tr.Scene:
    integrator = {"type": "path", "max_depth": depth}
    return tr.load_dict(
        {"type": "scene", "integrator": integrator, **objects}, variant=variant, dtype=dtype, **settings
    )


def plate(reflectance: Any, light: Any, film=None, **settings) -> tr.Scene:
    """A diffuse square that fills the view under parallel light from above: light * reflectance / pi, without noise
    but that of colour."""
    objects = {
        "camera": camera(film=film),
        "plate": {"type": "rectangle", "to_world": tr.Transform.scale(10), "bsdf": diffuse(reflectance)},
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": light},
    }
    return load(objects, **settings)


def runs(scene: tr.Scene, spp: int = 16, seed: int = 1, count: int = 1, **settings) -> torch.Tensor:
    """Pixels as independent runs (count * H * W, C), or of several seeds the means of images."""
    with torch.no_grad():
        settings = {"sampler": "independent", **settings}
        images = [tr.render(scene, spp=spp, seed=seed + i, **settings).double() for i in range(count)]
    if count > 1:
        return torch.stack([image.flatten(0, 1).mean(0) for image in images])
    return images[0].flatten(0, 1)


def assert_mean(found: torch.Tensor, expected: torch.Tensor, what: str = "mean", systematic: float = 1e-4) -> None:
    """Student's test of the mean of independent runs (R, ...), whose standard error is to be below 5 % of the largest.

    `systematic`: deviation that does not count, relative to the largest expected value.
    """
    found, expected = found.detach().double().flatten(1), expected.detach().double().flatten()
    assert found.shape[1:] == expected.shape
    mean, error = found.mean(0), found.std(0) / math.sqrt(len(found))
    scale = float(expected.abs().max())
    assert float(error.max()) <= 0.05 * scale, f"{what}: noise {error.max():.2g}"
    excess = ((mean - expected).abs() - systematic * scale).clamp(min=0)
    t = torch.where(excess == 0, 0.0, excess / error)
    level = tr.testing.sidak(SIGNIFICANCE, len(t))
    passed = tr.testing.student_p_value(t, len(found) - 1) >= level
    assert bool(passed.all()), f"{what}: {mean} instead of {expected}, standard error {error}"


def assert_same_mean(a: torch.Tensor, b: torch.Tensor, what: str = "means", systematic: float = 1e-4) -> None:
    """The same of two sets of independent runs."""
    count = min(len(a), len(b))
    other = b[:count].double().flatten(1)
    assert_mean(a[:count].double().flatten(1) - other + other.mean(0), other.mean(0), what, systematic)
