"""Scenes as modules: objects generated from the native declaration, parameters by name."""

from . import (  # noqa: F401  (they register their classes)
    camera,
    emitters,
    gradientindex,
    heightfield,
    materials,
    media,
    mesh,
    phases,
    sdfgrid,
    shapes,
    sunsky,
    textures,
    volumes,
)
from .scene import Scene

__all__ = ["Scene"]
