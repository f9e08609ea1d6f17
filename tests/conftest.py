"""Marks the tests that exercise the native renderer, which are run again at every instruction set (``-m core``).

That follows from the folder: those of `models`, `integrators` and `derivatives` have the mark, but for modules that are
marked `once` and give a reason. Single modules and tests elsewhere are marked `core` where they stand.

Nothing that is there when all tests are collected, hundreds of thousands of objects, is garbage: the collector does not
look at it again.

With several processes (``-n``) the threads of torch, and of programs that tests start, are shared out among them.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Generator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
RENDERING = {"models", "integrators", "derivatives"}


def pytest_configure() -> None:
    # Before any module imports torch, which reads this once. Tests of threads set their number themselves.
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if workers > 1:
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        os.environ.setdefault("OMP_NUM_THREADS", str(max(1, available // workers)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


# Modules with tests of many seconds: they come first, so that no process is left with one at the end.
LONG = ("test_endurance", "test_host_card", "test_tutorial")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not item.path.stem.startswith(LONG))
    for item in items:
        folder = item.path.relative_to(TESTS).parts[0]
        if folder in RENDERING and item.get_closest_marker("once") is None:
            item.add_marker(pytest.mark.core)
