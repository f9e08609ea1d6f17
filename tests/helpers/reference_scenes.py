"""Small scenes, one for each group of models, as plain dictionaries of numbers and arrays.

`bench/make_references.py` renders them with Mitsuba 3.9.1 into `tests/data/references.npz`, `test_references.py`
renders them with torchrender and compares. This module needs NumPy alone, so that both environments can import it.
"""

from __future__ import annotations

import copy

from reference_lights import _area, _direct, _directional, _environment, _hidden_and_null, _projector, _spot
from reference_materials import (  # noqa: F401 (those that are used elsewhere, too)
    PRINCIPLED,
    _conductor,
    _dielectric,
    _glossy,
    _principled,
    _rough_beckmann,
    _rough_ggx,
)
from reference_parts import (  # noqa: F401
    BLOCK,
    DATA,
    FLOOR,
    LAMP,
    PATH5,
    SIZE,
    TO_UV,
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
    weight,
)
from reference_shapes import (  # noqa: F401
    _bitmaps,
    _cylinders,
    _instances,
    _mesh,
    _shapes,
    _volume_texture,
    twisted_mesh,
    write_twisted_mesh,
)


def _film() -> ReferenceScene:
    """Gaussian filter, off-centre principal point, field of view along y and a crop window without a border."""
    film = {
        "width": 96,
        "height": 64,
        "crop_offset_x": 20,
        "crop_offset_y": 10,
        "crop_width": SIZE,
        "crop_height": SIZE,
        "rfilter": {"type": "gaussian"},
    }
    sensor = _camera(
        film=film, fov_axis="y", principal_point_offset_x=0.06, principal_point_offset_y=-0.04, far_clip=6.5
    )
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 2},
            sensor,
            ball={"type": "sphere", "radius": 0.9, "bsdf": _diffuse(_bitmap(8, 8, 16))},
            floor=_floor(_bitmap(9, 8, 8)),
            sky={"type": "constant", "radiance": 1.0},
        ),
        ("ball.bsdf.reflectance.data", "floor.bsdf.reflectance.data"),
    )


def _filtered(rfilter: dict) -> ReferenceScene:
    """A filter with negative lobes over a picture of colours as fine as pixels."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 2},
            _camera((0, 0, 5), film={"rfilter": rfilter}),
            square={"type": "rectangle", "to_world": scale(2.5), "bsdf": _diffuse(_bitmap(80, 40, 40, 0.2, 0.8))},
            sky={"type": "constant", "radiance": 1.0},
        ),
        ("square.bsdf.reflectance.data",),
    )


def _seen_by(**sensor) -> ReferenceScene:
    """A checkered floor, balls at three distances, an area light and a sky, seen by another camera."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 3, "rr_depth": 100},
            {**{k: v for k, v in _camera(origin=(0.5, 1.2, 5.0)).items() if k != "fov"}, **sensor},
            near={"type": "sphere", "center": [-0.7, -0.4, 2.2], "radius": 0.35, "bsdf": _diffuse(_bitmap(95, 4, 8))},
            middle={"type": "sphere", "center": [0.2, -0.2, 0.2], "radius": 0.5, "bsdf": _diffuse(_bitmap(96, 4, 8))},
            far={"type": "sphere", "center": [0.9, 0.1, -2.0], "radius": 0.7, "bsdf": _diffuse(_bitmap(97, 4, 8))},
            floor=_floor({"type": "checkerboard", "color0": 0.7, "color1": _rgb(0.2, 0.1, 0.3), "to_uv": TO_UV}),
            lamp=_lamp(_rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": _rgb(0.3, 0.4, 0.5)},
        )
    )


def _thinlens() -> ReferenceScene:
    """A lens in focus in the middle, the field of view along the film's height."""
    return _seen_by(type="thinlens", fov=42.0, fov_axis="y", aperture_radius=0.25, focus_distance=4.6)


def _orthographic() -> ReferenceScene:
    """Parallel rays, the frame scaled, a film twice as wide as high."""
    film = {**_camera()["film"], "width": 2 * SIZE}
    place = look_at((0.5, 1.2, 5.0), (0.0, 0.0, 0.0)) @ scale(2.2, 2.2, 1.0)
    return _seen_by(type="orthographic", to_world=place, film=film)


# Rendered into a file of their own.


CAMERAS = {"thinlens": _thinlens, "orthographic": _orthographic}


SCENES = {
    "shapes": _shapes,
    "bitmaps": _bitmaps,
    "dielectric": _dielectric,
    "rough_ggx": _rough_ggx,
    "rough_beckmann": _rough_beckmann,
    "conductor": _conductor,
    "glossy": _glossy,
    "principled": _principled,
    "environment": _environment,
    "area": _area,
    "hidden_and_null": _hidden_and_null,
    "direct": _direct,
    "film": _film,
    "mitchell": lambda: _filtered({"type": "mitchell", "B": 0.2, "C": 0.5}),
    "catmullrom": lambda: _filtered({"type": "catmullrom"}),
    "lanczos": lambda: _filtered({"type": "lanczos"}),
    "mesh": _mesh,
    "spot": _spot,
    "projector": _projector,
    "directional": _directional,
    "cylinders": _cylinders,
    "volume_texture": _volume_texture,
    "instances": _instances,
}


def in_few_pixels(name: str, size: int) -> dict:
    """The description of a scene of `SCENES` with so many pixels along a side, its crop's if it has one."""
    description = copy.deepcopy(SCENES[name]().scene)
    film = description["sensor"]["film"]
    film.update(dict.fromkeys(("crop_width", "crop_height") if "crop_width" in film else ("width", "height"), size))
    return description
