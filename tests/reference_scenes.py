"""Small scenes, one for each group of models, as plain dictionaries of numbers and arrays.

`bench/make_references.py` renders them with Mitsuba 3.9.1 into `tests/data/references.npz`, `test_references.py`
renders them with torchrender and compares. This module needs NumPy alone, so that both environments can import it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parent / "data"
SIZE = 48  # pixels along either side of the film
BLOCK = 4  # pixels along either side of the blocks over which references are averaged


@dataclass(frozen=True)
class ReferenceScene:
    """A scene in `load_dict` format and the parameters whose derivative of mean(image * weight) is compared."""

    scene: dict
    gradients: tuple[str, ...] = ()


def translate(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def scale(x: float, y: float | None = None, z: float | None = None) -> np.ndarray:
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def rotate(axis: str, degrees: float) -> np.ndarray:
    """Rotation about a coordinate axis, counter-clockwise seen against the axis."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(4)
    matrix[j, j] = matrix[k, k] = cos
    matrix[k, j], matrix[j, k] = sin, -sin
    return matrix


def look_at(origin, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    origin, target = np.asarray(origin, float), np.asarray(target, float)
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def weight(height: int = SIZE, width: int = SIZE, channels: int = 3) -> np.ndarray:
    """The smooth weight of the scalar mean(image * weight), (H, W, C); the stored comparison scenes use it, too."""
    x, y = 2 * np.pi * np.arange(width) / width, 2 * np.pi * np.arange(height) / height
    pattern = 1 + 0.5 * np.sin(x)[None, :] * np.cos(y)[:, None]
    return pattern[..., None] * np.array([1.0, 0.8, 0.6])[:channels]


def _rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def _camera(origin=(0.0, 1.0, 5.0), target=(0.0, 0.0, 0.0), fov=40.0, film: dict | None = None, **more) -> dict:
    film = {"rfilter": {"type": "box"}, **(film or {})}
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": look_at(origin, target),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "component_format": "float32", **film},
        "sampler": {"type": "independent"},
        **more,
    }


def _scene(integrator: dict, sensor: dict, **objects) -> dict:
    return {"type": "scene", "integrator": integrator, "sensor": sensor, **objects}


def _noise(seed: int, height: int, width: int, low: float, high: float, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (height, width, channels)).astype(np.float32)


def _bitmap(seed: int, height: int, width: int, low: float = 0.1, high: float = 0.9, **more) -> dict:
    return {"type": "bitmap", "data": _noise(seed, height, width, low, high), "raw": True, **more}


def _diffuse(reflectance) -> dict:
    return {"type": "diffuse", "reflectance": reflectance}


PATH5 = {"type": "path", "max_depth": 5, "rr_depth": 100}
FLOOR = translate(0, -1, 0) @ rotate("x", -90) @ scale(3)
LAMP = translate(0.3, 2.5, 0.5) @ rotate("x", 90) @ scale(0.6)
TO_UV = np.array([[2.0, 0.5, 0.2], [-0.4, 3.0, 0.1], [0.0, 0.0, 1.0]])


def _lamp(radiance) -> dict:
    return {"type": "rectangle", "to_world": LAMP, "emitter": {"type": "area", "radiance": radiance}}


def _floor(reflectance) -> dict:
    return {"type": "rectangle", "to_world": FLOOR, "bsdf": _diffuse(reflectance)}


