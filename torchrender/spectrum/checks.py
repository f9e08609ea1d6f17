"""What arguments of this package have to be."""

from __future__ import annotations

from typing import Any

import torch

from ..errors import describe

SAMPLES = 471  # numbers of a table: one a nanometre, from 360 to 830 nm


def table(name: str, value: Any) -> torch.Tensor:
    """A tensor (..., 471), or an error."""
    return row(name, value, SAMPLES, "one number a nanometre from 360 to 830 nm")


def row(name: str, value: Any, size: int, what: str) -> torch.Tensor:
    """A floating-point tensor (..., size), or an error."""
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name}: expected a floating-point tensor of shape (..., {size}), got {describe(value)}")
    if value.ndim < 1 or value.shape[-1] != size:
        raise ValueError(f"{name}: expected shape (..., {size}), {what}, got {tuple(value.shape)}")
    return value


def numbers(name: str, value: Any, least: int = 0) -> torch.Tensor:
    """A floating-point tensor of `value`, a tensor or numbers, which are taken in float64.

    Args:
        least: how many numbers its last axis has at least; 0 for any shape.
    """
    tensor = value
    if not isinstance(value, torch.Tensor):
        try:
            tensor = torch.as_tensor(value, dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError):
            raise TypeError(f"{name}: expected numbers or a floating-point tensor, got {describe(value)}") from None
    if not tensor.is_floating_point():
        raise TypeError(f"{name}: expected a floating-point tensor, got {describe(value)}")
    if least and (tensor.ndim < 1 or tensor.shape[-1] < least):
        raise ValueError(f"{name}: expected shape (..., N), N at least {least}, got {tuple(tensor.shape)}")
    return tensor


def require(condition: torch.Tensor, name: str, expected: str, got: torch.Tensor) -> None:
    """ValueError unless `condition` holds everywhere. Inside of `vmap` nobody knows, and nothing is said."""
    try:
        fine = bool(condition.detach().all())
    except RuntimeError:
        return
    if not fine:
        wrong = got.detach().expand(condition.shape)[~condition.detach()]
        raise ValueError(f"{name}: expected {expected}, got {float(wrong.flatten()[0]):g}")
