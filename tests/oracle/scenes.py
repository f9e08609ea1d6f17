"""Scenes of 8 x 8 pixels that together contain every model: the reference scenes, and some whose geometry matters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import reference_scenes as r

from .layered_scenes import layers, normals
from .material_scenes import brushed, fibres, glass, glossy, rough, turned_brushed
from .scene_parts import MIRROR, SIZE, distances, hills, metal, small, smoothed, tube


def moving() -> dict:
    """Smooth, flat and recomputed normals; textures over texture coordinates and attributes; all lights but the sky."""
    return r._scene(
        {"type": "path", "max_depth": 4, "rr_depth": 2},
        r._camera(fov=50),
        left=tube(
            to_world=r.translate(-1.2, 0, 0) @ r.rotate("y", 20),
            bsdf=r._diffuse(r._bitmap(31, 4, 5, to_uv=r.TO_UV, wrap_mode="mirror")),
        ),
        middle=smoothed(
            tube(
                to_world=r.translate(0.1, 0, -0.6) @ r.scale(0.8),
                bsdf=r._diffuse({"type": "mesh_attribute", "name": "vertex_color", "scale": 0.7}),
            )
        ),
        right=tube(
            face_normals=True,
            flip_normals=True,
            to_world=r.translate(1.2, 0, 0.3) @ r.rotate("x", 30),
            bsdf={"type": "twosided", "bsdf": r._diffuse({"type": "mesh_attribute", "name": "face_color"})},
        ),
        hills=hills(
            39,
            interpolation="bilinear",
            flip_normals=True,
            to_world=r.translate(0.2, -0.9, 1.0) @ MIRROR @ r.rotate("x", 110) @ r.scale(0.6, 0.4, 0.5),
            bsdf=r._diffuse(r._bitmap(40, 3, 4)),
        ),
        floor=r._floor(r._bitmap(32, 6, 4)),
        lamp=r._lamp(r._bitmap(33, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [1.0, 2.0, 2.0], "intensity": r._rgb(5.0, 4.0, 3.0)},
    )


def curves() -> dict:
    """Bent tubes and jointed cones, with coats that follow their coordinates, tangents and places."""
    points = np.random.default_rng(51).uniform(-1, 1, (8, 3)) * [1.6, 0.7, 0.7]
    points = points[np.argsort(points[:, 0])]
    brushed = {**metal(52), "alpha_u": 0.3, "alpha_v": 0.5}
    del brushed["alpha"]
    return r._scene(
        {"type": "path", "max_depth": 4, "rr_depth": 3},
        r._camera(fov=50),
        tubes={
            "type": "bsplinecurve",
            "control_points": points + np.array([0, 0.6, 0]),
            "radii": [0.3, 0.4, 0.2, 0.5, 0.3, 0.4, 0.3, 0.4],
            "segment_indices": [0, 4],
            "bsdf": {"type": "twosided", "bsdf": r._diffuse(r._bitmap(53, 4, 5, to_uv=r.TO_UV))},
        },
        wires={
            "type": "linearcurve",
            "control_points": points[::-1] * [1, 1, -1] - np.array([0, 0.4, 0.2]),
            "radii": [0.2, 0.3, 0.2, 0.25, 0.15, 0.3, 0.2, 0.2],
            "bsdf": {"type": "twosided", "bsdf": brushed},
        },
        bumps={
            "type": "bsplinecurve",
            "control_points": points[:4] * [2.0, 1, 1] + np.array([0.5, 0, -1.5]),
            "radii": 0.4,
            "bsdf": {"type": "bumpmap", "texture": r._bitmap(54, 4, 4), "scale": 0.1, "bsdf": r._diffuse(0.6)},
        },
        floor=r._floor(r._bitmap(55, 6, 4)),
        lamp=r._lamp(r._bitmap(56, 3, 4, 1.0, 9.0)),
        sky={"type": "constant", "radiance": 0.3},
    )


def grids() -> dict:
    """Distances on grids: smooth and analytic normals, mirrored and turned, of metal, glass and colours in space."""
    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(fov=50),
        left=distances(
            81,
            to_world=r.translate(-1.4, -0.6, -0.5) @ MIRROR @ r.rotate("x", 20) @ r.scale(1.2),
            bsdf=r._diffuse(
                {"type": "volume", "volume": {"type": "gridvolume", "data": r._noise(82, 3, 4, 0.2, 0.9)[None]}}
            ),
        ),
        middle=distances(
            83,
            normals="analytic",
            flip_normals=True,
            to_world=r.translate(-0.5, -0.7, -0.2) @ r.rotate("y", 30) @ r.scale(1.1, 1.4, 0.9),
            bsdf={"type": "twosided", "bsdf": r._diffuse(r._rgb(0.7, 0.4, 0.3))},
        ),
        right=distances(
            84,
            to_world=r.translate(0.6, -0.8, 0.0) @ r.rotate("z", 10) @ r.scale(1.1),
            bsdf={"type": "dielectric", "int_ior": 1.3},
        ),
        behind=distances(
            85,
            to_world=r.translate(0.0, 0.2, -1.2) @ r.scale(1.3),
            bsdf={"type": "conductor"},
        ),
        floor=r._floor(r._bitmap(32, 6, 4)),
        lamp=r._lamp(r._bitmap(33, 3, 4, 1.0, 9.0)),
        sky={"type": "envmap", "data": r._noise(86, 5, 7, 0.1, 2.0), "to_world": r.rotate("x", 50)},
    )


def lights() -> dict:
    """Emitting disk, mesh, mirrored rectangle, sphere from outside and from inside; the camera does not see them."""

    def light(seed: int) -> dict:
        return {"type": "area", "radiance": r._bitmap(seed, 3, 4, 0.5, 4.0)}

    return r._scene(
        {"type": "path", "max_depth": 3, "hide_emitters": True},
        r._camera(far_clip=30.0),
        ball={"type": "sphere", "radius": 0.8, "bsdf": r._diffuse(r._bitmap(41, 4, 6))},
        floor=r._floor({"type": "checkerboard", "color0": r._bitmap(42, 3, 3), "color1": 0.2, "to_uv": r.TO_UV}),
        dome={"type": "sphere", "radius": 9.0, "flip_normals": True, "emitter": light(43)},
        plate={
            "type": "disk",
            "to_world": r.translate(-1.2, 1.5, 0.5) @ r.rotate("x", 80) @ r.scale(0.4, 0.6, 1),
            "emitter": light(44),
        },
        glow={
            "type": "sphere",
            "center": [1.5, 0.6, 0.5],
            "radius": 0.3,
            "emitter": {**light(45), "sampling_weight": 3},
        },
        sheet={
            "type": "rectangle",
            "to_world": r.translate(1.0, 2.0, 0) @ MIRROR @ r.rotate("x", 100) @ r.scale(0.4),
            "emitter": light(46),
        },
        tube=tube(
            to_world=r.translate(-1.3, -0.4, 1.0) @ r.scale(0.3),
            emitter={"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color", "scale": 5.0}},
        ),
    )


def splits() -> dict:
    """Direct illumination with several samples of each kind, a tent filter, light from a map seen directly."""
    return r._scene(
        {"type": "direct", "emitter_samples": 1, "bsdf_samples": 3},
        r._camera(film={"rfilter": {"type": "tent", "radius": 1.3}, "sample_border": True}),
        left=tube(to_world=r.translate(-0.8, 0, 0), bsdf=r._diffuse(0.6)),
        glow={"type": "sphere", "center": [0.8, 0.2, 0.0], "radius": 0.6, "emitter": {"type": "area", "radiance": 2.0}},
        floor=r._floor(r._bitmap(51, 4, 4, filter_type="nearest", wrap_mode="clamp")),
        sky={"type": "envmap", "data": r._noise(52, 5, 7, 0.1, 2.0), "to_world": r.rotate("x", 50)},
    )


def _seen_by(sensor: dict, height: int = SIZE, width: int = SIZE) -> dict:
    """A textured ball and floor under a map and an area light, seen by this sensor."""
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "tent", "radius": 0.9}}
    return r._scene(
        {"type": "path", "max_depth": 3, "rr_depth": 9},
        {"to_world": r.look_at((0.2, 1.0, 4.0), (0.0, 0.0, 0.0)), "film": film, **sensor},
        ball={
            "type": "sphere",
            "center": [0.2, 0.1, 0.0],
            "radius": 0.9,
            "bsdf": r._diffuse(r._bitmap(61, 5, 7)),
        },
        floor=r._floor(r._bitmap(62, 6, 6)),
        lamp=r._lamp(r._rgb(6.0, 5.0, 4.0)),
        sky={"type": "envmap", "data": r._noise(63, 5, 7, 0.1, 2.0), "to_world": r.rotate("x", 50)},
    )


OFF_CENTRE = {"principal_point_offset_x": 0.04, "principal_point_offset_y": -0.07, "pixel_aspect": 1.2}
SENSORS: dict[str, Callable[[], dict]] = {
    "distorted": lambda: _seen_by(
        {
            "type": "perspective",
            "fov": 45,
            "distortion": [-0.2, 0.08, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01],
            **OFF_CENTRE,
        },
        6,
    ),
    "thinlens": lambda: _seen_by(
        {"type": "thinlens", "fov": 40, "aperture_radius": 0.2, "focus_distance": 3.2, **OFF_CENTRE}, 6
    ),
    "orthographic": lambda: _seen_by(
        {
            "type": "orthographic",
            "to_world": r.look_at((0.2, 1.0, 4.0), (0.0, 0.0, 0.0)) @ r.scale(1.4, 1.2, 1.5),
        },
        6,
    ),
    "fisheye": lambda: _seen_by(
        {"type": "fisheye", "fov": 130, "distortion": [0.05, -0.02, 0.01, -0.003], **OFF_CENTRE}, 6
    ),
    "panorama": lambda: _seen_by({"type": "panorama"}, 6),
    "radiancemeter": lambda: _seen_by({"type": "radiancemeter"}, 1, 1),
    # of a few rays some are to meet something
    "distant": lambda: _seen_by({"type": "distant", "sampler": {"type": "independent", "sample_count": 4}}, 1, 1),
    "distant_point": lambda: _seen_by({"type": "distant", "target": [0.1, 0.3, 0.2]}, 1, 1),
}
SCENES: dict[str, Callable[[], dict]] = {
    **{name: lambda name=name: small(r.SCENES[name]().scene) for name in r.SCENES},
    **{
        f.__name__: lambda f=f: small(f())
        for f in (moving, glass, rough, glossy, layers, normals, lights, splits, grids)
    },
    **SENSORS,
    **{f.__name__: lambda f=f: small(f()) for f in (brushed, turned_brushed, curves, fibres)},
}
