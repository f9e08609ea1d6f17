"""What `render` is called with, read and checked before any work is done."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from .errors import SubstitutionWarning, describe, nearest, warn_once
from .functions import functorch
from .integrators import DOCUMENTED, TYPES, Integrator, ParticleTracer, PathTracer, from_dict
from .scene.camera import film_size
from .scene.context import Context
from .scene.film import SAMPLERS, Film, check_crop, check_sampler
from .scene.ranges import MODES as RANGE_MODES
from .scene.scene import Scene
from .scene.sensor import IrradianceMeter, Sensor

LAYOUTS = ("hwc", "chw", "bhwc", "bchw")


def check_words(layout: Any, nan: Any, sampler: Any, range: Any) -> None:
    """Check `layout`, `nan`, `sampler` and `range` of `render`."""
    if layout not in LAYOUTS:
        raise ValueError(f"render: layout: expected one of {', '.join(LAYOUTS)}, got {layout!r}")
    if nan not in ("drop", "raise"):
        raise ValueError(f"render: nan: expected 'drop' or 'raise', got {nan!r}")
    if range not in RANGE_MODES:
        raise ValueError(f"render: range: expected one of {', '.join(RANGE_MODES)}, got {range!r}")
    if sampler is not None:
        if not isinstance(sampler, str):
            raise TypeError(f"render: sampler: expected one of {', '.join(SAMPLERS)}, got {describe(sampler)}")
        check_sampler(sampler, Context(path=("render: sampler",)))


def check_kinds_of_derivative(adaptive_grad: Any, correlated: Any) -> None:
    """Check `adaptive_grad` and `correlated` of `render`."""
    for name, value in (("adaptive_grad", adaptive_grad), ("correlated", correlated)):
        if not isinstance(value, bool):
            raise TypeError(f"render: {name}: expected True or False, got {describe(value)}")
    if adaptive_grad and correlated:
        raise ValueError(
            "render: adaptive_grad=True draws samples of its own, and correlated=True uses those of the image; "
            "leave one of them out"
        )


_default = functools.cache(PathTracer)


def as_integrator(scene: Scene, integrator: Any) -> Integrator:
    """The integrator that is given, described or named; the scene's own, else a path tracer, if it is None."""
    if integrator is None:
        integrator = scene.integrator or _default()  # nobody else gets hold of it
    elif isinstance(integrator, (Mapping, str)):
        given = {"type": integrator} if isinstance(integrator, str) else dict(integrator)
        kind = given.get("type")
        if kind not in TYPES:
            if kind in DOCUMENTED:
                raise ValueError(
                    f"render: integrator: {kind!r} is not supported by this version; supported are: {', '.join(TYPES)}"
                )
            raise ValueError(f"render: integrator: unknown type {kind!r}; {nearest(str(kind), TYPES)}")
        integrator = from_dict(given, "render: integrator")
    if not isinstance(integrator, Integrator):
        raise TypeError(f"render: integrator: expected an integrator such as PathTracer(), got {describe(integrator)}")
    return integrator


def measuring(scene: Scene, integrator: Integrator, cameras: Sequence[Sensor]) -> Integrator:
    """The scene's own integrator, or light tracing in place of a path tracer where there are meters alone.

    Mitsuba's path tracer starts at points of a meter's surface; with light from everywhere the two agree.
    """
    if type(integrator) is not PathTracer or not all(isinstance(camera, IrradianceMeter) for camera in cameras):
        return integrator
    text = "render: an irradiancemeter is measured by light tracing: ParticleTracer takes the place of PathTracer"
    warn_once(scene.warned, "irradiancemeter", text, SubstitutionWarning)
    settings = ("max_depth", "rr_depth", "hide_emitters", "emitter_sampling")
    return ParticleTracer(**{name: getattr(integrator, name) for name in settings})


def count(name: str, value: Any, minimum: int = 1, maximum: int = 1 << 32) -> int:
    """`value` as an integer from `minimum` to `maximum`; errors name the argument of `render`."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise TypeError(f"render: {name}: expected an integer, got {describe(value)}")
    value = value.__index__()
    if not minimum <= value <= maximum:
        raise ValueError(f"render: {name}: expected a number from {minimum} to {maximum}, got {value}")
    return value


def pair(name: str, value: Any) -> tuple[int, int] | None:
    """Two numbers of samples: `value` twice if it is one, or None."""
    if value is None:
        return None
    if isinstance(value, (tuple, list)):
        if len(value) != 2:
            raise ValueError(f"render: {name}: expected a number or two of them, got {len(value)}")
        return count(f"{name}[0]", value[0], 0), count(f"{name}[1]", value[1], 0)
    both = count(name, value, 0)
    return both, both


def film_of_size(film: Film, size: Any) -> Film:
    """`film` with `size` (H, W) in place of its own; itself if that is None."""
    if size is None:
        return film
    height, width = film_size(size, Context(path=("render: size",)))
    return replace(film, width=width, height=height, crop=None)


def film_config(film: Film, crop: Any) -> tuple[tuple[int, int, int, int], tuple[int, int], dict[str, Any]]:
    """What is rendered, its size, and the film's settings for the core."""
    film.check(Context(path=("film",)))
    y0, x0, height, width = film.window
    rendered = film.window
    sampled = film.window
    if film.sample_border:
        margin = max(0, math.ceil(film.filter.reach - 0.5))
        sampled = (y0 - margin, x0 - margin, height + 2 * margin, width + 2 * margin)
    if crop is not None:
        top, left, rows, columns = check_crop(crop, (height, width), Context(path=("render",)))
        rendered = (y0 + top, x0 + left, rows, columns)
    config = {
        "film_size": (film.height, film.width),
        "window": sampled,
        "border": crop is not None or film.sample_border,
        "filter": film.filter.type,
        "filter_param": film.filter.parameters,
    }
    return rendered, rendered[2:], config


def pixels_inside(pixels: Any, size: tuple[int, int]) -> np.ndarray:
    """`pixels` as int64 (N, 2) inside an image of `size`."""
    if isinstance(pixels, torch.Tensor):
        if pixels.is_floating_point() or pixels.is_complex() or pixels.dtype == torch.bool:
            raise TypeError(f"render: pixels: expected integers, rows and columns, got {describe(pixels)}")
        while functorch.is_functorch_wrapped_tensor(pixels):
            pixels = functorch.get_unwrapped(pixels)
        with torch._C._DisableFuncTorch():  # inside jvp every new tensor would be wrapped and have no memory to read
            pixels = pixels.detach().cpu().numpy()
    else:
        try:
            pixels = np.asarray(pixels)
        except ValueError:
            pixels = np.asarray("ragged")
        if pixels.dtype.kind not in "iu":
            raise TypeError(f"render: pixels: expected an integer tensor (N, 2), got {pixels.dtype} {pixels.shape}")
    if pixels.ndim != 2 or pixels.shape[1] != 2:
        raise ValueError(f"render: pixels: expected shape (N, 2), rows and columns, got {pixels.shape}")
    # always a copy: backward() reads it too, whatever the caller does to theirs in the meantime
    pixels = np.array(pixels, dtype=np.int64, order="C")
    # numpy's maximum along the first of two axes is slow
    if len(pixels) and (pixels.min() < 0 or any(pixels[:, k].max() >= size[k] for k in range(2))):
        wrong = pixels[np.any((pixels < 0) | (pixels >= np.asarray(size)), axis=1)][0]
        raise ValueError(
            f"render: pixels: {tuple(wrong.tolist())} is not inside an image of {size[0]} rows and {size[1]} columns"
        )
    return pixels
