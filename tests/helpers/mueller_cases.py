"""BSDFs that polarise in Mitsuba as they do here, as plain dictionaries, and the directions at which their Mueller
matrices are compared; needs NumPy alone.

`bench/make_mueller_references.py` evaluates them with Mitsuba 3.9.1, test_mueller_references.py with torchrender.
"""

from __future__ import annotations

import numpy as np

N = 100  # pairs of directions


def uniform(value: float) -> dict:
    return {"type": "uniform", "value": value}


_GOLD = {"eta": uniform(0.183), "k": uniform(3.43)}
_SILICON = {"eta": uniform(3.88), "k": uniform(0.019)}
SMOOTH = {  # evaluated (of Beckmann's facets Mitsuba's masking is an approximation)
    "rough gold": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3, **_GOLD},
    "rough silicon": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.5, **_SILICON},
    "brushed gold": {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.2, "alpha_v": 0.5, **_GOLD},
    "diffuse": {"type": "diffuse", "reflectance": uniform(0.5)},
}
DELTA = {  # sampled
    "gold": {"type": "conductor", **_GOLD},
    "silicon": {"type": "conductor", **_SILICON},
    "glass": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "bubble": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5},
    "polariser": {"type": "polarizer", "theta": 20.0, "transmittance": uniform(0.8)},
    "right circular": {"type": "circular"},
    "left circular": {"type": "circular", "left_handed": True},
    "null": {"type": "null"},
}
PERPENDICULAR = {  # sampled along the normal, from both sides
    "retarder": {"type": "retarder", "theta": 35.0, "delta": 70.0, "transmittance": uniform(0.8)},
}


def directions(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of unit vectors (n, 3): of the first some are below the surface, if that makes a difference."""
    if name in PERPENDICULAR:
        wi = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        return wi, -wi
    random = np.random.default_rng(11)
    wi, wo = random.normal(size=(2, N, 3))
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    if name in SMOOTH:
        wi[:, 2], wo[:, 2] = abs(wi[:, 2]), abs(wo[:, 2])
    return wi, wo
