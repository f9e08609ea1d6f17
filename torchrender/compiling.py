"""How a function stays outside of what `torch.compile` compiles, and of what CUDA graphs record."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import torch

try:
    from torch.compiler import is_compiling
except ImportError:  # torch 2.2 has it under another name
    from torch._utils import is_compiling

F = TypeVar("F", bound=Callable[..., Any])


def opaque(function: F) -> F:
    """Decorator: inside `torch.compile` the graph breaks once at this function, which runs as it always does.

    ``torch.compiler.disable`` would do, but imports the compiler, which takes longer than many a rendering. So the
    compiler's own name for it is called, and only where the compiler is at work.

    While a CUDA graph is recorded the function raises a RuntimeError: what it computes is not in the graph.
    """
    outside = getattr(torch, "_disable_dynamo", lambda f: f)(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if is_compiling():
            return outside(*args, **kwargs)
        if torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing():
            raise RuntimeError(
                f"{function.__name__}: a CUDA graph is being recorded, which cannot have what torchrender computes; "
                "call it before torch.cuda.graph(), and copy what it returns to a tensor that the graph reads"
            )
        return function(*args, **kwargs)

    return cast("F", call)
