"""Memory of cards, from PyTorch: it counts what a scene takes there, and gives back what it has kept for itself.

The core calls Python for it, seldom: it keeps what it has.
"""

from __future__ import annotations

import ctypes

import torch

from ..library import Library


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
def _take(size: int, ordinal: int) -> int | None:
    """So many bytes, for work in the order of the stream that PyTorch has now; None if there is no room."""
    try:
        return torch.cuda.caching_allocator_alloc(size, ordinal)
    except torch.cuda.OutOfMemoryError:
        return None


@ctypes.CFUNCTYPE(None, ctypes.c_void_p)
def _give_back(address: int) -> None:
    torch.cuda.caching_allocator_delete(address)


def use_memory(core: Library) -> None:
    """Have the core take memory of cards from PyTorch from now on."""
    core.use_cuda_memory(*(ctypes.cast(function, ctypes.c_void_p).value for function in (_take, _give_back)))
