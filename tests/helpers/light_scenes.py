"""Scenes for the tests of light tracing: lamps of every kind over diffuse surfaces, and what light meets on its way.

In the views of `room` everything that is seen is diffuse or rough; in those of `floor_view` nothing is seen but the
floor, so that mirrors and glass may hang above it: what is seen in them is the particle tracer's blind spot.
"""

from __future__ import annotations

import math
from typing import Any

import torch

import torchrender as tr

T = tr.Transform
RGB = {"type": "rgb", "value": [0.7, 0.3, 0.5]}


def texels(height: int, width: int, factor: float = 1.0, seed: int = 1) -> dict[str, Any]:
    """A bitmap of random numbers in [0, factor)."""
    data = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed)) * factor
    return {"type": "bitmap", "data": data, "raw": True}


def film(size: int = 8, rfilter: str = "gaussian", **more: Any) -> dict[str, Any]:
    """A film that light beyond its edge reaches, as it does in light tracing."""
    more = {"sample_border": True, **more}
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}, **more}


def camera(**film_settings: Any) -> dict[str, Any]:
    """Sees the room."""
    to_world = T.look_at([0.3, -0.2, 4.2], [0, 0, 0], [0, 1, 0])
    return {"type": "perspective", "fov": 50, "to_world": to_world, "film": film(**film_settings)}


