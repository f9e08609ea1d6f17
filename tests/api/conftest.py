"""What tests of a device share."""

from __future__ import annotations

import os
from pathlib import Path

import host_card
import pytest

from torchrender import devices

FOLDER = os.environ.get(host_card.VARIABLE)
"""Of a card that is the host, which then has the place of the emulated device."""
if FOLDER:
    host_card.build(Path(FOLDER))
    EMULATED = host_card.use(Path(FOLDER))
else:
    EMULATED = "emulated"


@pytest.fixture
def device(monkeypatch):
    """The emulated device is chosen; a call chooses another one by its name. On ``tree`` the CPU walks its tree."""

    def choose(name: str) -> None:
        monkeypatch.setattr(devices, "_chosen", EMULATED if name == "emulated" else name)

    choose("emulated")
    return choose