def _shapes() -> ReferenceScene:
    """Every analytic shape, with textures on their own coordinates, lit by a point and a constant light."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={
                "type": "sphere",
                "center": [-1.1, -0.2, 0.3],
                "radius": 0.7,
                "bsdf": _diffuse(_bitmap(1, 8, 16)),
            },
            box={
                "type": "cube",
                "to_world": translate(1.0, -0.4, -0.2) @ rotate("y", 30) @ scale(0.5, 0.6, 0.5),
                "bsdf": _diffuse(_bitmap(2, 4, 4)),
            },
            plate={
                "type": "disk",
                "to_world": translate(0.1, 0.5, -1.0) @ scale(0.9, 0.6, 1.0),
                "bsdf": _diffuse(_bitmap(3, 6, 6)),
            },
            floor=_floor({"type": "checkerboard", "color0": 0.7, "color1": _rgb(0.2, 0.1, 0.3), "to_uv": TO_UV}),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
        (
            "ball.bsdf.reflectance.data",
            "box.bsdf.reflectance.data",
            "plate.bsdf.reflectance.data",
            "floor.bsdf.reflectance.color1.value",
            "bulb.intensity.value",
            "sky.radiance.value",
        ),
    )


def _bitmaps() -> ReferenceScene:
    """Bitmap filters and wrap modes with a texture transformation, on five squares facing the camera."""
    modes = [("bilinear", "repeat"), ("bilinear", "mirror"), ("bilinear", "clamp"), ("nearest", "mirror")]
    objects = {}
    for i, (filter_type, wrap_mode) in enumerate(modes):
        objects[f"square{i}"] = {
            "type": "rectangle",
            "to_world": translate(-0.9 + 1.8 * (i % 2), -0.9 + 1.8 * (i // 2), 0.0) @ scale(0.85),
            "bsdf": _diffuse(_bitmap(10 + i, 4, 5, filter_type=filter_type, wrap_mode=wrap_mode, to_uv=TO_UV)),
        }
    sky = {"type": "constant", "radiance": _rgb(1.0, 1.0, 1.0)}
    names = tuple(f"square{i}.bsdf.reflectance.data" for i in range(4))
    return ReferenceScene(
        _scene({"type": "path", "max_depth": 2}, _camera((0, 0, 5)), **objects, sky=sky), (*names, "sky.radiance.value")
    )


def _dielectric() -> ReferenceScene:
    """A glass ball and a tinted glass slab above a floor under a constant sky."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 8, "rr_depth": 100},
            _camera(),
            ball={"type": "sphere", "center": [-0.6, -0.1, 0.2], "radius": 0.8, "bsdf": {"type": "dielectric"}},
            slab={
                "type": "cube",
                "to_world": translate(1.1, -0.3, 0.0) @ rotate("y", 20) @ scale(0.4, 0.6, 0.1),
                "bsdf": {
                    "type": "dielectric",
                    "int_ior": "water",
                    "ext_ior": 1.0,
                    "specular_reflectance": _rgb(0.9, 0.8, 0.7),
                    "specular_transmittance": _rgb(0.5, 0.9, 0.7),
                },
            },
            floor=_floor(_bitmap(4, 8, 8)),
            sky={"type": "constant", "radiance": _rgb(0.6, 0.8, 1.0)},
        ),
        ("floor.bsdf.reflectance.data", "sky.radiance.value"),
    )


def _rough(distribution: str, gradients: tuple[str, ...]) -> ReferenceScene:
    """A rough glass ball and a tinted rough slab, lit through by a lamp and a sky."""
    return ReferenceScene(
        _scene(
            {"type": "path", "max_depth": 6, "rr_depth": 100},
            _camera(),
            ball={
                "type": "sphere",
                "center": [-0.6, -0.1, 0.2],
                "radius": 0.8,
                "bsdf": {"type": "roughdielectric", "distribution": distribution, "alpha": 0.3, "int_ior": 1.5},
            },
            slab={
                "type": "cube",
                "to_world": translate(1.1, -0.3, 0.0) @ rotate("y", 20) @ scale(0.4, 0.6, 0.1),
                "bsdf": {
                    "type": "roughdielectric",
                    "distribution": distribution,
                    "alpha": 0.1,
                    "int_ior": "water",
                    "ext_ior": 1.0,
                    "specular_reflectance": _rgb(0.9, 0.8, 0.7),
                    "specular_transmittance": _rgb(0.5, 0.9, 0.7),
                },
            },
            floor=_floor(_bitmap(5, 8, 8)),
            lamp=_lamp(_rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": _rgb(0.3, 0.4, 0.5)},
        ),
        gradients,
    )


def _rough_ggx() -> ReferenceScene:
    return _rough(
        "ggx",
        (
            "ball.bsdf.alpha.value",
            "ball.bsdf.eta",
            "slab.bsdf.alpha.value",
            "slab.bsdf.eta",
            "slab.bsdf.specular_reflectance.value",
            "slab.bsdf.specular_transmittance.value",
            "floor.bsdf.reflectance.data",
            "lamp.emitter.radiance.value",
            "sky.radiance.value",
        ),
    )


def _rough_beckmann() -> ReferenceScene:
    return _rough("beckmann", ("ball.bsdf.alpha.value", "ball.bsdf.eta", "slab.bsdf.alpha.value"))


def _conductor() -> ReferenceScene:
    """A golden ball and a tinted mirror, one-sided and two-sided, in a rotated environment map."""
    gold = {"type": "conductor", "eta": _rgb(0.143, 0.375, 1.442), "k": _rgb(3.983, 2.386, 1.603)}
    tinted = {"type": "conductor", "specular_reflectance": _rgb(0.9, 0.6, 0.3)}
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={"type": "sphere", "center": [-0.7, -0.2, 0.2], "radius": 0.8, "bsdf": gold},
            mirror={
                "type": "rectangle",
                "to_world": translate(0.9, -0.1, -0.2) @ rotate("y", 160) @ scale(0.8),
                "bsdf": {"type": "twosided", "bsdf": tinted},
            },
            floor=_floor(0.5),
            sky={
                "type": "envmap",
                "data": _noise(5, 8, 16, 0.1, 1.5),
                "to_world": rotate("y", 40) @ rotate("x", 25),
                "scale": 0.8,
            },
        ),
        ("sky.data", "floor.bsdf.reflectance.value"),
    )


