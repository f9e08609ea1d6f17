"""All classes of models that are written by hand; importing this registers them, in place of generated ones."""

from __future__ import annotations

import importlib

MODULES = """
    camera cameras curves emitters gradientindex heightfield layers materials media mesh phases
    point_sensors sdfgrid sensor shapes textures volumes
"""

for name in MODULES.split():
    importlib.import_module(f".{name}", __package__)
