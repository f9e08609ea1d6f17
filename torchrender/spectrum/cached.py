"""Tensors that are made once."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch

_T = TypeVar("_T")


def made_once(function: Callable[..., _T]) -> Callable[..., _T]:
    """Keeps results, plain tensors even where the first call is inside of `torch.func` or `inference_mode`."""

    @functools.lru_cache(maxsize=8)
    def make(*arguments: Any) -> _T:
        plain = torch._C._DisableFuncTorch()
        with plain, torch.inference_mode(False), torch.no_grad():
            return function(*arguments)

    return functools.wraps(function)(make)