def _glossy() -> ReferenceScene:
    """A golden ball of varying roughness, a plastic one, and a pane of tinted glass before both."""
    gold = {
        "type": "roughconductor",
        "distribution": "ggx",
        "material": "Au",
        "alpha": {"type": "bitmap", "data": _noise(70, 4, 6, 0.1, 0.5, 1), "raw": True},
        "specular_reflectance": _rgb(0.9, 0.8, 0.7),
    }
    pane = {"type": "thindielectric", "int_ior": 1.7, "specular_transmittance": _rgb(0.9, 0.8, 0.5)}
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={"type": "sphere", "center": [-0.8, -0.2, 0.1], "radius": 0.8, "bsdf": gold},
            toy={
                "type": "sphere",
                "center": [0.9, -0.3, 0.2],
                "radius": 0.7,
                "bsdf": {"type": "plastic", "diffuse_reflectance": _bitmap(71, 4, 8), "nonlinear": True},
            },
            pane={"type": "rectangle", "to_world": translate(0.2, 0.2, 1.6) @ scale(0.6), "bsdf": pane},
            floor=_floor(_rgb(0.6, 0.5, 0.4)),
            lamp=_lamp(_rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": _rgb(0.3, 0.4, 0.5)},
        ),
        (
            "ball.bsdf.alpha.data",
            "ball.bsdf.eta.value",
            "ball.bsdf.k.value",
            "ball.bsdf.specular_reflectance.value",
            # not toy.bsdf.diffuse_reflectance: Mitsuba's derivative differs from ours, which finite differences of the
            # image confirm (cause unknown); tests/test_bsdfs.py and the oracle have it
            "floor.bsdf.reflectance.value",
        ),
    )


PRINCIPLED = {
    "roughness": 0.4,
    "metallic": 0.3,
    "spec_tint": 0.5,
    "sheen": 0.7,
    "sheen_tint": 0.4,
    "flatness": 0.6,
    "clearcoat": 0.8,
    "clearcoat_gloss": 0.3,
}


def _principled() -> ReferenceScene:
    """A ball with every part of the principled model but transparency, and one of rough glass."""
    glass = {"type": "principled", "base_color": _rgb(0.9, 0.7, 0.8), "spec_trans": 0.8, "eta": 1.4, "roughness": 0.5}
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={
                "type": "sphere",
                "center": [-0.8, -0.2, 0.1],
                "radius": 0.8,
                "bsdf": {"type": "principled", "base_color": _bitmap(73, 4, 8), "specular": 0.7, **PRINCIPLED},
            },
            glass={"type": "sphere", "center": [0.9, -0.3, 0.2], "radius": 0.7, "bsdf": glass},
            floor=_floor(_rgb(0.6, 0.5, 0.4)),
            lamp=_lamp(_rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": _rgb(0.3, 0.4, 0.5)},
        ),
        (
            "ball.bsdf.base_color.data",
            *(f"ball.bsdf.{name}.value" for name in PRINCIPLED),
            "glass.bsdf.base_color.value",
            "glass.bsdf.roughness.value",
            "glass.bsdf.spec_trans.value",
            "glass.bsdf.eta",
        ),
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


