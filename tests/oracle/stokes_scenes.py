"""Scenes of what polarises light: plates and panes; lamps whose own light is polarised, and plastics."""

from __future__ import annotations

import reference_scenes as r

from .scene_parts import metal, tube


def panes() -> dict:
    """Tilted plates one behind the other, panes of glass and films of air, some of which reflect all, before metals."""

    def plate(x: float, y: float, z: float, angle: float, bsdf: dict) -> dict:
        place = r.translate(x, y, z) @ r.rotate("y", angle) @ r.rotate("x", 10) @ r.scale(0.5)
        return {"type": "rectangle", "to_world": place, "bsdf": bsdf}

    gold, aluminium = ({"type": "conductor", "eta": eta, "k": k} for eta, k in ((0.18, 3.4), (1.4, 7.6)))
    glass = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    air = {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.5}
    return r._scene(
        {"type": "path", "max_depth": 9, "rr_depth": 100},
        r._camera(fov=45),
        ball={"type": "sphere", "center": [0.1, 0.2, -0.3], "radius": 0.8, "bsdf": gold},
        tube=tube(to_world=r.translate(1.3, -0.4, 0.4) @ r.scale(0.5), bsdf={"type": "twosided", "bsdf": aluminium}),
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": {**aluminium, "type": "roughconductor", "alpha": 0.3}},
        filter=plate(-0.6, 0.5, 1.6, 25, {"type": "polarizer", "theta": 20.0}),
        wave=plate(-0.4, 0.4, 1.9, -40, {"type": "retarder", "theta": 35.0, "delta": 70.0}),
        second=plate(-0.5, 0.5, 2.2, 190, {"type": "retarder", "theta": -10.0, "delta": 120.0}),
        circle=plate(-0.1, 0.3, 2.5, 10, {"type": "circular", "left_handed": True}),
        pane=plate(0.5, 0.4, 1.9, 50, glass),
        before=plate(0.4, 0.3, 2.3, 35, glass),
        film=plate(0.3, 0.2, 1.4, -30, air),
        mirror=plate(0.9, 0.7, 1.2, 60, air),
        sky={"type": "envmap", "data": r._noise(38, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40)},
    )


def lamps() -> dict:
    """All lights that may be polarised, shapes of all kinds among them, seen directly, in mirrors, and by rough metals
    and plastics that they light."""
    aluminium = {"type": "conductor", "eta": 1.4, "k": 7.6}

    def light(radiance: float, *stokes: float) -> dict:
        return {"type": "area", "radiance": r._rgb(radiance, 0.8 * radiance, 0.6 * radiance), "stokes": stokes}

    return r._scene(
        {"type": "path", "max_depth": 4, "rr_depth": 3},
        r._camera(fov=50),
        ball={"type": "sphere", "center": [-0.8, -0.1, 0.2], "radius": 0.7, "bsdf": metal(71)},
        mirror={"type": "sphere", "center": [0.5, 0.2, -1.2], "radius": 0.8, "bsdf": aluminium},
        toy={
            "type": "sphere",
            "center": [0.6, -0.4, 0.8],
            "radius": 0.5,
            "bsdf": {
                "type": "pplastic",
                "alpha": r._bitmap(74, 3, 3, 0.1, 0.5),
                "diffuse_reflectance": r._bitmap(72, 4, 4),
                "specular_reflectance": 0.8,
            },
        },
        floor={
            "type": "rectangle",
            "to_world": r.FLOOR,
            "bsdf": {
                "type": "roughplastic",
                "alpha": 0.3,
                "distribution": "ggx",
                "diffuse_reflectance": r._bitmap(75, 4, 4),
                "specular_reflectance": r._rgb(0.9, 0.6, 0.8),
                "nonlinear": True,
            },
        },
        sheet={
            "type": "rectangle",
            "to_world": r.translate(-1.2, 1.6, 0.4) @ r.rotate("x", 80) @ r.scale(0.4, 0.6, 1),
            "emitter": light(5.0, 0.5, 0.3, -0.4),
        },
        plate={
            "type": "disk",
            "to_world": r.translate(1.5, 1.2, 0.2) @ r.rotate("y", -60) @ r.rotate("x", 20) @ r.scale(0.4),
            "emitter": light(6.0, -0.8, 0.2, 0.1),
        },
        glow={"type": "sphere", "center": [1.4, 0.1, 0.6], "radius": 0.3, "emitter": light(4.0, 0.1, -0.9, 0.2)},
        tube=tube(
            to_world=r.translate(-0.2, 0.9, 0.8) @ r.scale(0.3),
            emitter={
                "type": "area",
                "radiance": {"type": "mesh_attribute", "name": "vertex_color", "scale": 5.0},
                "stokes": [0.0, 0.6, 0.6],
            },
        ),
        bulb={
            "type": "point",
            "position": [-2.0, 2.0, 1.0],
            "intensity": r._rgb(4.0, 5.0, 3.0),
            "stokes": [0.9, 0.0, 0.1],
        },
        torch={
            "type": "spot",
            "to_world": r.look_at((2.0, 2.0, 3.0), (0.0, 0.0, 0.0)),
            "intensity": 20.0,
            "cutoff_angle": 30.0,
            "stokes": [0.2, -0.7, 0.0],
        },
        sun={
            "type": "directional",
            "to_world": r.look_at((-1.0, 3.0, 2.0), (0.0, 0.0, 0.0)),
            "irradiance": 1.5,
            "stokes": [-0.5, 0.5, 0.5],
        },
        slides={
            "type": "projector",
            "to_world": r.look_at((0.5, 3.0, 3.0), (0.0, 0.0, 0.0)),
            "fov": 50.0,
            "irradiance": r._bitmap(73, 4, 4),
            "scale": 9.0,
            "stokes": [0.3, 0.3, -0.8],
        },
        sky={"type": "constant", "radiance": 0.2},
    )