def close_camera(fov: float = 25, **film_settings: Any) -> dict[str, Any]:
    """Sees a part of the floor, from below what hangs over it."""
    to_world = T.look_at([0.3, -0.1, 1.0], [0, -1, 0], [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": to_world, "film": film(**film_settings)}


def facing_down(x: float, y: float, z: float) -> tr.Transform:
    """Where lamps hang."""
    return T.translate([x, y, z]) @ T.rotate([1, 0, 0], 90)


def area(kind: str = "area", radiance: Any = None) -> dict[str, Any]:
    """A rectangle that shines down, of textured radiance unless told."""
    emitter = {"type": kind, "radiance": texels(4, 5, 4.0) if radiance is None else radiance}
    return {"type": "rectangle", "to_world": facing_down(0.2, 1.1, 0.3) @ T.scale([0.5, 0.3, 1]), "emitter": emitter}


def beam(radiance: Any = None, degrees: float = 85) -> dict[str, Any]:
    """A rectangle of 1.4 x 1.2 that sends a beam down, a little tilted unless told."""
    to_world = T.translate([0.1, 1.2, 0.1]) @ T.rotate([1, 0, 0], degrees) @ T.scale([0.7, 0.6, 1])
    emitter = {"type": "directionalarea", "radiance": texels(4, 5, 4.0) if radiance is None else radiance}
    return {"type": "rectangle", "to_world": to_world, "emitter": emitter}


def ball_light(radiance: Any = None) -> dict[str, Any]:
    radiance = {"type": "rgb", "value": [3, 4, 5]} if radiance is None else radiance
    emitter = {"type": "area", "radiance": radiance}
    return {"type": "sphere", "center": [0.3, 0.9, 0.2], "radius": 0.25, "emitter": emitter}


def point_light() -> dict[str, Any]:
    return {"type": "point", "position": [0.2, 1.1, 0.9], "intensity": {"type": "rgb", "value": [3, 4, 5]}}


def spot() -> dict[str, Any]:
    """Down, at an angle, with an image."""
    return {
        "type": "spot",
        "intensity": {"type": "rgb", "value": [3, 4, 5]},
        "cutoff_angle": 60,
        "beam_width": 20,
        "texture": {**texels(4, 5), "wrap_mode": "clamp"},
        "to_world": T.look_at([0.2, 1.1, 0.9], [0.3, -1, 0.2], [0, 0, 1]),
    }


def projector(fov: float = 100) -> dict[str, Any]:
    """Down, at an angle."""
    to_world = T.look_at([0.2, 1.1, 0.4], [0.3, -1, 0.2], [0, 0, 1])
    image = {**texels(4, 5, 2.0), "wrap_mode": "clamp"}
    return {"type": "projector", "irradiance": image, "scale": 0.8, "fov": fov, "to_world": to_world}


def sun() -> dict[str, Any]:
    return {"type": "directional", "irradiance": {"type": "rgb", "value": [3, 4, 5]}, "direction": [0.3, -2, -0.5]}


def envmap() -> dict[str, Any]:
    data = 0.2 + texels(8, 16, seed=3)["data"] ** 2 * 2
    return {"type": "envmap", "data": data, "to_world": T.rotate([0, 1, 0], 40)}


def mesh_light() -> tr.Mesh:
    """A ball of 80 triangles of different sizes."""
    vertices, faces = icosphere(1)
    vertices = vertices * torch.tensor([0.3, 0.15, 0.2]) + torch.tensor([0.3, 0.9, 0.2])
    return tr.Mesh(vertices, faces, emitter={"type": "area", "radiance": {"type": "rgb", "value": [3, 4, 5]}})


def icosphere(subdivisions: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices of length 1 (V, 3), faces (F, 3)."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    return torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces, dtype=torch.int32)


def blob(bsdf: dict[str, Any]) -> tr.Mesh:
    """A coarse ball with interpolated normals."""
    vertices, faces = icosphere(1)
    return tr.Mesh(vertices * 0.5 + torch.tensor([0.2, -0.3, 0.2]), faces, vertex_normals=vertices, bsdf=bsdf)


def slab(bsdf: dict[str, Any]) -> dict[str, Any]:
    """A plate 0.1 thick under the lamps."""
    return {"type": "cube", "to_world": T.translate([0.2, 0.5, 0.3]) @ T.scale([0.8, 0.05, 0.8]), "bsdf": bsdf}


def room(sensor: dict[str, Any] | None = None, **objects: Any) -> dict[str, Any]:
    """A textured floor at y = -1 and a two-sided wall behind it."""
    back = {"type": "twosided", "brdf": {"type": "diffuse", "reflectance": RGB}}
    return {
        "type": "scene",
        "camera": sensor or camera(),
        "floor": {
            "type": "rectangle",
            "to_world": T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale(1.5),
            "bsdf": {"type": "diffuse", "reflectance": texels(4, 5)},
        },
        "back": {"type": "rectangle", "to_world": T.translate([0, 0, -1.2]) @ T.scale(1.6), "bsdf": back},
        **objects,
    }


def floor(half: float = 3.0, **more: Any) -> dict[str, Any]:
    """A rectangle at y = -1 that faces up; u goes along x, v along -z."""
    return {
        "type": "rectangle",
        "to_world": T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale([half, half, 1]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.6, 0.7]}},
        **more,
    }


def floor_view(sensor: dict[str, Any] | None = None, **objects: Any) -> dict[str, Any]:
    return {"type": "scene", "camera": sensor or close_camera(), "floor": floor(), **objects}


def metered(height: int = 6, width: int = 8, half: float = 3.0, **objects: Any) -> dict[str, Any]:
    """A floor that measures what arrives on it; there is no camera."""
    meter = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": width, "height": height}}
    return {"type": "scene", "floor": floor(half, meter=meter), **objects}


def wavy_sheet(
    bsdf: dict[str, Any] | None = None, n: int = 24, amplitude: float = 0.05, normals: bool = True, **settings: Any
) -> tr.Mesh:
    """One wavy surface between lamps and floor, smooth glass unless told, of n x n vertices in double precision."""
    line = torch.linspace(-1, 1, n, dtype=torch.float64)
    u, v = torch.meshgrid(line, line, indexing="ij")
    height = 0.3 + amplitude * torch.sin(3 * u) * torch.cos(4 * v)
    index = torch.arange(n * n).reshape(n, n)
    first = torch.stack([index[:-1, :-1], index[:-1, 1:], index[1:, :-1]], -1).reshape(-1, 3)
    second = torch.stack([index[1:, 1:], index[1:, :-1], index[:-1, 1:]], -1).reshape(-1, 3)
    mesh = tr.Mesh(
        torch.stack([1.2 * u, height, 1.2 * v], -1).reshape(-1, 3),
        torch.cat([first, second]).int(),
        bsdf=bsdf or {"type": "dielectric"},
        **settings,
    )
    if normals:
        mesh.compute_normals()
    return mesh


def wave(n: int = 24) -> torch.Tensor:
    """A smooth change of the heights of `wavy_sheet`, (n * n, 3)."""
    line = torch.linspace(-1, 1, n, dtype=torch.float64)
    u, v = torch.meshgrid(line, line, indexing="ij")
    return torch.stack([0 * u, torch.cos(2 * u + v), 0 * u], -1).reshape(-1, 3)


def fresnel(cosine: float, eta: float) -> float:
    """Reflectance of unpolarised light that meets a surface of relative index `eta` (transmitted over incident side).

    Total reflection is 1.
    """
    sine2 = (1 - cosine * cosine) / (eta * eta)
    if sine2 >= 1:
        return 1.0
    inner = math.sqrt(1 - sine2)
    s = (cosine - eta * inner) / (cosine + eta * inner)
    p = (eta * cosine - inner) / (eta * cosine + inner)
    return (s * s + p * p) / 2
