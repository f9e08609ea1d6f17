"""A scene in which what is sought is small, so that most paths pass it by."""

from __future__ import annotations

THING = "thing.reflectance.value"


def small_things(wrapped: bool) -> dict:
    """A floor and a wall under the sky, and on the floor two small things of one BSDF, `wrapped` in others."""
    thing = {"type": "ref", "id": "thing"}
    bsdf = {"type": "mask", "opacity": 0.7, "bsdf": {"type": "twosided", "bsdf": thing}} if wrapped else thing
    ball = {"type": "sphere", "center": [-0.4, 0, 0.2], "radius": 0.2, "bsdf": bsdf}
    matrix = [[0.1, 0, 0, 0.5], [0, 0.1, 0, 0.3], [0, 0, 0.1, 0.1], [0, 0, 0, 1]]
    return {
        "type": "scene",
        "thing": {"type": "diffuse", "reflectance": 0.4},
        "sensor": {
            "type": "perspective",
            "to_world": [[1, 0, 0, 0], [0, 0.6, 0.8, -3.2], [0, 0.8, -0.6, 2.4], [0, 0, 0, 1]],
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
        "floor": {
            "type": "rectangle",
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.6}},
        },
        "wall": {
            "type": "rectangle",
            "to_world": [[1, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 1], [0, 0, 0, 1]],
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.6}},
        },
        "ball": ball,
        "cube": {"type": "cube", "to_world": matrix, "bsdf": bsdf},
        "sky": {"type": "constant", "radiance": 1.0},
    }
