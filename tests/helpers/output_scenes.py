"""Scenes whose first surfaces are seen by outputs besides radiance, and the names of these."""

from __future__ import annotations

import reference_scenes

import torchrender as tr
from torchrender.first_hit_call import FIRST_HIT_OUTPUTS, IDENTIFIERS, OUTPUTS, STOKES_OUTPUTS

# Polarised light has no variance: tests/polarization has its outputs.
ALL = tuple(n for n in OUTPUTS if n not in STOKES_OUTPUTS)
REAL = tuple(n for n in FIRST_HIT_OUTPUTS if n not in IDENTIFIERS)
INFINITE = ("depth", "distance", "position")


def scene_of(name: str, size: int = 12, rfilter: str = "box", **settings) -> tr.Scene:
    description = dict(reference_scenes.SCENES[name]().scene)
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}}
    description["sensor"] = {**description["sensor"], "film": film}
    return tr.load_dict(description, **settings)


def square(bsdf=None, size: int = 6, rfilter: str = "box", **more) -> tr.Scene:
    """The square [-1, 1]^2 in z = 0 seen from z = 5 with a field of view of 60 degrees: misses all around."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}}
    shape = {"type": "rectangle", "bsdf": bsdf or {"type": "diffuse"}}
    camera = {
        "type": "perspective",
        "fov": 60,
        "to_world": tr.Transform.look_at([0, 0, 5], [0, 0, 0]),
        "film": film,
    }
    settings = {k: more.pop(k) for k in ("dtype", "variant") if k in more}
    return tr.load_dict({"type": "scene", "camera": camera, "plate": shape, **more}, **settings)
