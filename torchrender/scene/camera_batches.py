"""Constructors of cameras that take a batch: arguments with a leading dimension give a list."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import torch

from ..transform import plain

Constructor = TypeVar("Constructor", bound=Callable[..., Any])


def batched(**dimensions: int) -> Callable[[Constructor], Constructor]:
    """Decorator: where these arguments have a leading dimension more than that, a list of cameras comes back."""

    def decorate(function: Constructor) -> Constructor:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def make(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            given = {n: plain(bound.arguments[n]) for n in dimensions if bound.arguments.get(n) is not None}
            counts = {n: len(value) for n, value in given.items() if _dimensions(value) == dimensions[n] + 1}
            if not counts:
                return function(*args, **kwargs)
            if len(set(counts.values())) > 1:
                each = ", ".join(f"{n} {count}" for n, count in counts.items())
                raise ValueError(f"{function.__name__}: numbers of cameras that differ: {each}")
            cameras = []
            for i in range(next(iter(counts.values()))):
                bound.arguments.update({n: given[n][i] for n in counts})
                cameras.append(function(*bound.args, **bound.kwargs))
            return cameras

        return cast("Constructor", make)

    return decorate


def _dimensions(value: Any) -> int:
    if isinstance(value, torch.Tensor):
        return value.ndim
    try:
        return np.ndim(value)
    except ValueError:  # rows of different lengths
        return -1
