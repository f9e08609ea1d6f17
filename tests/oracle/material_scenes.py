"""Scenes of clear, rough and brushed materials."""

from __future__ import annotations

import layer_scenes
import reference_scenes as r

from .scene_parts import MIRROR, bumps, hills, tube


def glass() -> dict:
    """Chains of refraction and reflection between a textured floor and a turned sky."""
    return r._scene(
        {"type": "path", "max_depth": 7, "rr_depth": 3},
        r._camera(),
        ball={"type": "sphere", "center": [-0.9, -0.1, 0.2], "radius": 0.7, "bsdf": {"type": "dielectric"}},
        tube=tube(
            to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6),
            bsdf={"type": "dielectric", "int_ior": 1.3, "specular_transmittance": r._bitmap(34, 3, 3)},
        ),
        lens=hills(
            47,
            to_world=r.translate(-0.4, 0.9, 0.3) @ r.rotate("x", 20) @ r.scale(0.6, 0.5, 0.4),
            bsdf={"type": "dispersivedielectric", "eta": 1.2},
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
        plate={
            "type": "rectangle",
            "to_world": r.translate(-0.7, -0.6, 1.9) @ r.rotate("y", 20) @ r.scale(0.3),
            "bsdf": {"type": "polarizer", "theta": 20.0, "transmittance": r._rgb(0.9, 0.8, 0.7)},
        },
        wave={
            "type": "rectangle",
            "to_world": r.translate(0.7, -0.6, 1.9) @ r.scale(0.3),
            "bsdf": {"type": "retarder", "transmittance": 0.8},
        },
        circle={
            "type": "rectangle",
            "to_world": r.translate(0.7, 0.6, 1.9) @ r.scale(0.3),
            "bsdf": {"type": "circular"},
        },
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
        tube=tube(
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
        tube=tube(
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
        cup={
            "type": "sphere",
            "center": [1.0, -0.7, 1.9],
            "radius": 0.3,
            "bsdf": {
                "type": "pplastic",
                "alpha": r._bitmap(94, 3, 3, 0.1, 0.5),
                "diffuse_reflectance": r._bitmap(95, 4, 4),
                "specular_reflectance": 0.8,
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


def brushed() -> dict:
    """Facets that are rougher along one direction, on all shapes, from both sides; metal and glass."""

    def along(kind: str, u, v, **more) -> dict:
        return {"type": kind, "alpha_u": u, "alpha_v": v, **more}

    def metal(u, v, **more) -> dict:
        return along("roughconductor", u, v, eta=r._rgb(0.2, 0.9, 1.1), k=r._rgb(3.9, 2.4, 2.2), **more)

    bare = tube(to_world=r.translate(1.4, 0.3, -0.4) @ r.scale(0.6), bsdf=metal(0.2, 0.5))
    bare.vertex_texcoords = None
    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(),
        ball={
            "type": "sphere",
            "to_world": r.translate(-0.9, -0.1, 0.2) @ r.rotate("x", 70) @ r.scale(0.7),
            "bsdf": metal(r._bitmap(141, 3, 4), 0.3, distribution="ggx"),
        },
        tube=tube(
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
        hills=hills(
            154,
            to_world=r.translate(-0.3, 0.9, 0.3) @ r.rotate("x", 30) @ r.scale(0.6, 0.5, 0.4),
            bsdf=dented,
        ),
        tube=tube(to_world=r.translate(0.7, -0.1, 0.8) @ r.scale(0.6), bsdf={"type": "twosided", "bsdf": dented}),
        floor={"type": "rectangle", "to_world": r.FLOOR, "bsdf": layer_scenes.normal_map(metal)},
        lamp=r._lamp(r._bitmap(152, 3, 4, 1.0, 9.0)),
        sky={"type": "envmap", "data": r._noise(153, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )


def fibres() -> dict:
    """Hair by its pigments and by its absorption, on cylinders, seen from outside and inside, on meshes and spheres."""

    def fibre(start: list[float], end: list[float], radius: float, **hair) -> dict:
        return {"type": "cylinder", "p0": start, "p1": end, "radius": radius, "bsdf": {"type": "hair", **hair}}

    return r._scene(
        {"type": "path", "max_depth": 5, "rr_depth": 3},
        r._camera(),
        brown=fibre([-1.6, -0.6, 0.2], [-0.4, 1.1, 0.5], 0.4, eumelanin=r._bitmap(161, 4, 5), scale_tilt=5.0),
        dyed=fibre(
            [-0.4, -0.7, 0.9],
            [1.0, 0.6, 0.3],
            0.3,
            sigma_a=r._bitmap(162, 4, 4),
            scale=1.7,
            longitudinal_roughness=0.15,
        ),
        hollow={
            **fibre([0.5, 0.9, 1.0], [1.3, 0.1, 0.6], 0.35, pheomelanin=0.4, azimuthal_roughness=0.7, eta=1.3),
            "flip_normals": True,
        },
        tube=tube(
            to_world=r.translate(0.9, -0.4, 0.9) @ r.scale(0.5),
            bsdf={"type": "hair", "sigma_a": r._rgb(0.1, 0.4, 0.8), "longitudinal_roughness": 0.6},
        ),
        ball={"type": "sphere", "center": [0.1, 0.6, -1.0], "radius": 0.6, "bsdf": {"type": "hair", "eumelanin": 0.1}},
        floor=r._floor(r._bitmap(163, 5, 5)),
        lamp=r._lamp(r._bitmap(164, 3, 4, 1.0, 9.0)),
        sky={"type": "envmap", "data": r._noise(165, 6, 8, 0.1, 1.0), "to_world": r.rotate("y", 40), "scale": 0.7},
    )
