"""Scenes with edges that move, whose derivatives on the emulated device are those of the CPU in the same tree.

Both take the same samples and rays, so that derivatives differ by the order of sums alone.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch
from emulated import RAYS, check_close

import torchrender as tr

T = tr.Transform
GREY = {"type": "diffuse", "reflectance": 0.6}
ABOVE = T.look_at([0.5, 3, 1], [0, 0, 0], [0, 0, 1])
FLOOR = {"type": "rectangle", "to_world": T.translate([0, -0.9, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale(3)}
LIGHTS: dict[str, dict[str, Any]] = {
    "lamp": {"type": "rectangle", "to_world": ABOVE @ T.scale(0.7), "emitter": {"type": "area", "radiance": 10.0}},
    "bulb": {"type": "sphere", "center": [1, 2.5, 1], "radius": 0.2, "emitter": {"type": "area", "radiance": 30.0}},
    "sky": {"type": "constant"},
    "point": {"type": "point", "position": [0.5, 3, 1], "intensity": 20.0},
    "sun": {"type": "directional", "direction": [-0.3, -1, -0.2], "irradiance": 3.0},
    "spot": {"type": "spot", "to_world": ABOVE, "intensity": 30.0, "cutoff_angle": 40.0},
}
POSITIONS = "ball.vertex_positions"


def crumpled_ball(dtype: torch.dtype, smooth: bool = False, subdivisions: int = 2, **given: Any) -> tr.Mesh:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices = 0.8 * torch.tensor(ball.vertices, dtype=dtype)
    noise = 0.2 / 2**subdivisions * torch.randn(len(vertices), 1, generator=torch.Generator().manual_seed(1))
    mesh = tr.Mesh(vertices * (1 + noise.to(dtype)), torch.tensor(ball.faces), **{"bsdf": GREY, **given})
    if smooth:
        mesh.compute_normals()
    return mesh


def scene_of(dtype: torch.dtype = torch.float32, camera: dict[str, Any] | None = None, **objects: Any) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 20, "height": 20, "rfilter": {"type": "gaussian"}}
    to_world = T.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
    view = {"type": "perspective", "fov": 40, "to_world": to_world, "film": film, **(camera or {})}
    return tr.load_dict({"type": "scene", "camera": view, "floor": {**FLOOR, "bsdf": GREY}, **objects}, dtype=dtype)


def check(
    device,
    scene: tr.Scene,
    *names: str,
    parts: int = 3,
    counted: bool = True,
    outputs: tuple[str, ...] = ("rgb",),
    **settings: Any,
) -> None:
    """In both modes, with as many rays of each of so many parts.

    Args:
        parts: that have rays.
        counted: those of edges are, which pass nothing: where some do, the CPU traces all again.
        outputs: which the derivative is of.
    """
    scene.train_only(*names)
    parameters = {name: scene.get_parameter(name) for name in names}
    settings = {"integrator": tr.PathTracer(max_depth=4), "spp": 1, "spp_grad": 4, "outputs": outputs, **settings}
    values = tuple(p.detach() for p in parameters.values())
    generator = torch.Generator().manual_seed(1)
    tangents = tuple(torch.randn(v.shape, generator=generator, dtype=v.dtype) for v in values)
    statistics = "visibility" if outputs == ("rgb",) else "visibility_outputs"

    def image(*given: torch.Tensor) -> torch.Tensor:
        of = dict(zip(names, given, strict=True))
        return torch.cat([x.flatten() for x in tr.render(scene, params=of, seed=3, **settings)])

    found = []
    for place in ("tree", "emulated"):
        device(place)
        seen = image(*parameters.values())
        weights = torch.linspace(0.5, 1.5, seen.numel(), dtype=seen.dtype)
        of = dict(zip(names, torch.autograd.grad(seen, list(parameters.values()), weights), strict=True))
        told = scene.statistics[statistics]
        rays = {part: told[part]["rays"] for part in told}
        assert all(rays[part] > 0 for part in rays if part != "pilot") and len(rays.keys() - {"pilot"}) == parts
        of_paths = {name: scene.statistics["vjp"][name] for name in RAYS} if outputs == ("rgb",) else {}
        of["forward"] = torch.func.jvp(image, values, tangents)[1]
        found.append((of, rays, of_paths))
    check_close(found[1][0], found[0][0])
    assert found[1][2] == found[0][2]
    assert not counted or found[1][1] == found[0][1]
