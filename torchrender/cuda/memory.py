"""Memory of cards, from PyTorch: it counts what a scene takes there, and gives back what it has kept for itself.

The core calls Python for it, seldom: it keeps what it has.
"""

from __future__ import annotations

import ctypes
from typing import Any

import torch

from ..library import Library


class Request(ctypes.Structure):
    """CardMemory::Request: so many bytes for work on this stream; or, with an address, what is given back.

    No bytes: the driver has no room itself, where PyTorch may keep some that nobody uses.
    """

    _fields_ = (
        ("size", ctypes.c_size_t),
        ("ordinal", ctypes.c_int),
        ("stream", ctypes.c_void_p),
        ("memory", ctypes.c_void_p),
        ("served", ctypes.c_int),  # without an address: there is no room
    )


errors: list[BaseException] = []
"""What a call of the core has ended for, besides a lack of memory; Ctrl-C, say."""


@ctypes.CFUNCTYPE(None, ctypes.POINTER(Request))
def _serve(given: Any) -> None:
    try:
        request = given.contents
        if request.memory:
            torch.cuda.caching_allocator_delete(request.memory)
        elif not request.size:
            torch.cuda.empty_cache()
        else:
            request.memory = torch.cuda.caching_allocator_alloc(request.size, request.ordinal, request.stream or 0)
        request.served = 1
    except torch.cuda.OutOfMemoryError:
        given.contents.served = 1
    except BaseException as error:  # what is raised here nobody would hear of: the core sees that it was not served
        errors.append(error)


def use_memory(core: Library) -> None:
    """Have the core take memory of cards from PyTorch from now on."""
    core.use_cuda_memory(ctypes.cast(_serve, ctypes.c_void_p).value)
