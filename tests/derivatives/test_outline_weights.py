"""What samples of outlines that lights and vertices see weigh: none of them as much as thousands of others.

Of a sample the core tells the square of what it adds to the film where its outline moves by 1; it works on 64 of them
together. Numbers of samples and seeds are fixed; limits are 1.3 times what was found or more, and at most half of what
is found without what is tested.
"""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr
from torchrender.visibility.outlines import Outlines

trimesh = pytest.importorskip("trimesh")
pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

T = tr.Transform
GREY = {"type": "diffuse", "reflectance": 0.6}
LAMP = {
    "type": "rectangle",
    "to_world": T.translate([0, 3, 1]) @ T.rotate([1, 0, 0], 90) @ T.scale(0.7),
    "emitter": {"type": "area", "radiance": 10.0},
}
SKY = {"type": "constant"}


def scene_of(depth: int, **objects) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
    to_world = T.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
    camera = {"type": "perspective", "fov": 40, "to_world": to_world, "film": film}
    return tr.load_dict(
        {"type": "scene", "integrator": {"type": "path", "max_depth": depth}, "camera": camera, **objects}
    )


def crumpled_ball(noise: float, smooth: bool) -> tr.Mesh:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = 0.8 * torch.tensor(ball.vertices, dtype=torch.float32)
    vertices *= 1 + noise * torch.randn(len(vertices), 1, generator=torch.Generator().manual_seed(1))
    mesh = tr.Mesh(vertices, torch.tensor(ball.faces), bsdf=GREY)
    if smooth:
        mesh.compute_normals()
    return mesh


def weights(monkeypatch, scene: tr.Scene, moved: str, *parts: str, seed: int = 3, count: int = 1 << 18) -> torch.Tensor:
    """What each sample of these parts adds, times their number: (parts, count)."""
    found = torch.zeros(len(parts), count, dtype=torch.float64)

    def look(self: Outlines, *_: object) -> None:
        numbers = {"first": 0, "count": count, "total": count, "samples": count, "weighs": 1}
        for part, value in zip(parts, found, strict=True):
            self._look(part, numbers, {"value": value.data_ptr()})

    monkeypatch.setattr(Outlines, "reverse", look)
    value = scene.get_parameter(moved).detach().clone().requires_grad_()
    tr.render(scene, spp=1, spp_grad=8, seed=seed, params={moved: value}).mean().backward()
    return found.sqrt() * count


def second_moment(x: torch.Tensor) -> float:
    return float(x.square().mean(1).sum())


def test_light_that_grazes_interpolated_normals(monkeypatch):
    """Light finds a place where it grazes a face seldom, and weighs one over the cosine there if the normals do not."""
    scene = scene_of(2, ball=crumpled_ball(0.05, smooth=True), light=LAMP)
    x = weights(monkeypatch, scene, "ball.vertex_positions", "shadows", "reflections")
    assert math.sqrt(second_moment(x)) < 60 * float(x.mean(1).sum())


def test_vertices_share_the_edges_that_are_left(monkeypatch):
    """Under a sky there is nothing past most edges of an object; what the vertices of all paths see of the others."""
    ball = crumpled_ball(0.2, smooth=False)
    camera, both = (
        second_moment(weights(monkeypatch, scene_of(depth, ball=ball, light=SKY), "ball.vertex_positions", "shadows"))
        for depth in (2, 4)
    )
    assert camera < both < 2.2 * camera


def test_light_comes_from_where_a_surface_is_seen_from(monkeypatch):
    """Normals that point into a surface do not turn its sides: what counts is on the side that is seen."""
    floor = torch.tensor([[-2.0, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]])
    normals = torch.tensor([[0.0, -0.2, 0.98]]).expand(4, 3).contiguous()
    mesh = tr.Mesh(floor, torch.tensor([[0, 2, 1], [0, 3, 2]]), vertex_normals=normals, bsdf=GREY)

    def square(y: float) -> dict:
        return {"type": "rectangle", "to_world": T.translate([0, y, 1]) @ T.scale(0.3), "bsdf": GREY}

    def found(**more) -> float:
        scene = scene_of(2, floor=mesh, square=square(0.5), light=SKY, **more)
        return second_moment(weights(monkeypatch, scene, "square.to_world", "reflections", count=1 << 16))

    plate = {"type": "rectangle", "to_world": T.translate([0, -0.2, 0]) @ T.rotate([1, 0, 0], 90) @ T.scale(3)}
    hidden = {f"hidden_{i}": square(-0.3 - 0.02 * i) for i in range(16)}
    assert found(**hidden, plate=plate) < 1.5 * found(plate=plate)
