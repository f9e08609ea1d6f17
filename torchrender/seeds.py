"""Seeds of images and their derivatives: drawn, checked, and made from one another by a hash."""

from __future__ import annotations

import warnings
from typing import Any

import torch

from .errors import depth_outside, describe
from .shares import ALONE
from .shares import current as current_share

MASK = (1 << 64) - 1
# What tells the derivative's seed from the image's.
GRADIENT_STREAM = 0x67726164


def mix(seed: int, stream: int) -> int:
    """A 64-bit hash of a seed and a stream number (splitmix64's finaliser)."""
    x = (seed + 0x9E3779B97F4A7C15 * (stream + 1)) & MASK
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & MASK
    return x ^ (x >> 31)


def _drawn(generator: torch.Generator | None) -> int:
    device = "cpu" if generator is None else generator.device
    with torch._C._DisableFuncTorch():  # vmap, also that of jacfwd, refuses to draw
        return int(torch.randint(0, (1 << 63) - 1, (1,), generator=generator, device=device))


def _seed(name: str, value: Any) -> int:
    if isinstance(value, torch.Generator):
        return _drawn(value)
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise TypeError(f"render: {name}: expected an integer, a torch.Generator or None, got {describe(value)}")
    value = value.__index__()
    if not 0 <= value <= MASK:
        raise ValueError(f"render: {name}: expected a number from 0 to 2**64 - 1, got {value}")
    return value


_compared = False


def _compare_with_other_ranks(seed: int) -> None:
    """Warn once if another process of the default group has begun with the same seed."""
    global _compared
    distributed = torch.distributed
    if _compared or not distributed.is_available() or not distributed.is_initialized():
        return
    _compared = True
    if distributed.get_world_size() == 1:
        return
    # The group's store, since a collective operation would wait for ranks that do not render.
    store = distributed.distributed_c10d._get_default_store()
    if store.add(f"torchrender/seed/{seed}", 1) > 1:
        warnings.warn(
            f"render: two processes of the group have the same seed ({seed}): their images have the same noise, which "
            "averaging gradients does not lessen. Give each its own: torch.manual_seed(rank), or "
            "seed=step * world_size + rank",
            UserWarning,
            stacklevel=depth_outside(),
        )


def seeds(seed: Any, seed_grad: Any, correlated: bool) -> tuple[int, int]:
    """The seeds of an image and of its derivative, from the arguments of `render`."""
    first = _drawn(None) if seed is None else _seed("seed", seed)
    if current_share() is ALONE:
        _compare_with_other_ranks(first)
    if correlated:
        if seed_grad is not None and _seed("seed_grad", seed_grad) != first:
            raise ValueError("render: correlated=True uses the samples of `seed`; leave seed_grad out")
        return first, first
    if seed_grad is None:
        return first, mix(first, GRADIENT_STREAM)
    second = _seed("seed_grad", seed_grad)
    if second == first:
        raise ValueError(
            f"render: seed_grad: equal to seed ({first}), which makes gradients of nonlinear losses biased; "
            "give another one, or correlated=True if that is meant"
        )
    return first, second
