"""Small scenes with participating media, as plain dictionaries like those of `reference_scenes.py`.

`bench/make_references.py` renders them with Mitsuba 3.9.1 into `tests/data/media_references.npz`,
`test_media_references.py` renders them with torchrender and compares.
"""

from __future__ import annotations

import numpy as np
from reference_scenes import ReferenceScene, _camera, _diffuse, _rgb, _scene, look_at, rotate, scale, translate

SIZE = 24  # pixels along either side of the film


def view(origin=(0.3, 0.8, 4.0), target=(0.0, 0.0, 0.0), fov=40.0, **more) -> dict:
    """A camera with a film of SIZE x SIZE pixels."""
    return _camera(origin, target, fov, film={"width": SIZE, "height": SIZE}, **more)


def noise(seed: int, shape: tuple[int, ...], low: float, high: float) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, shape).astype(np.float32)


def grid(data: np.ndarray, to_world: np.ndarray, filter_type: str = "trilinear", **more) -> dict:
    return {
        "type": "gridvolume",
        "data": data,
        "raw": True,
        "to_world": to_world,
        "filter_type": filter_type,
        "wrap_mode": "clamp",
        **more,
    }


def boundary(interior: dict, to_world: np.ndarray, kind: str = "cube", **more) -> dict:
    """An index-matched shape with a medium inside."""
    return {"type": kind, "to_world": to_world, "bsdf": {"type": "null"}, "interior": interior, **more}


# From the unit cube [0, 1]^3 of a grid to that of the shape `cube`, [-1, 1]^3.
UNIT_TO_CUBE = translate(-1, -1, -1) @ scale(2)
TURNED = rotate("y", 30) @ rotate("x", 15) @ scale(0.9, 0.7, 0.8)
FLOOR = translate(0, -1.3, 0) @ rotate("x", -90) @ scale(3)


def _volpath(max_depth: int, rr_depth: int = 100, **more) -> dict:
    return {"type": "volpath", "max_depth": max_depth, "rr_depth": rr_depth, **more}


def sparse_density(seed: int, shape: tuple[int, int, int]) -> np.ndarray:
    """Voxels (Z, Y, X, 1) in [0, 1], half of them empty."""
    values = noise(seed, (*shape, 1), -1.0, 1.0)
    return np.maximum(values, 0)


def _cloud() -> ReferenceScene:
    """A cloud with empty cells and forward scattering above a floor, under a constant sky; Russian roulette."""
    medium = {
        "type": "heterogeneous",
        "sigma_t": grid(sparse_density(1, (4, 5, 6)), TURNED @ UNIT_TO_CUBE),
        "scale": 6.0,
        "albedo": _rgb(0.95, 0.8, 0.6),
        "phase": {"type": "hg", "g": 0.5},
    }
    return ReferenceScene(
        _scene(
            _volpath(-1, 5),
            view(),
            cloud=boundary(medium, TURNED),
            floor={"type": "rectangle", "to_world": FLOOR, "bsdf": _diffuse(_rgb(0.6, 0.5, 0.4))},
            sky={"type": "constant", "radiance": _rgb(0.6, 0.8, 1.0)},
        )
    )


def _voxels() -> ReferenceScene:
    """Nearest voxels of everything, by a point light, in a ball; derivatives where no voxel is empty.

    The densest voxel is a corner, out of reach: the reference's derivative is wrong where the density is the majorant.
    """
    to_world = rotate("z", 20) @ scale(1.3) @ UNIT_TO_CUBE
    density = noise(2, (5, 5, 5, 1), 0.3, 1.5)
    density[0, 0, 0] = 2.0
    medium = {
        "type": "heterogeneous",
        "sigma_t": grid(density, to_world, "nearest"),
        "albedo": grid(noise(3, (2, 3, 4, 3), 0.2, 0.95), to_world, "nearest"),
    }
    return ReferenceScene(
        _scene(
            _volpath(8),
            view(fov=30.0),
            ball=boundary(medium, np.eye(4), "sphere"),
            lamp={"type": "point", "position": [1.5, 2.5, 2.0], "intensity": _rgb(9.0, 8.0, 6.0)},
        ),
        ("ball.interior_medium.sigma_t.data", "ball.interior_medium.albedo.data", "lamp.intensity.value"),
    )


