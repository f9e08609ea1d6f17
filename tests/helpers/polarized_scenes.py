"""Scenes of polarised light for torchrender and Mitsuba 3.9.1, as plain dictionaries; needs NumPy alone.

A ball over a floor, under a lamp and a grey sky: metals and glasses; and plates before the camera. Retarders are seen
straight on, since Mitsuba turns the axis of tilted ones. `SCENES` are of one colour, `SPECTRAL` of wavelengths.
"""

from __future__ import annotations

import numpy as np

SIZE, BLOCK = 32, 8


def uniform(value: float) -> dict:
    return {"type": "uniform", "value": value}


GOLD = {"type": "conductor", "eta": uniform(0.183), "k": uniform(3.43)}
ALUMINIUM = {"type": "conductor", "eta": uniform(1.37), "k": uniform(7.62)}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
GREY = {"type": "diffuse", "reflectance": uniform(0.5)}


def look(origin, target, up) -> np.ndarray:
    origin, target, up = (np.array(v, float) for v in (origin, target, up))
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([left, np.cross(forward, left), forward], 1)
    matrix[:3, 3] = origin
    return matrix


FLOOR = np.array([[4.0, 0, 0, 0], [0, 4, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1]])
ORIGIN = (3, -3.5, 2)


def camera(up, fov: float) -> dict:
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "to_world": look(ORIGIN, (0, 0, 0), up), "film": film}


def room(ball: dict, floor: dict = GREY, depth: int = 5, up=(0, 0, 1), fov: float = 45.0, **more) -> dict:
    lamp = np.array([[1.5, 0, 0, 0], [0, -1.5, 0, -1], [0, 0, -1, 3], [0, 0, 0, 1]])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": 100},
        "sensor": camera(up, fov),
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": uniform(5.0)}},
        "sky": {"type": "constant", "radiance": uniform(0.3)},
        "floor": {"type": "rectangle", "to_world": FLOOR, "bsdf": floor},
        "ball": {"type": "sphere", "radius": 1.0, "bsdf": ball},
        **more,
    }


def plate(bsdf: dict, distance: float = 0.8, tilt: float = 0.0, back: bool = False) -> dict:
    """A square before the camera, turned about its vertical by `tilt` degrees."""
    angle, move = np.radians(tilt + 180 * back), np.eye(4)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    move[:3, :3], move[2, 3] = turn * 0.6, distance
    return {"type": "rectangle", "to_world": look(ORIGIN, (0, 0, 0), (0, 0, 1)) @ move, "bsdf": bsdf}


def rough(metal: dict, alpha: float) -> dict:
    return {**metal, "type": "roughconductor", "alpha": alpha}


SCENES = {
    "metal": lambda: room(GOLD, up=(0.5, 0.2, 1)),
    "metals": lambda: room(rough(GOLD, 0.2), ALUMINIUM),
    "rough_metal": lambda: room(rough(GOLD, 0.3)),
    "glass": lambda: room(GLASS, depth=6),
    "bubble": lambda: room({**GLASS, "int_ior": 1.0, "ext_ior": 1.5}, depth=6),
    "pplastic": lambda: room(
        {"type": "pplastic", "alpha": 0.2, "diffuse_reflectance": uniform(0.6), "int_ior": 1.5, "ext_ior": 1.0},
        up=(0.5, 0.2, 1),
    ),
    "polariser": lambda: room(GLASS, depth=7, plate=plate({"type": "polarizer", "theta": 20.0})),
    "tilted_polariser": lambda: room(
        GLASS, depth=7, plate=plate({"type": "polarizer", "theta": 20.0}, tilt=40, back=True)
    ),
    "circular": lambda: room(GOLD, ALUMINIUM, plate=plate({"type": "circular", "left_handed": True})),
    "retarder": lambda: room(
        GLASS,
        depth=8,
        fov=0.02,
        plate=plate({"type": "retarder", "theta": 40.0, "delta": 70.0}, back=True),
        filter=plate({"type": "polarizer", "theta": 15.0}, 1.2, back=True),
    ),
}


def coloured(ball: dict, floor: dict, **more) -> dict:
    """Under a warm lamp and a sky of daylight, with colours in everything that has one."""
    room_ = room(ball, floor, **more)
    warm = {"type": "irregular", "wavelengths": "360, 500, 600, 830", "values": "1, 4, 6, 7"}
    room_["lamp"]["emitter"]["radiance"] = warm
    room_["sky"]["radiance"] = {"type": "rgb", "value": [0.25, 0.3, 0.45]}
    return room_


PAINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.15]}}
COPPER = {"type": "conductor", "material": "Cu"}
SPECTRAL = {
    "spectral_metals": lambda: coloured({"type": "conductor", "material": "Au"}, rough(COPPER, 0.2)),
    "spectral_glass": lambda: coloured(GLASS, PAINT, depth=7, plate=plate({"type": "polarizer", "theta": 20.0})),
    "spectral_circular": lambda: coloured(
        rough({"type": "conductor", "material": "Au"}, 0.3), COPPER, plate=plate({"type": "circular"}, tilt=20)
    ),
}
