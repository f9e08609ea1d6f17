"""Rims of interpolated normals, beyond which these look away from the camera: they turn black at once what is seen.

Coarse balls with the normals of a sphere, so that the rims are wide and far from the silhouettes. The statistical tests
are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import pytest
import torch
import trimesh
from moving_suites import both_modes, by_theta, check, derivative, diffuse, glowing, moved, weighted

import torchrender as tr
from torchrender.visibility.boundary_call import placing_slots

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

DOUBLE = torch.float64
T = tr.Transform
FROM_HERE = T.look_at([0.3, 0.5, 4], [0, 0, 0], [0, 1, 0])
SKY = {"type": "constant", "radiance": 0.5}
EYES = {
    "perspective": {"type": "perspective", "fov": 40, "to_world": FROM_HERE},
    "thin lens": {
        "type": "thinlens",
        "fov": 40,
        "aperture_radius": 0.2,
        "focus_distance": 3.0,
        "to_world": FROM_HERE,
    },
    "orthographic": {"type": "orthographic", "to_world": FROM_HERE @ T.scale([1.4, 1.4, 1])},
}


def ball(**more) -> tr.Mesh:
    """Of 80 triangles, some of the normals of which turn faster than others."""
    mesh = trimesh.creation.icosphere(1)
    normals = mesh.vertices * [1.0, 1.3, 0.8]
    return tr.Mesh(mesh.vertices, mesh.faces, vertex_normals=normals, **more)


def film_of(size: int, rfilter: str = "box") -> dict:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": rfilter}, "sample_border": True}


def scene_of(camera: dict, film: dict, **objects) -> tr.Scene:
    path = {"type": "path", "max_depth": 2}
    described = {"type": "scene", "integrator": path, "camera": {**camera, "film": film}, **objects}
    return tr.load_dict(described, dtype=DOUBLE)


def directions(scene: tr.Scene, what: tuple[str, ...]) -> dict[str, torch.Tensor]:
    """The ball shifts and grows, its normals turn, the camera moves and turns."""
    found = {}
    for name in what:
        value = scene.get_parameter(name).detach()
        if name == "ball.vertex_positions":
            found[name] = 0.2 * value + torch.tensor([0.6, 0.3, 0.2])
        elif name == "ball.vertex_normals":
            found[name] = torch.linalg.cross(value, torch.tensor([0.7, -0.9, 0.5], dtype=DOUBLE).expand_as(value))
        else:
            found[name] = torch.zeros_like(value)
            found[name][:3, 3] = torch.tensor([0.5, -0.3, 0.4])
            turn = torch.tensor([[0, 0.1, 0.05], [-0.1, 0, 0.1], [-0.05, -0.1, 0]], dtype=DOUBLE)
            found[name][:3, :3] = value[:3, :3] @ turn
    return found


GLOWING = {"emitter": glowing(1.0)}
CASES = {
    "a ball that shines": ("perspective", {"ball": GLOWING}, ("ball.vertex_positions",)),
    "its normals": ("perspective", {"ball": GLOWING}, ("ball.vertex_normals",)),
    "the camera": ("perspective", {"ball": GLOWING, "sky": SKY}, ("camera.to_world",)),
    "everything, through a lens": (
        "thin lens",
        {"ball": GLOWING},
        ("ball.vertex_positions", "ball.vertex_normals", "camera.to_world"),
    ),
    "everything, in parallel": (
        "orthographic",
        {"ball": GLOWING},
        ("ball.vertex_positions", "ball.vertex_normals", "camera.to_world"),
    ),
}


def made(name: str, size: int = 24) -> tuple[tr.Scene, dict[str, torch.Tensor]]:
    camera, objects, what = CASES[name]
    objects = {**objects, "ball": ball(**objects["ball"])}
    scene = scene_of(EYES[camera], film_of(size), **objects)
    return scene, directions(scene, what)


@pytest.mark.parametrize("name", CASES)
def test_against_differences(name):
    scene, moves = made(name)
    scene = scene.to(torch.float32)  # packets take a fifth of the time
    samples = {"differences_spp": 1024, "seeds": 8, "spp_visibility": (64, 16)}
    if name == "its normals":  # where they turn alone nearly all cancels
        samples = {"differences_spp": 4096, "seeds": 8, "spp_visibility": (128, 16)}
    check(*by_theta(scene, moves, spp=64, step=0.01, **samples), 0.02, len(CASES) + 1)


@pytest.mark.parametrize("name", CASES)
def test_forward_mode_is_reverse_mode(name):
    scene, moves = made(name, 8)

    def f(theta):
        return weighted(tr.render(scene, spp=4, seed=3, params=moved(scene, moves, theta)))

    forward, reverse = both_modes(f)
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert abs(reverse) > 1e-3


def test_everything_together_is_at_rest():
    """A camera that follows the ball sees the same; each sample by itself says so."""
    scene, _ = made("everything, through a lens")
    shift = torch.tensor([0.5, -0.2, 0.3], dtype=DOUBLE)
    moves = {"ball.vertex_positions": shift.expand_as(scene.get_parameter("ball.vertex_positions"))}
    alone = dict(moves)
    moves["camera.to_world"] = torch.zeros(4, 4, dtype=DOUBLE)
    moves["camera.to_world"][:3, 3] = shift

    def f(theta, moves):
        return weighted(tr.render(scene, spp=16, seed=1, params=moved(scene, moves, theta)))

    assert abs(derivative(f, moves=moves)) < 1e-9 * abs(derivative(f, moves=alone))


def test_only_meshes_have_normals_that_turn():
    """Those of a grid of distances are a choice, whose number is no slot."""
    grid = {"type": "sdfgrid", "grid": torch.ones(2, 2, 2, 1), "normals": "analytic"}
    layout = scene_of(EYES["perspective"], film_of(4), grid=grid, ball=ball()).layout()
    found = {kind: [layout.slots[n].name for n in normals] for kind, _, normals in placing_slots(layout, "shape")}
    assert found == {"sdfgrid": [], "mesh": ["ball.vertex_normals"]}


def test_light_tracing_has_them():
    """Light that a ball reflects towards the camera: the path tracer's derivative."""
    lamp = {"type": "point", "position": [1.5, 2.0, 3.0], "intensity": 20.0}
    scene = scene_of(EYES["perspective"], film_of(12, "gaussian"), ball=ball(bsdf=diffuse(0.7)), lamp=lamp)
    moves = directions(scene, ("ball.vertex_positions",))

    def f(theta, **settings):
        return weighted(tr.render(scene, params=moved(scene, moves, theta), spp=1, spp_visibility=(64, 16), **settings))

    def derivatives(integrator, spp):
        return torch.tensor([derivative(f, integrator=integrator, spp_grad=spp, seed=seed) for seed in range(8)])

    check(derivatives(tr.ParticleTracer(2, 99), 1024), derivatives(tr.PathTracer(2, 99), 256), 0.03, len(CASES) + 1)
