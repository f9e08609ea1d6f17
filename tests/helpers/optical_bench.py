"""An optical bench: known light by way of surfaces to a camera, and the Mueller matrix that follows."""

from __future__ import annotations

import math

import torch

import torchrender as tr

T = tr.Transform
TURN = T.rotate([1, 2, 3], 40)  # of everything, so that nothing is right because of the axes of the world
# what stands before the lamp: states that together say everything
LIGHT: dict[str, tuple[dict, ...]] = {
    "unpolarised": (),
    "horizontal": ({"type": "polarizer"},),
    "diagonal": ({"type": "polarizer", "theta": 45.0},),
    "circular": ({"type": "circular"},),
}


def _towards(angle: float) -> list[float]:
    """From +z by an angle in degrees towards +y."""
    return [0.0, math.sin(math.radians(angle)), math.cos(math.radians(angle))]


def _square(angle: float, distance: float, size: float, center=(0.0, 0.0, 0.0), **more) -> dict:
    """A square that faces the centre, from the direction of that angle."""
    place = [c + distance * x for c, x in zip(center, _towards(angle), strict=True)]
    return {"type": "rectangle", "to_world": T.look_at(place, center, _towards(angle + 90)) @ T.scale(size), **more}


def bench(light: str, out: float, camera: float | None = None, *, center=(0.0, 0.0, 0.0), **surfaces: dict) -> tr.Scene:
    """Surfaces at the origin, lit by a lamp that stands at an angle of `out` degrees from +z as seen from `center`.

    Args:
        light: of `LIGHT`.
        camera: the angle on the other side of +z under which the origin is seen; None: the lamp is seen, from there.
            The camera's horizontal is across this plane.
    """
    lamp = _square(out, 3, 0.1, center, emitter={"type": "area", "radiance": 1.0})
    plates = {f"plate{i}": _square(out, 2 + 0.1 * i, 0.5, center, bsdf=p) for i, p in enumerate(LIGHT[light])}
    pose = T.look_at([0, 0, 0], _towards(out), _towards(out + 90))
    if camera is not None:
        pose = T.look_at(_towards(-camera), [0, 0, 0], _towards(90 - camera))
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 1e-6, "near_clip": 1e-3, "to_world": pose, "film": film}
    objects = {"sensor": sensor, "lamp": lamp, **plates, **surfaces}
    turned = {name: {**o, "to_world": TURN @ o["to_world"]} for name, o in objects.items()}
    integrator = {"type": "path", "max_depth": 9, "rr_depth": 100}
    return tr.load_dict({"type": "scene", "integrator": integrator, **turned}, dtype=torch.float64)


def under_sky(angle: float, bsdf: dict, **more) -> tr.Scene:
    """A plane seen at an angle of incidence in degrees, under a sky of radiance 1; the camera's axis is horizontal."""
    a = math.radians(angle)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    pose = T.look_at([0, -4 * math.sin(a), 4 * math.cos(a)], [0, 0, 0], [0, 0, 1])
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {"type": "perspective", "fov": 1e-3, "to_world": pose, "film": film},
            "sky": {"type": "constant"},
            "plane": {"type": "rectangle", "to_world": T.scale(1000), "bsdf": bsdf},
            **more,
        },
        dtype=torch.float64,
    )


def surface(bsdf: dict, **more) -> dict:
    return {"type": "rectangle", "to_world": T.scale(50), "bsdf": bsdf, **more}


def stokes(scene: tr.Scene, spp: int = 1, **settings) -> torch.Tensor:
    return tr.render(scene, spp=spp, seed=0, outputs=("stokes",), **settings).stokes[0, 0, 0]


def mueller(camera: float, out: float, spp: int = 1, center=(0.0, 0.0, 0.0), **surfaces: dict) -> torch.Tensor:
    """The matrix (4, 4) of surfaces, of which a part of all samples goes to the lamp: up to that factor."""
    states = [stokes(bench(light, out, camera, center=center, **surfaces), spp) for light in LIGHT]
    lit = [stokes(bench(light, out)) for light in LIGHT]
    return torch.linalg.solve(torch.stack(lit), torch.stack(states)).T
