"""Scenes of BSDFs around BSDFs: blends, masks and normal maps."""

from __future__ import annotations

import layer_scenes
import reference_scenes as r

from .scene_parts import MIRROR, bumps, hills, metal, tube


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
            "bsdf": blend(metal(101), blend(glass, r._diffuse(r._bitmap(102, 3, 3)), 0.6), r._bitmap(103, 3, 4)),
        },
        tube=tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf=mask(
                {"type": "twosided", "a": r._diffuse(r._bitmap(104, 3, 3)), "b": metal(105)},
                {"type": "mesh_attribute", "name": "vertex_color", "scale": 0.9},
            ),
        ),
        sheet={
            "type": "rectangle",
            "to_world": r.translate(-0.4, 0.6, 1.2) @ r.rotate("y", 30) @ r.scale(0.5),
            "bsdf": {"type": "twosided", "a": blend(mirror, metal(106), 0.3), "b": r._diffuse(0.7)},
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
        lamp_shade=hills(
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
            "bsdf": {"type": "twosided", "bsdf": blend(r._diffuse(r._bitmap(111, 5, 5)), metal(112, 0.5))},
        },
        lamp=r._lamp(r._bitmap(113, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(114, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def normals() -> dict:
    """Normal maps on all shapes, from both sides, around and inside of mixtures, of rough and of clear models."""

    def turned(bsdf: dict, seed: int, **more) -> dict:
        return {"type": "normalmap", "normalmap": bumps(seed), "bsdf": bsdf, **more}

    paint, glass = r._diffuse(r._bitmap(121, 3, 3)), {"type": "dielectric", "int_ior": 1.3}
    bare = tube(to_world=r.translate(1.4, 0.3, -0.4) @ r.scale(0.6), bsdf=turned(paint, 122))
    bare.vertex_texcoords = None
    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "to_world": r.translate(-0.9, -0.1, 0.2) @ r.rotate("x", 70) @ r.scale(0.7),
            "bsdf": layer_scenes.normal_map(metal(123)),
        },
        tube=tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "twosided", "a": turned(paint, 124), "b": turned(metal(125), 126)},
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
            "bsdf": layer_scenes.bump_map(metal(134), 0.1, scale=0.9),
        },
        dunes=tube(
            to_world=r.translate(1.2, 1.0, 0.2) @ r.scale(0.5),
            bsdf={"type": "twosided", "bsdf": {"type": "bumpmap", "heights": bumps(135), "bsdf": paint}},
        ),
        veil={
            "type": "rectangle",
            "to_world": r.translate(-0.6, 1.0, 0.6) @ r.rotate("x", -50) @ r.scale(0.4),
            "bsdf": turned(layer_scenes.mask(layer_scenes.blend(paint, metal(132)), 0.6), 133),
        },
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": turned(metal(134, 0.5), 135)},
        lamp=r._lamp(r._bitmap(136, 3, 4, 1.0, 9.0)),
        bulb={"type": "point", "position": [-2.0, 2.0, 1.0], "intensity": r._rgb(4.0, 5.0, 3.0)},
        sky={"type": "envmap", "data": r._noise(137, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )
