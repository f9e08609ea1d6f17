"""What tests of tutorials begin with."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from killed_tutorials import TUTORIALS


@pytest.fixture
def tutorial(monkeypatch) -> Callable[[str], ModuleType]:
    """Imports a tutorial as it is when it is run: with its own folder first on the path."""
    monkeypatch.syspath_prepend(str(TUTORIALS))
    return importlib.import_module


@pytest.fixture
def settings_of(tutorial, monkeypatch, tmp_path) -> Callable[..., dict[str, Any]]:
    """What a tutorial's `run` is given, but for the folder, when it is started with these options."""

    def settings_of(name: str, *options: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        module = tutorial(name)
        monkeypatch.setattr(module, "run", lambda folder, **settings: found.update(settings))
        module.main(["--output", str(tmp_path), *options])
        return found

    return settings_of