def _smooth() -> ReferenceScene:
    """Trilinear density and albedo that fill a cube, by an area light and an environment map, backward scattering."""
    medium = {
        "type": "heterogeneous",
        "sigma_t": grid(noise(4, (3, 3, 4, 1), 0.3, 1.0), TURNED @ UNIT_TO_CUBE),
        "scale": 2.0,
        "albedo": grid(noise(5, (3, 2, 2, 3), 0.3, 0.95), TURNED @ UNIT_TO_CUBE),
        "phase": {"type": "hg", "g": -0.3},
    }
    lamp = translate(0.3, 1.8, 0.5) @ rotate("x", 90) @ scale(0.6)
    return ReferenceScene(
        _scene(
            _volpath(8),
            view(),
            cloud=boundary(medium, TURNED),
            lamp={"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": _rgb(5.0, 4.0, 3.0)}},
            sky={"type": "envmap", "data": noise(6, (4, 8, 3), 0.1, 1.5), "to_world": rotate("y", 40)},
        ),
        (
            "cloud.interior_medium.sigma_t.data",
            "cloud.interior_medium.albedo.data",
            "lamp.emitter.radiance.value",
            "sky.data",
        ),
    )


def _fog() -> ReferenceScene:
    """The camera, an area light and a ball in a fog whose end is a sphere around all; emitters are hidden."""
    return ReferenceScene(
        _scene(
            _volpath(6, hide_emitters=True),
            view(medium={"type": "ref", "id": "fog"}),
            fog={"type": "homogeneous", "sigma_t": 0.25, "albedo": _rgb(0.9, 0.7, 0.5)},
            end={**boundary({"type": "ref", "id": "fog"}, scale(6), "sphere")},
            ball={
                "type": "sphere",
                "radius": 0.8,
                "bsdf": _diffuse(_rgb(0.7, 0.5, 0.3)),
                "exterior": {"type": "ref", "id": "fog"},
            },
            lamp={
                "type": "rectangle",
                "to_world": translate(0.8, 1.6, 1.0) @ rotate("x", 70) @ scale(0.5),
                "emitter": {"type": "area", "radiance": _rgb(12.0, 10.0, 8.0)},
                "bsdf": _diffuse(0.5),
            },
            sky={"type": "constant", "radiance": 0.2},
        )
    )


def _coloured() -> ReferenceScene:
    """Extinction that differs by a factor of ten between channels."""
    medium = {"type": "homogeneous", "sigma_t": _rgb(0.1, 0.4, 1.0), "scale": 4.0, "albedo": _rgb(0.5, 0.8, 0.95)}
    return ReferenceScene(
        _scene(
            {"type": "volpathmis", "max_depth": 6, "rr_depth": 100},
            view(fov=30.0),
            ball=boundary(medium, np.eye(4), "sphere"),
            wall={"type": "rectangle", "to_world": translate(0, 0, -2) @ scale(4), "bsdf": _diffuse(0.5)},
            lamp={"type": "point", "position": [1.0, 3.0, 2.0], "intensity": _rgb(20.0, 15.0, 12.0)},
            sky={"type": "constant", "radiance": 0.5},
        )
    )


def _nested() -> ReferenceScene:
    """A dense ball and a glass ball with milk inside a thin haze in a cube."""
    haze = {"type": "ref", "id": "haze"}
    dense = {"type": "homogeneous", "sigma_t": 3.0, "albedo": _rgb(0.9, 0.3, 0.2), "phase": {"type": "hg", "g": 0.4}}
    milk = {"type": "homogeneous", "sigma_t": 4.0, "albedo": _rgb(0.95, 0.9, 0.8)}
    return ReferenceScene(
        _scene(
            _volpath(12),
            view(),
            haze={"type": "homogeneous", "sigma_t": 0.4, "albedo": 0.7},
            box=boundary(haze, rotate("y", 25) @ scale(1.1)),
            cherry=boundary(dense, translate(-0.5, 0.1, 0.1) @ scale(0.4), "sphere", exterior=haze),
            glass={
                "type": "sphere",
                "center": [0.45, -0.1, 0.2],
                "radius": 0.4,
                "bsdf": {"type": "dielectric", "int_ior": 1.33, "ext_ior": 1.0},
                "interior": milk,
                "exterior": haze,
            },
            sky={"type": "envmap", "data": noise(7, (4, 8, 3), 0.1, 1.5), "to_world": rotate("x", 30)},
        ),
        (
            "haze.sigma_t.value.value",
            "haze.albedo.value.value",
            "cherry.interior_medium.sigma_t.value.value",
            "cherry.interior_medium.albedo.value.value",
            "glass.interior_medium.albedo.value.value",
            "sky.data",
        ),
    )


