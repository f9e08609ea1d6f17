"""Marks the tests that exercise the native renderer, which are run again at every instruction set (``-m core``)."""

from __future__ import annotations

import pytest

# Modules whose subject is Python alone, or which already start processes at several instruction sets.
PYTHON_ONLY = {
    "test_backends",
    "test_bench",
    "test_constraints",
    "test_endurance",  # takes long, and its subject is what is kept between calls
    "test_geometry_files",
    "test_docs",
    "test_io",
    "test_layer_autograd",
    "test_layer_display",
    "test_layer_module",
    "test_layer_processes",
    "test_optim",
    "test_project",
    "test_queries",
    "test_testing",
    "test_tutorials",
    "test_xml",
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem not in PYTHON_ONLY:
            item.add_marker(pytest.mark.core)
