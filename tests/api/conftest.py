"""What tests of a device share."""

from __future__ import annotations

import pytest

from torchrender import devices


@pytest.fixture
def device(monkeypatch):
    """The emulated device is chosen; a call chooses another one by its name. On ``tree`` the CPU walks its tree."""

    def choose(name: str) -> None:
        monkeypatch.setattr(devices, "_chosen", name)

    choose("emulated")
    return choose