def _frosted() -> ReferenceScene:
    """A milky ball and a block behind rough glass, between a floor and a lamp, in an environment map."""
    milk = {"type": "homogeneous", "sigma_t": 3.0, "albedo": _rgb(0.95, 0.9, 0.7), "phase": {"type": "hg", "g": 0.6}}
    place = translate(0.6, 0, 0) @ TURNED @ scale(0.6)
    jade = {
        "type": "heterogeneous",
        "sigma_t": grid(noise(8, (3, 3, 3, 1), 0.5, 1.0), place @ UNIT_TO_CUBE),
        "scale": 5.0,
        "albedo": grid(noise(9, (2, 3, 2, 3), 0.5, 0.95), place @ UNIT_TO_CUBE),
    }
    glass = {"type": "roughdielectric", "int_ior": 1.3, "ext_ior": 1.0}
    return ReferenceScene(
        _scene(
            _volpath(16),
            view(),
            ball={
                "type": "sphere",
                "center": [-0.9, -0.2, 0.4],
                "radius": 0.6,
                "bsdf": {**glass, "distribution": "ggx", "alpha": 0.2},
                "interior": milk,
            },
            block={
                "type": "cube",
                "to_world": place,
                "bsdf": {**glass, "distribution": "beckmann", "alpha": 0.1},
                "interior": jade,
            },
            floor={"type": "rectangle", "to_world": FLOOR, "bsdf": _diffuse(0.5)},
            sky={"type": "envmap", "data": noise(10, (4, 8, 3), 0.1, 1.5), "to_world": rotate("y", 70)},
        ),
        (
            "ball.interior_medium.albedo.value.value",
            "block.interior_medium.albedo.data",
            "floor.bsdf.reflectance.value",
            "sky.data",
        ),
    )


def _phases() -> ReferenceScene:
    """Balls of one extinction that scatter in four ways, by a point light behind them and a dim sky."""
    kinds = {
        "rayleigh": {"type": "rayleigh"},
        "table": {"type": "tabphase", "values": "0.5, 0.2, 0.1, 0.4, 1.0, 3.0"},
        "blend": {
            "type": "blendphase",
            "weight": 0.3,
            "first": {"type": "hg", "g": 0.8},
            "second": {"type": "rayleigh"},
        },
        "same": {"type": "isotropic"},
    }
    balls = {}
    for i, (name, phase) in enumerate(kinds.items()):
        medium = {"type": "homogeneous", "sigma_t": 1.5, "albedo": _rgb(0.9, 0.8, 0.6), "phase": phase}
        at = translate(-0.6 + 1.2 * (i % 2), -0.6 + 1.2 * (i // 2), 0) @ scale(0.5)
        balls[name] = boundary(medium, at, "sphere")
    return ReferenceScene(
        _scene(
            _volpath(6),
            view((0, 0, 4)),
            **balls,
            lamp={"type": "point", "position": [0.5, 1.5, -2.0], "intensity": _rgb(9.0, 8.0, 6.0)},
            sky={"type": "constant", "radiance": 0.1},
        )
    )


SCENES = {
    "cloud": _cloud,
    "voxels": _voxels,
    "smooth": _smooth,
    "fog": _fog,
    "coloured": _coloured,
    "nested": _nested,
    "frosted": _frosted,
    "phases": _phases,
}

__all__ = ["SCENES", "SIZE", "boundary", "grid", "look_at", "noise", "rotate", "scale", "translate", "view"]
