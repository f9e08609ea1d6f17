"""Scenes with BSDFs around BSDFs, for references, motion and derivatives; numbers and arrays alone, no torch."""

from __future__ import annotations

import numpy as np
import reference_scenes as rs


def normals(height: int = 12, width: int = 16, strength: float = 0.5) -> np.ndarray:
    """A smooth map (H, W, 3) of unit normals, as colours, that repeats."""
    v, u = np.meshgrid(
        2 * np.pi * (np.arange(height) + 0.5) / height, 2 * np.pi * (np.arange(width) + 0.5) / width, indexing="ij"
    )
    x = strength * np.sin(2 * u + 0.3) * np.sin(v / 2) ** 2
    y = strength * np.cos(v - 0.4) * np.sin(v / 2) ** 2
    n = np.stack([x, y, np.ones_like(x)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return ((n + 1) / 2).astype(np.float32)


def normal_map(bsdf: dict, **more) -> dict:
    texture = {"type": "bitmap", "data": normals(), "raw": True}
    return {"type": "normalmap", "normalmap": texture, "bsdf": bsdf, **more}


def bump_map(bsdf: dict, strength: float = 0.05, **more) -> dict:
    """Heights (H, W, 1) from -strength to strength, many texels a wave."""
    v, u = np.meshgrid(2 * np.pi * (np.arange(48) + 0.5) / 48, 2 * np.pi * (np.arange(64) + 0.5) / 64, indexing="ij")
    heights = strength * np.sin(2 * u + 0.3) * np.sin(v / 2) ** 2
    texture = {"type": "bitmap", "data": heights[..., None].astype(np.float32), "raw": True}
    return {"type": "bumpmap", "heights": texture, "bsdf": bsdf, **more}


def weights(height: int = 8, width: int = 8) -> np.ndarray:
    """Smooth weights (H, W, 1) in [0.1, 0.9]."""
    v, u = np.meshgrid(np.arange(height) / height, np.arange(width) / width, indexing="ij")
    return (0.5 + 0.4 * np.sin(2 * np.pi * u) * np.sin(np.pi * (v + 0.5 / height)) ** 2)[..., None].astype(np.float32)


def blend(first: dict, second: dict, weight=None) -> dict:
    weight = {"type": "bitmap", "data": weights(), "raw": True} if weight is None else weight
    return {"type": "blendbsdf", "weight": weight, "bsdf_0": first, "bsdf_1": second}


def mask(bsdf: dict, opacity=None) -> dict:
    opacity = {"type": "bitmap", "data": weights(), "raw": True} if opacity is None else opacity
    return {"type": "mask", "opacity": opacity, "bsdf": bsdf}


def _layers() -> rs.ReferenceScene:
    """A ball with a normal map, a floor that is a blend, a sheet with holes between them and the lamp.

    Not by the sheet's opacity: there Mitsuba 3.9.1 (`prb`) finds 0.0110 in all, where differences of images (also of
    ours) are -0.0078; what comes through the holes is missing.
    """
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.4, "material": "Cu"}
    paint = {"type": "diffuse", "reflectance": rs._rgb(0.7, 0.4, 0.2)}
    return rs.ReferenceScene(
        rs._scene(
            {"type": "path", "max_depth": 5, "rr_depth": 99},
            rs._camera(),
            ball={"type": "sphere", "center": [-0.8, -0.2, 0.1], "radius": 0.8, "bsdf": normal_map(metal)},
            cube={
                "type": "rectangle",
                "to_world": rs.translate(1.0, -0.4, 0.3) @ rs.rotate("y", -30) @ rs.scale(0.6),
                "bsdf": {"type": "twosided", "bsdf": normal_map(paint, use_shadowing_function=False)},
            },
            floor={
                "type": "rectangle",
                "to_world": rs.translate(0.0, -1.0, 0.0) @ rs.rotate("x", -90) @ rs.scale(3.0),
                "bsdf": {"type": "twosided", "bsdf": blend(paint, metal)},
            },
            sheet={
                "type": "rectangle",
                "to_world": rs.translate(-0.4, 1.0, 0.2) @ rs.rotate("x", -70) @ rs.scale(0.5),
                "bsdf": mask({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rs._rgb(0.2, 0.3, 0.8)}}),
            },
            lamp=rs._lamp(rs._rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": rs._rgb(0.3, 0.4, 0.5)},
        ),
        (
            "ball.bsdf.normalmap.data",
            "ball.bsdf.nested_bsdf.alpha.value",
            "cube.bsdf.brdf_0.normalmap.data",
            "floor.bsdf.brdf_0.weight.data",
            "floor.bsdf.brdf_0.bsdf_0.reflectance.value",
        ),
    )


def _bumps() -> rs.ReferenceScene:
    """A ball and a sheet with bumps."""
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.4, "material": "Cu"}
    paint = {"type": "diffuse", "reflectance": rs._rgb(0.7, 0.4, 0.2)}
    plain = bump_map(paint, 0.1, flip_invalid_normals=False, use_shadowing_function=False)
    return rs.ReferenceScene(
        rs._scene(
            {"type": "path", "max_depth": 3, "rr_depth": 99},
            rs._camera(),
            ball={"type": "sphere", "center": [-0.8, -0.2, 0.1], "radius": 0.8, "bsdf": bump_map(metal)},
            sheet={
                "type": "rectangle",
                "to_world": rs.translate(1.0, -0.4, 0.3) @ rs.rotate("y", 30) @ rs.scale(0.6),
                "bsdf": {"type": "twosided", "bsdf": plain},
            },
            behind={
                "type": "rectangle",
                "to_world": rs.translate(0.5, 0.8, -0.3) @ rs.rotate("y", 170) @ rs.scale(0.5),
                "bsdf": {"type": "twosided", "bsdf": plain},
            },
            floor=rs._floor(rs._rgb(0.6, 0.5, 0.4)),
            lamp=rs._lamp(rs._rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": rs._rgb(0.3, 0.4, 0.5)},
        ),
        ("ball.bsdf.nested_bsdf.alpha.value",),
    )


SCENES = {"layers": _layers, "bumps": _bumps}