def _mesh() -> ReferenceScene:
    """A PLY mesh with smooth normals, vertex and face colours, and one without normals; a tent filter of radius 1.5."""
    twisted = str(DATA / "twisted.ply")
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(film={"rfilter": {"type": "tent", "radius": 1.5}}),
            left={
                "type": "ply",
                "filename": twisted,
                "to_world": translate(-1.0, -0.1, 0.0) @ rotate("y", 20),
                "bsdf": _diffuse({"type": "mesh_attribute", "name": "vertex_color"}),
            },
            right={
                "type": "ply",
                "filename": twisted,
                "face_normals": True,
                "to_world": translate(1.0, -0.1, 0.0) @ rotate("y", -40),
                "bsdf": {
                    "type": "twosided",
                    "bsdf": _diffuse({"type": "mesh_attribute", "name": "face_color", "scale": 0.8}),
                },
            },
            floor=_floor(0.5),
            lamp=_lamp(_rgb(8.0, 8.0, 8.0)),
            sky={"type": "constant", "radiance": 0.2},
        ),
        ("left.vertex_color", "right.face_color"),
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


def _cylinders() -> ReferenceScene:
    """Open tubes: one textured, one turned and stretched by its matrix and mirrored, one that emits inwards."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera((0.5, 1.5, 5.0)),
            pipe={
                "type": "cylinder",
                "p0": [-1.3, -0.9, 0.4],
                "p1": [-0.5, 0.6, -0.2],
                "radius": 0.4,
                "bsdf": {"type": "twosided", "bsdf": _diffuse(_bitmap(81, 6, 12))},
            },
            tube={
                "type": "cylinder",
                "radius": 0.5,
                "to_world": translate(0.9, -0.5, 0.2) @ rotate("y", 25) @ rotate("x", -70) @ scale(-0.8, 0.8, 1.4),
                "bsdf": {"type": "twosided", "bsdf": _diffuse(_bitmap(82, 4, 6))},
            },
            lamp={
                "type": "cylinder",
                "p0": [0.1, 1.0, 0.0],
                "p1": [0.4, 1.3, 0.6],
                "radius": 0.2,
                "flip_normals": True,
                "emitter": {"type": "area", "radiance": _rgb(9.0, 6.0, 4.0)},
            },
            bar={
                "type": "cylinder",
                "p0": [-0.9, 1.1, 0.0],
                "p1": [-0.2, 1.3, 0.0],
                "radius": 0.05,
                "emitter": {"type": "area", "radiance": _rgb(6.0, 5.0, 7.0)},
            },
            floor=_floor(0.6),
            sky={"type": "constant", "radiance": _rgb(0.1, 0.12, 0.15)},
        ),
        (
            "pipe.bsdf.brdf_0.reflectance.data",
            "tube.bsdf.brdf_0.reflectance.data",
            "lamp.emitter.radiance.value",
            "bar.emitter.radiance.value",
        ),
    )


def _volume_texture() -> ReferenceScene:
    """A grid of colours carved by a ball and a floor, voxels of another under a plate, and a volume without a grid."""

    def grid(seed: int, *matrices: np.ndarray, **more) -> dict:
        data = np.random.default_rng(seed).uniform(0.1, 0.9, (4, 5, 6, 3)).astype(np.float32)
        to_world = np.linalg.multi_dot([np.eye(4), *matrices])
        return {"type": "gridvolume", "data": data, "raw": True, "to_world": to_world, **more}

    turned = translate(-1.6, -1.1, -1.2) @ rotate("y", 20)
    carved = {"type": "volume", "volume": grid(84, turned, scale(2.8, 2.2, 2.6))}
    voxels = {"type": "volume", "volume": grid(85, translate(0.2, -0.5, -1.0), scale(0.9), filter_type="nearest")}
    wrapped = {"type": "volume", "volume": grid(86, scale(0.7), wrap_mode="mirror")}
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            ball={"type": "sphere", "center": [-0.6, -0.1, 0.2], "radius": 0.8, "bsdf": _diffuse(carved)},
            plate={
                "type": "disk",
                "to_world": translate(0.9, 0.1, -0.3) @ scale(0.7, 0.5, 1.0),
                "bsdf": _diffuse(voxels),
            },
            box={
                "type": "cube",
                "to_world": translate(1.0, -0.7, 0.6) @ rotate("y", 30) @ scale(0.3),
                "bsdf": _diffuse(wrapped),
            },
            floor=_floor({"type": "volume", "volume": {"type": "constvolume", "value": 0.4}}),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
        (
            "ball.bsdf.reflectance.volume.data",
            "plate.bsdf.reflectance.volume.data",
            "box.bsdf.reflectance.volume.data",
        ),
    )


def _instances() -> ReferenceScene:
    """A group of a cube and a ball, three times: turned, mirrored, stretched; and one of a single mesh."""
    return ReferenceScene(
        _scene(
            PATH5,
            _camera(),
            pair={
                "type": "shapegroup",
                "box": {"type": "cube", "to_world": scale(0.3), "bsdf": _diffuse(_bitmap(87, 4, 4))},
                "ball": {
                    "type": "sphere",
                    "center": [0.0, 0.55, 0.0],
                    "radius": 0.25,
                    "bsdf": _diffuse(_bitmap(88, 4, 8)),
                },
            },
            block={
                "type": "shapegroup",
                "cube": {"type": "cube", "to_world": scale(0.25), "bsdf": _diffuse(_rgb(0.7, 0.3, 0.2))},
            },
            left={
                "type": "instance",
                "to_world": translate(-1.1, -0.6, 0.2) @ rotate("y", 30),
                "group": {"type": "ref", "id": "pair"},
            },
            right={
                "type": "instance",
                "to_world": translate(1.0, -0.5, 0.0) @ scale(-1.3, 1.3, 1.3) @ rotate("y", -20),
                "group": {"type": "ref", "id": "pair"},
            },
            slab={
                "type": "instance",
                "to_world": translate(0.0, 0.4, -0.6) @ rotate("z", 30) @ scale(2.0, 0.5, -1.0),
                "group": {"type": "ref", "id": "block"},
            },
            floor=_floor(0.5),
            bulb={"type": "point", "position": [1.0, 3.0, 3.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": _rgb(0.4, 0.5, 0.6)},
        ),
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


def twisted_mesh(rows: int = 8, columns: int = 12):
    """A twisted, bulging tube: vertices, normals, vertex colours (V, 3), faces (F, 3), face colours (F, 3)."""
    vertices, faces = [], []
    for j in range(rows + 1):
        for i in range(columns):
            height = 2 * j / rows - 1
            angle = 2 * np.pi * i / columns + 0.8 * height
            radius = 0.6 + 0.15 * np.cos(3 * height) + 0.1 * np.cos(2 * angle)
            vertices.append((radius * np.cos(angle), 0.8 * height, radius * np.sin(angle)))
    for j in range(rows):
        for i in range(columns):
            a, b = j * columns + i, j * columns + (i + 1) % columns
            c, d = a + columns, b + columns
            faces += [(a, c, b), (b, c, d)]
    vertices, faces = np.array(vertices), np.array(faces)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], cross)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rng = np.random.default_rng(20)
    return vertices, normals, rng.uniform(0.1, 0.9, vertices.shape), faces, rng.uniform(0.1, 0.9, faces.shape)


def write_twisted_mesh(path: Path) -> None:
    """Write `twisted_mesh()` as a binary PLY whose colours Mitsuba and torchrender read as mesh attributes."""
    vertices, normals, colours, faces, face_colours = twisted_mesh()
    rows = np.concatenate([vertices, normals, colours], axis=1).astype("<f4")
    corners = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", 3), ("c", "<f4", 3)])
    corners["n"], corners["i"], corners["c"] = 3, faces, face_colours
    vertex_names = ["x", "y", "z", "nx", "ny", "nz", "color_0", "color_1", "color_2"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in vertex_names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += [f"property float color_{i}" for i in range(3)] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes() + corners.tobytes())
