"""Scenes of 8 x 8 pixels that together contain every model: the reference scenes, and some whose geometry matters."""

from __future__ import annotations

import copy
from collections.abc import Callable

import layer_scenes
import numpy as np
import reference_scenes as r

import torchrender as tr

SIZE = 8
MIRROR = r.scale(-1, 1, 1)


def small(scene: dict) -> dict:
    """A reference scene with a film of 8 x 8 pixels."""
    scene = copy.deepcopy(scene)
    film = scene["sensor"]["film"]
    if "crop_width" in film:
        film.update(width=12, height=10, crop_offset_x=2, crop_offset_y=1, crop_width=SIZE, crop_height=SIZE)
    else:
        film.update(width=SIZE, height=SIZE)
    return scene


def _tube(rows: int = 4, columns: int = 6, **more) -> tr.Mesh:
    vertices, normals, colours, faces, face_colours = r.twisted_mesh(rows, columns)
    attributes = {"vertex_color": colours, "face_color": face_colours}
    texcoords = np.stack([vertices[:, 0] * 0.4 + vertices[:, 2], vertices[:, 1]], 1)
    return tr.Mesh(vertices, faces, vertex_normals=normals, vertex_texcoords=texcoords, attributes=attributes, **more)


def _hills(seed: int, **more) -> dict:
    heights = np.random.default_rng(seed).uniform(0, 0.3, (5, 4))
    return {"type": "heightfield", "heights": heights, **more}


def _smoothed(mesh: tr.Mesh) -> tr.Mesh:
    """The mesh with normals that follow its positions, as one from a file without normals has."""
    mesh.compute_normals()
    return mesh


