"""Scenes as modules: objects generated from the native declaration, parameters by name."""

from . import camera, emitters, materials, mesh, shapes, textures  # noqa: F401  (they register their classes)
from .scene import Scene

__all__ = ["Scene"]
