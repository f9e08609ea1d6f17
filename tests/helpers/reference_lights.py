"""Reference scenes of lights, see `reference_scenes.py`."""

from __future__ import annotations

from reference_parts import (
    PATH5,
    ReferenceScene,
    _bitmap,
    _camera,
    _diffuse,
    _floor,
    _lamp,
    _noise,
    _rgb,
    _scene,
    look_at,
    rotate,
    scale,
    translate,
)


def _environment() -> ReferenceScene:
    """Diffuse ball and floor under an environment map with a bright spot: emitter sampling of the map."""
    data = _noise(6, 16, 32, 0.05, 0.4)
    data[3:5, 6:8] = 30.0
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={"type": "sphere", "radius": 0.9, "bsdf": _diffuse(_rgb(0.8, 0.5, 0.2))},
            floor=_floor(_rgb(0.3, 0.5, 0.4)),
            sky={"type": "envmap", "data": data, "to_world": rotate("y", -70)},
        ),
        ("sky.data", "ball.bsdf.reflectance.value", "floor.bsdf.reflectance.value"),
    )


def _area() -> ReferenceScene:
    """Textured area light, a spherical light and a light on a cube; a two-sided sheet of two colours."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            lamp=_lamp(_bitmap(7, 4, 4, 1.0, 12.0)),
            bulb={
                "type": "sphere",
                "center": [-1.4, 0.6, 0.4],
                "radius": 0.25,
                "emitter": {"type": "area", "radiance": _rgb(3.0, 5.0, 2.0)},
            },
            block={
                "type": "cube",
                "to_world": translate(1.3, -0.7, 0.6) @ rotate("y", 25) @ scale(0.2),
                "emitter": {"type": "area", "radiance": _rgb(2.0, 1.0, 4.0)},
            },
            sheet={
                "type": "rectangle",
                "to_world": translate(0.0, -0.2, -0.4) @ rotate("y", 75) @ scale(0.7),
                "bsdf": {
                    "type": "twosided",
                    "front": _diffuse(_rgb(0.8, 0.2, 0.2)),
                    "rear": _diffuse(_rgb(0.2, 0.2, 0.8)),
                },
            },
            floor=_floor(0.6),
        ),
        (
            "lamp.emitter.radiance.data",
            "bulb.emitter.radiance.value",
            "block.emitter.radiance.value",
            "sheet.bsdf.brdf_0.reflectance.value",
            "sheet.bsdf.brdf_1.reflectance.value",
            "floor.bsdf.reflectance.value",
        ),
    )


def _hidden_and_null() -> ReferenceScene:
    """Hidden emitters, a `null` surface before half of the view, Russian roulette from the second bounce."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": -1, "rr_depth": 2, "hide_emitters": True},
            _camera(),
            lamp={
                "type": "rectangle",
                "to_world": translate(-0.9, 0.2, 1.0) @ rotate("y", 180) @ scale(0.6),
                "emitter": {"type": "area", "radiance": _rgb(6.0, 5.0, 4.0)},
            },
            curtain={
                "type": "rectangle",
                "to_world": translate(1.0, 0.0, 1.2) @ scale(0.8),
                "bsdf": {"type": "null"},
            },
            wall={"type": "rectangle", "to_world": translate(0, 0, -1.5) @ scale(3), "bsdf": _diffuse(0.7)},
            floor=_floor(_rgb(0.6, 0.7, 0.8)),
            sky={"type": "constant", "radiance": 0.3},
        ),
        ("lamp.emitter.radiance.value", "wall.bsdf.reflectance.value", "floor.bsdf.reflectance.value"),
    )


def _direct() -> ReferenceScene:
    """The direct-illumination integrator with different numbers of emitter and BSDF samples."""
    return ReferenceScene(
        _scene(
            {"type": "direct", "emitter_samples": 2, "bsdf_samples": 1},
            _camera(),
            lamp=_lamp(_rgb(8.0, 7.0, 5.0)),
            ball={"type": "sphere", "radius": 0.8, "bsdf": _diffuse(_rgb(0.7, 0.5, 0.3))},
            floor=_floor(0.6),
            sky={"type": "constant", "radiance": 0.2},
        )
    )


def _spot() -> ReferenceScene:
    """A spot light with an image and one without; a ball in the first one's cone."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 3, "rr_depth": 100},
            _camera(),
            lamp={
                "type": "spot",
                "intensity": _rgb(30.0, 25.0, 20.0),
                "cutoff_angle": 25.0,
                "beam_width": 12.0,
                "texture": _bitmap(81, 4, 4),
                "to_world": look_at((1.0, 3.0, 2.0), (0.2, -0.4, 0.0)),
            },
            torch={
                "type": "spot",
                "intensity": _rgb(9.0, 9.0, 9.0),
                "cutoff_angle": 40.0,
                "to_world": look_at((-2.0, 1.5, 1.0), (-0.8, -1.0, -0.5)),
            },
            ball={"type": "sphere", "center": [0.4, -0.5, 0.0], "radius": 0.5, "bsdf": _diffuse(_rgb(0.8, 0.5, 0.2))},
            floor=_floor(_rgb(0.3, 0.5, 0.4)),
        ),
        ("lamp.intensity.value", "torch.intensity.value", "lamp.texture.data", "floor.bsdf.reflectance.value"),
    )


def _projector() -> ReferenceScene:
    """An image thrown over a ball onto the floor, from an angle."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 3, "rr_depth": 100},
            _camera(),
            beamer={
                "type": "projector",
                "irradiance": _bitmap(82, 6, 9, wrap_mode="clamp"),
                "scale": 12.0,
                "fov": 35.0,
                "to_world": look_at((1.5, 2.5, 2.0), (0.0, -0.7, 0.0)),
            },
            ball={"type": "sphere", "center": [-0.3, -0.5, 0.2], "radius": 0.5, "bsdf": _diffuse(_rgb(0.8, 0.5, 0.2))},
            floor=_floor(_rgb(0.5, 0.6, 0.4)),
        ),
        ("beamer.irradiance.data", "beamer.scale", "floor.bsdf.reflectance.value"),
    )


def _directional() -> ReferenceScene:
    """The sun, given by its direction, beside a weak sky."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 3, "rr_depth": 100},
            _camera(),
            sun={"type": "directional", "irradiance": _rgb(3.0, 2.5, 2.0), "direction": [0.5, -2.0, -0.7]},
            sky={"type": "constant", "radiance": _rgb(0.1, 0.2, 0.3)},
            ball={"type": "sphere", "center": [0.4, -0.2, 0.0], "radius": 0.6, "bsdf": _diffuse(_rgb(0.8, 0.5, 0.2))},
            floor=_floor(_bitmap(83, 4, 4)),
        ),
        ("sun.irradiance.value", "sky.radiance.value", "ball.bsdf.reflectance.value"),
    )