def moving() -> dict:
    """Smooth, flat and recomputed normals; textures over texture coordinates and attributes; all lights but the sky."""
    return r._scene(
        {"type": "path", "max_depth": 4, "rr_depth": 2},
        r._camera(fov=50),
        left=_tube(
            to_world=r.translate(-1.2, 0, 0) @ r.rotate("y", 20),
            bsdf=r._diffuse(r._bitmap(31, 4, 5, to_uv=r.TO_UV, wrap_mode="mirror")),
        ),
        middle=_smoothed(
            _tube(
                to_world=r.translate(0.1, 0, -0.6) @ r.scale(0.8),
                bsdf=r._diffuse({"type": "mesh_attribute", "name": "vertex_color", "scale": 0.7}),
            )
        ),
        right=_tube(
            face_normals=True,
            flip_normals=True,
            to_world=r.translate(1.2, 0, 0.3) @ r.rotate("x", 30),
            bsdf={"type": "twosided", "bsdf": r._diffuse({"type": "mesh_attribute", "name": "face_color"})},
        ),
        hills=_hills(
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


def glass() -> dict:
    """Chains of refraction and reflection between a textured floor and a turned sky."""
    return r._scene(
        {"type": "path", "max_depth": 7, "rr_depth": 3},
        r._camera(),
        ball={"type": "sphere", "center": [-0.9, -0.1, 0.2], "radius": 0.7, "bsdf": {"type": "dielectric"}},
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "dielectric", "int_ior": 1.3, "specular_transmittance": r._bitmap(34, 3, 3)},
        ),
        lens=_hills(
            47,
            to_world=r.translate(-0.4, 0.9, 0.3) @ r.rotate("x", 20) @ r.scale(0.6, 0.5, 0.4),
            bsdf={"type": "dielectric", "int_ior": 1.2},
        ),
        metal={
            "type": "sphere",
            "center": [0.5, 0.2, -1.2],
            "radius": 0.8,
            "bsdf": {"type": "conductor", "material": "Cu", "specular_reflectance": r._bitmap(35, 4, 4)},
        },
        mirror={
            "type": "disk",
            "to_world": r.translate(-1.6, 0.2, -1.0) @ r.rotate("y", 40),
            "bsdf": {"type": "twosided", "bsdf": {"type": "conductor", "eta": 0.2, "k": 3.0}},
        },
        curtain={"type": "rectangle", "to_world": r.translate(0, 0, 2) @ r.scale(0.7), "bsdf": {"type": "null"}},
        floor=r._floor(r._bitmap(36, 5, 5)),
        lamp=r._lamp(r._bitmap(37, 3, 4, 1.0, 9.0)),
        sky={"type": "envmap", "data": r._noise(38, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def rough() -> dict:
    """Light that goes through and off rough glass, from outside and from inside; a mesh with smooth normals."""

    def interface(distribution: str, **more) -> dict:
        return {"type": "roughdielectric", "distribution": distribution, **more}

    return r._scene(
        {"type": "path", "max_depth": 6, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "center": [-0.9, -0.1, 0.2],
            "radius": 0.7,
            "bsdf": interface("ggx", alpha=0.3, specular_reflectance=r._rgb(0.9, 0.8, 0.7)),
        },
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf=interface(
                "beckmann", alpha=r._bitmap(65, 3, 3, 0.1, 0.3), int_ior=1.3, specular_transmittance=r._bitmap(61, 3, 3)
            ),
        ),
        bubble={
            "type": "sphere",
            "center": [0.4, 0.2, -1.0],
            "radius": 0.6,
            "bsdf": interface("beckmann", alpha=0.6, eta=0.7),
        },
        floor=r._floor(r._bitmap(62, 5, 5)),
        lamp=r._lamp(r._bitmap(63, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(64, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def glossy() -> dict:
    """Rough metal, plastic, thin glass and principled surfaces: of both sides of a mesh, in chains of mirrors."""
    shiny = {"type": "roughconductor", "material": "Cu", "specular_reflectance": r._bitmap(81, 3, 3)}
    return r._scene(
        {"type": "path", "max_depth": 6, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "center": [-0.9, -0.1, 0.2],
            "radius": 0.7,
            "bsdf": {**shiny, "distribution": "ggx", "alpha": r._bitmap(82, 4, 4, 0.1, 0.5)},
        },
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "twosided", "a": {**shiny, "alpha": 0.3}, "b": {"type": "plastic", "nonlinear": True}},
        ),
        toy={
            "type": "sphere",
            "center": [0.4, 0.2, -1.0],
            "radius": 0.6,
            "bsdf": {"type": "plastic", "diffuse_reflectance": r._bitmap(83, 4, 4), "specular_reflectance": 0.7},
        },
        mug={
            "type": "sphere",
            "center": [-0.1, -0.6, 1.0],
            "radius": 0.35,
            "bsdf": {
                "type": "roughplastic",
                "distribution": "ggx",
                "alpha": 0.3,
                "diffuse_reflectance": r._bitmap(89, 4, 4),
                "specular_reflectance": r._rgb(0.9, 0.6, 0.8),
                "nonlinear": True,
            },
        },
        pane={
            "type": "rectangle",
            "to_world": r.translate(-0.5, 0.3, 1.5) @ r.scale(0.5),
            "bsdf": {"type": "thindielectric", "eta": 1.6, "specular_transmittance": r._bitmap(84, 3, 3)},
        },
        clear={
            "type": "sphere",
            "center": [1.6, -0.3, 0.4],
            "radius": 0.5,
            "bsdf": {"type": "principled", "spec_trans": 0.7, "eta": 1.4, **r.PRINCIPLED, "roughness": 0.6},
        },
        die={
            "type": "cube",
            "to_world": r.translate(1.2, -0.8, 1.4) @ r.rotate("y", 20) @ r.scale(0.2),
            "bsdf": {
                "type": "redner",
                "diffuse_reflectance": r._bitmap(91, 3, 3),
                "specular_reflectance": r._rgb(0.5, 0.3, 0.2),
                "roughness": 0.2,
            },
        },
        leaf={
            "type": "rectangle",
            "to_world": r.translate(0.9, 0.7, 0.2) @ r.rotate("y", 50) @ r.scale(0.4),
            "bsdf": {
                "type": "principledthin",
                "base_color": r._bitmap(90, 4, 4),
                "spec_trans": 0.5,
                "diff_trans": 0.9,
                "spec_tint": 0.3,
                "sheen": 0.6,
                "sheen_tint": 0.2,
                "flatness": 0.4,
            },
        },
        floor={
            "type": "rectangle",
            "to_world": r.FLOOR,
            "bsdf": {
                "type": "principled",
                "base_color": r._bitmap(85, 5, 5),
                "specular": 0.8,
                **r.PRINCIPLED,
                "metallic": r._bitmap(86, 3, 3),
            },
        },
        lamp=r._lamp(r._bitmap(87, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(88, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def _metal(seed: int, alpha: float = 0.4) -> dict:
    reflectance = r._bitmap(seed, 3, 3)
    return {"type": "roughconductor", "alpha": alpha, "distribution": "ggx", "specular_reflectance": reflectance}


def layers() -> dict:
    """Blends of blends, of both sides, of smooth models and mirrors; holes in them and around them; textured weights
    over texture coordinates and attributes, 0 and 1 among them."""
    blend, mask = layer_scenes.blend, layer_scenes.mask
    glass, mirror = {"type": "dielectric", "int_ior": 1.3}, {"type": "conductor", "eta": 0.2, "k": 3.0}
    return r._scene(
        {"type": "path", "max_depth": 6, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "center": [-0.9, -0.1, 0.2],
            "radius": 0.7,
            "bsdf": blend(_metal(101), blend(glass, r._diffuse(r._bitmap(102, 3, 3)), 0.6), r._bitmap(103, 3, 4)),
        },
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf=mask(
                {"type": "twosided", "a": r._diffuse(r._bitmap(104, 3, 3)), "b": _metal(105)},
                {"type": "mesh_attribute", "name": "vertex_color", "scale": 0.9},
            ),
        ),
        sheet={
            "type": "rectangle",
            "to_world": r.translate(-0.4, 0.6, 1.2) @ r.rotate("y", 30) @ r.scale(0.5),
            "bsdf": {"type": "twosided", "a": blend(mirror, _metal(106), 0.3), "b": r._diffuse(0.7)},
        },
        curtain={
            "type": "disk",
            "to_world": r.translate(0.5, 0.4, 1.5) @ r.rotate("y", -20) @ r.scale(0.5),
            "bsdf": blend(mask(r._diffuse(r._bitmap(107, 3, 3)), r._bitmap(108, 3, 3)), {"type": "null"}, 0.25),
        },
        lens={
            "type": "sphere",
            "center": [0.3, 0.3, -1.0],
            "radius": 0.5,
            "bsdf": blend({"type": "roughdielectric", "alpha": 0.3}, {"type": "plastic"}, 0.5),
        },
        lamp_shade=_hills(
            109,
            to_world=r.translate(0.3, 1.4, 0.3) @ r.rotate("x", 100) @ r.scale(0.6, 0.5, 0.4),
            bsdf=mask({"type": "twosided", "bsdf": r._diffuse(0.6)}, r._bitmap(110, 4, 4, to_uv=r.TO_UV)),
        ),
        there={
            "type": "rectangle",
            "to_world": r.translate(1.6, -0.2, 0.4) @ r.rotate("y", -60) @ r.scale(0.4),
            "bsdf": mask(blend(r._diffuse(0.3), {"type": "twosided", "bsdf": mirror}, 1.0), 1.0),
        },
        floor={
            "type": "rectangle",
            "to_world": r.FLOOR,
            "bsdf": {"type": "twosided", "bsdf": blend(r._diffuse(r._bitmap(111, 5, 5)), _metal(112, 0.5))},
        },
        lamp=r._lamp(r._bitmap(113, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(114, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def bumps(seed: int, lowest: float = 0.6, **more) -> dict:
    """A map of rough normals of any length, some of which hide from the viewer."""
    texels = np.random.default_rng(seed).uniform([0, 0, lowest], 1, (4, 5, 3))
    return {"type": "bitmap", "data": texels.astype(np.float32), "raw": True, **more}


def normals() -> dict:
    """Normal maps on all shapes, from both sides, around and inside of mixtures, of rough and of clear models."""

    def turned(bsdf: dict, seed: int, **more) -> dict:
        return {"type": "normalmap", "normalmap": bumps(seed), "bsdf": bsdf, **more}

    paint, glass = r._diffuse(r._bitmap(121, 3, 3)), {"type": "dielectric", "int_ior": 1.3}
    bare = _tube(to_world=r.translate(1.4, 0.3, -0.4) @ r.scale(0.6), bsdf=turned(paint, 122))
    bare.vertex_texcoords = None
    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "to_world": r.translate(-0.9, -0.1, 0.2) @ r.rotate("x", 70) @ r.scale(0.7),
            "bsdf": layer_scenes.normal_map(_metal(123)),
        },
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "twosided", "a": turned(paint, 124), "b": turned(_metal(125), 126)},
        ),
        bare=bare,
        lens={
            "type": "sphere",
            "center": [0.3, 0.3, -1.0],
            "radius": 0.5,
            "bsdf": turned({**glass, "specular_reflectance": 0.9}, 127, use_shadowing_function=False),
        },
        frosted={
            "type": "disk",
            "to_world": r.translate(-0.3, 0.5, 1.4) @ r.rotate("y", 30) @ r.scale(0.5),
            "bsdf": turned({"type": "roughdielectric", "alpha": 0.4}, 128, flip_invalid_normals=False),
        },
        leaf={
            "type": "rectangle",
            "to_world": r.translate(0.6, 0.8, 0.8) @ MIRROR @ r.rotate("y", 40) @ r.scale(0.4),
            "flip_normals": True,
            "bsdf": layer_scenes.mask(
                layer_scenes.blend({"type": "twosided", "bsdf": turned(paint, 129)}, turned(glass, 130), 0.3),
                r._bitmap(131, 3, 3),
            ),
        },
        cobbles={
            "type": "sphere",
            "to_world": r.translate(-1.3, 0.9, 0.0) @ r.rotate("z", 50) @ r.scale(0.4),
            "bsdf": layer_scenes.bump_map(_metal(134), 0.1, scale=0.9),
        },
        dunes=_tube(
            to_world=r.translate(1.2, 1.0, 0.2) @ r.scale(0.5),
            bsdf={"type": "twosided", "bsdf": {"type": "bumpmap", "heights": bumps(135), "bsdf": paint}},
        ),
        veil={
            "type": "rectangle",
            "to_world": r.translate(-0.6, 1.0, 0.6) @ r.rotate("x", -50) @ r.scale(0.4),
            "bsdf": turned(layer_scenes.mask(layer_scenes.blend(paint, _metal(132)), 0.6), 133),
        },
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": turned(_metal(134, 0.5), 135)},
        lamp=r._lamp(r._bitmap(136, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(137, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def brushed() -> dict:
    """Facets that are rougher along one direction, on all shapes, from both sides; metal and glass."""

    def along(kind: str, u, v, **more) -> dict:
        return {"type": kind, "alpha_u": u, "alpha_v": v, **more}

    def metal(u, v, **more) -> dict:
        return along("roughconductor", u, v, eta=r._rgb(0.2, 0.9, 1.1), k=r._rgb(3.9, 2.4, 2.2), **more)

    bare = _tube(to_world=r.translate(1.4, 0.3, -0.4) @ r.scale(0.6), bsdf=metal(0.2, 0.5))
    bare.vertex_texcoords = None
    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "to_world": r.translate(-0.9, -0.1, 0.2) @ r.rotate("x", 70) @ r.scale(0.7),
            "bsdf": metal(r._bitmap(141, 3, 4), 0.3, distribution="ggx"),
        },
        tube=_tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "twosided", "bsdf": metal(0.4, r._bitmap(142, 4, 3, 0.1, 0.5))},
        ),
        bare=bare,
        lens={
            "type": "sphere",
            "center": [0.3, 0.3, -1.0],
            "radius": 0.5,
            "bsdf": along("roughdielectric", 0.2, r._bitmap(143, 3, 3, 0.2, 0.6), distribution="ggx", int_ior=1.3),
        },
        frosted={
            "type": "disk",
            "to_world": r.translate(-0.3, 0.5, 1.4) @ r.rotate("y", 30) @ r.scale(0.5, 0.4, 1.0),
            "bsdf": along("roughdielectric", 0.5, 0.2, specular_transmittance=r._rgb(0.9, 0.8, 0.7)),
        },
        leaf={
            "type": "rectangle",
            "to_world": r.translate(0.6, 0.8, 0.8) @ MIRROR @ r.rotate("y", 40) @ r.scale(0.4),
            "flip_normals": True,
            "bsdf": layer_scenes.blend({"type": "twosided", "bsdf": metal(0.3, 0.6)}, r._diffuse(0.4), 0.3),
        },
        pot={
            "type": "sphere",
            "to_world": r.translate(-0.2, -0.6, 1.1) @ r.rotate("x", 50) @ r.scale(0.35),
            "bsdf": {
                "type": "principled",
                "base_color": r._bitmap(146, 3, 3),
                "roughness": 0.6,
                "metallic": 0.4,
                "spec_trans": 0.3,
                "clearcoat": 0.5,
                "anisotropic": r._bitmap(147, 3, 3),
            },
        },
        petal={
            "type": "rectangle",
            "to_world": r.translate(1.2, -0.2, 1.0) @ r.rotate("y", -40) @ r.scale(0.4),
            "bsdf": {
                "type": "principledthin",
                "roughness": 0.7,
                "spec_trans": 0.6,
                "diff_trans": 0.8,
                "anisotropic": 0.7,
            },
        },
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": metal(0.5, 0.2, specular_reflectance=0.8)},
        lamp=r._lamp(r._bitmap(144, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(145, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def turned_brushed() -> dict:
    """The same below normal maps."""
    metal = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.6, "distribution": "ggx"}
    glass = {"type": "roughdielectric", "alpha_u": 0.6, "alpha_v": 0.3, "int_ior": 1.3}
    dented = {"type": "normalmap", "normalmap": bumps(151), "bsdf": metal}
    return r._scene(
        {"type": "path", "max_depth": 4, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "to_world": r.translate(-0.9, -0.1, 0.2) @ r.rotate("x", 70) @ r.scale(0.7),
            "bsdf": layer_scenes.normal_map(glass),
        },
        hills=_hills(
            154,
            to_world=r.translate(-0.3, 0.9, 0.3) @ r.rotate("x", 30) @ r.scale(0.6, 0.5, 0.4),
            bsdf=dented,
        ),
        tube=_tube(to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6), bsdf={"type": "twosided", "bsdf": dented}),
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": layer_scenes.normal_map(metal)},
        lamp=r._lamp(r._bitmap(152, 3, 4, 1.0, 9.0)),
        sky={"type": "envmap", "data": r._noise(153, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
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
        tube=_tube(
            to_world=r.translate(-1.3, -0.4, 1.0) @ r.scale(0.3),
            emitter={"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color", "scale": 5.0}},
        ),
    )


def splits() -> dict:
    """Direct illumination with several samples of each kind, a tent filter, light from a map seen directly."""
    return r._scene(
        {"type": "direct", "emitter_samples": 1, "bsdf_samples": 3},
        r._camera(film={"rfilter": {"type": "tent", "radius": 1.3}, "sample_border": True}),
        left=_tube(to_world=r.translate(-0.8, 0, 0), bsdf=r._diffuse(0.6)),
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
    "distant": lambda: _seen_by({"type": "distant"}, 1, 1),
    "distant_point": lambda: _seen_by({"type": "distant", "target": [0.1, 0.3, 0.2]}, 1, 1),
}
SCENES: dict[str, Callable[[], dict]] = {
    **{name: lambda name=name: small(r.SCENES[name]().scene) for name in r.SCENES},
    **{f.__name__: lambda f=f: small(f()) for f in (moving, glass, rough, glossy, layers, normals, lights, splits)},
    **SENSORS,
    **{f.__name__: lambda f=f: small(f()) for f in (brushed, turned_brushed)},
}
