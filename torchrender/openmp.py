"""The threads of PyTorch, which the core shares with it."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

FUNCTIONS = ("GOMP_parallel", "omp_get_thread_num", "omp_get_num_threads")


def addresses() -> tuple[int, int, int]:
    """Where `FUNCTIONS` are in GNU's OpenMP as PyTorch has loaded it; zeros where it runs its loops otherwise."""
    import torch

    package = Path(torch.__file__).parent
    for path in (*package.glob("lib/libgomp*.so*"), *package.parent.glob("torch.libs/libgomp*.so*")):
        try:
            library = ctypes.CDLL(str(path), mode=os.RTLD_NOW | os.RTLD_NOLOAD)
        except OSError:  # not loaded
            continue
        parallel, number, size = (ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in FUNCTIONS)
        return parallel, number, size
    return 0, 0, 0
