"""Shadows and reflected light of things that move: closed forms, differences under every light, invariants.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from moving_differences import agrees, compare
from shadow_scenes import DOWN, LIGHTS, diffuse, room

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

DOUBLE = torch.float64
CASES = 40  # statistical tests in this file, at most
T = tr.Transform
ALBEDO = 0.5


# ------------------------------------------------------------------------------------------------------ closed forms
def above_a_floor(window: float, height: float, size: int = 16, **objects) -> tr.Scene:
    """A floor, of which a parallel camera sees a square of this half side from a height that all objects are above."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    matrix = T.look_at([0, 0, height], [0, 0, 0], [0, 1, 0]) @ T.scale([window, window, 1])
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "camera": {"type": "orthographic", "to_world": matrix, "film": film},
            "floor": {"type": "rectangle", "to_world": T.scale(20), "bsdf": {"type": "diffuse", "reflectance": ALBEDO}},
            **objects,
        },
    )


def gradients(scene: tr.Scene, *names: str, spp: int = 1024, seeds: int = 4) -> dict[str, torch.Tensor]:
    """Of the mean of the image."""
    leaves = scene.train_only(*names)
    total = [torch.zeros_like(leaf) for leaf in leaves]
    for seed in range(seeds):
        image = tr.render(scene, spp=spp, seed=seed, spp_visibility=spp)[..., 0].mean()
        for sum_, part in zip(total, torch.autograd.grad(image, leaves)):
            sum_ += part / seeds
    return dict(zip(names, total))


def test_the_shadow_of_a_half_plane_in_the_light_of_a_point():
    """It ends at s = x + (e - x) H / (H - h), and is dark beyond."""
    x, top, edge, h, half = 0.2, 3.0, -0.1, 1.2, 0.8
    plate = T.translate([edge + 5, 0, h]) @ T.scale([5, 5, 1])
    scene = above_a_floor(
        half,
        0.9,
        plate={"type": "rectangle", "to_world": plate, "bsdf": diffuse(0.0)},
        lamp={"type": "point", "position": [x, 0, top], "intensity": 4.0},
    )
    found = gradients(scene, "plate.to_world")["plate.to_world"]
    s = x + (edge - x) * top / (top - h)
    b2 = (s - x) ** 2 + top**2
    along = ALBEDO / math.pi * 4 * top * 2 * half / (b2 * math.sqrt(half**2 + b2)) / (2 * half) ** 2
    assert float(found[0, 3]) == pytest.approx(along * top / (top - h), rel=1e-2)
    assert float(found[2, 3]) == pytest.approx(along * (edge - x) * top / (top - h) ** 2, rel=3e-2)


def test_the_shadow_of_a_sphere_in_the_sun():
    """Its area is pi R^2 / cos: it takes E rho R^2 from the floor, wherever the sun stands."""
    radius, irradiance, half = 0.4, 3.0, 2.0
    scene = above_a_floor(
        half,
        1.0,
        ball={"type": "sphere", "center": [-0.5, 0.1, 2], "radius": radius, "bsdf": diffuse(0.0)},
        sun={"type": "directional", "direction": [0.4, 0.1, -1], "irradiance": irradiance},
    )
    found = gradients(scene, "ball.radius", "ball.center")
    assert float(found["ball.radius"]) == pytest.approx(-2 * ALBEDO * irradiance * radius / (2 * half) ** 2, rel=1e-2)
    assert float(found["ball.center"].abs().max()) < 2e-3


@pytest.mark.parametrize("occluder", ["disk", "mesh"])
def test_a_disk_before_a_disk(occluder):
    """E = pi L (a^2 / (a^2 + H^2) - b^2 / (b^2 + h^2)) on the axis, by both radii and all heights."""
    a, b, top, h, radiance = 0.8, 0.3, 2.0, 1.1, 2.0
    plate: object = {"type": "disk", "to_world": T.translate([0, 0, h]) @ T.scale(b), "bsdf": diffuse(0.0)}
    if occluder == "mesh":
        angle = torch.arange(128) * (2 * math.pi / 128)
        rim = torch.stack([angle.cos() * b, angle.sin() * b, torch.full_like(angle, h)], 1)
        vertices = torch.cat([torch.tensor([[0.0, 0.0, h]]), rim]).numpy()
        faces = [[0, 1 + i, 1 + (i + 1) % 128] for i in range(128)]
        plate = tr.Mesh(vertices, faces)
        plate.bsdf = diffuse(0.0)
    scene = above_a_floor(
        1e-3,
        0.05,
        size=2,
        plate=plate,
        lamp={
            "type": "disk",
            "to_world": T.translate([0, 0, top]) @ DOWN @ T.scale(a),
            "emitter": {"type": "area", "radiance": radiance},
        },
    )
    names = ["plate.vertex_positions" if occluder == "mesh" else "plate.to_world", "lamp.to_world", "floor.to_world"]
    found = gradients(scene, *names, spp=2048)
    factor = ALBEDO * radiance
    by_a, by_b = factor * 2 * a * top**2 / (a**2 + top**2) ** 2, -factor * 2 * b * h**2 / (b**2 + h**2) ** 2
    by_top, by_h = -factor * 2 * a**2 * top / (a**2 + top**2) ** 2, factor * 2 * b**2 * h / (b**2 + h**2) ** 2
    plate_, lamp, floor = found.values()
    if occluder == "mesh":
        radial = scene.plate.vertex_positions.detach() / b
        assert float((plate_[:, :2] * radial[:, :2]).sum()) == pytest.approx(by_b, rel=2e-2)
        assert float(plate_[:, 2].sum()) == pytest.approx(by_h, rel=3e-2)
    else:
        assert float(plate_[0, 0] + plate_[1, 1]) == pytest.approx(by_b, rel=2e-2)
        assert float(plate_[2, 3]) == pytest.approx(by_h, rel=3e-2)
    grown = lamp[:3, :3] * (scene.lamp.to_world.detach()[:3, :3] / a)
    assert float(grown[:, :2].sum()) == pytest.approx(by_a, rel=2e-2)
    assert float(lamp[2, 3]) == pytest.approx(by_top, rel=2e-2)
    assert float(floor[2, 3]) == pytest.approx(-by_h - by_top, abs=5e-3)  # they nearly cancel


def test_a_sphere_under_the_sky():
    """Wholly above the horizon it takes pi L (R / D)^2 cos from what arrives."""
    centre, radius, sky = torch.tensor([0.4, -0.3, 1.2], dtype=DOUBLE), 0.5, 1.5
    scene = above_a_floor(
        1e-3,
        0.05,
        size=2,
        ball={"type": "sphere", "center": centre.tolist(), "radius": radius, "bsdf": diffuse(0.0)},
        sky={"type": "constant", "radiance": sky},
    )
    found = gradients(scene, "ball.radius", "ball.center", "floor.to_world", spp=2048)
    place = centre.clone().requires_grad_()
    size = torch.tensor(radius, dtype=DOUBLE, requires_grad=True)
    taken = -ALBEDO * sky * size**2 * place[2] / place.norm() ** 3
    by_centre, by_radius = torch.autograd.grad(taken, (place, size))
    assert float(found["ball.radius"]) == pytest.approx(float(by_radius), rel=2e-2)
    torch.testing.assert_close(found["ball.center"].double(), by_centre, rtol=3e-2, atol=5e-3)
    assert float(found["floor.to_world"][2, 3]) == pytest.approx(-float(by_centre[2]), rel=3e-2)


# ------------------------------------------------------------------------------------------------------- differences
def check(scene: tr.Scene, parameter: str, spp: int = 256, step: float = 5e-3, rtol: float = 0.02) -> None:
    # (in single precision, whose packets take a fifth of the time)
    derivatives, differences = compare(scene.to(torch.float32), parameter, 6, spp, step)
    passed, text = agrees(derivatives, differences, rtol, CASES)
    assert passed, f"{parameter}: {text}"
    assert float(differences.abs().mean()) > 1e-4


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("parameter", ["box.vertex_positions", "plate.to_world", "camera.to_world"])
def test_direct_light(light, parameter):
    check(room(light), parameter)


@pytest.mark.parametrize(
    ("light", "parameter"),
    [("rectangle", "lamp.to_world"), ("ball", "lamp.radius"), ("point", "lamp.position"), ("spot", "lamp.to_world"),
     ("sun", "lamp.to_world"), ("rectangle", "floor.to_world"), ("point", "floor.to_world")],
)  # fmt: skip
def test_lights_and_receivers_that_move(light, parameter):
    check(room(light), parameter)


@pytest.mark.parametrize("light", ["rectangle", "point", "sky"])
def test_reflected_light(light):
    check(room(light, 4), "box.vertex_positions", spp=512)


def test_blends_are_chosen_from_apart_at_every_vertex():
    half = {"type": "blendbsdf", "weight": 0.5, "a": diffuse(0.0), "b": diffuse(0.9)}
    scene = room("point", 5, half)
    scene["box"].bsdf = half
    check(scene, "plate.to_world", spp=1024)


@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_a_rough_mirror(alpha):
    floor = {"type": "roughconductor", "alpha": alpha}
    check(room("sky", 3, floor), "box.vertex_positions", spp=512)


def test_a_thin_lens():
    lens = {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.5}
    check(room("rectangle", sensor=lens), "box.vertex_positions")


# -------------------------------------------------------------------------------------------------------- invariants
def test_what_glows_like_the_sky_casts_no_shadow():
    """Points that are glued to it move, and its outlines uncover the sky: both cancel."""
    scene = room("sky")
    scene.integrator = tr.PathTracer(max_depth=2)
    black, glow = tr.Diffuse(reflectance=0.0), {"type": "area", "radiance": 1.0}
    ball = tr.Sphere(center=[0.2, 0.1, 0.7], radius=0.4, bsdf=black, emitter=glow)
    alone = tr.Scene({"camera": scene.camera, "floor": scene.floor, "ball": ball, "sky": scene.lamp}).to(DOUBLE)
    (leaf,) = alone.train_only("ball.center")
    found = []
    for seed in range(8):
        weight = torch.linspace(0, 1, 12, dtype=DOUBLE)[:, None, None]
        # (the ball's outline before the floor, which is darker, is none of this)
        settings = {"integrator": tr.PathTracer(max_depth=2), "spp_visibility": (0, 64)}
        image = tr.render(alone, spp=64, seed=seed, **settings)
        found.append(torch.autograd.grad((image * weight).mean(), leaf)[0])
    found = torch.stack(found)
    error = found.std(0) / 8**0.5
    p = [student_p_value(m.abs() / e, 7) for m, e in zip(found.mean(0), error)]
    assert min(float(x) for x in p) >= sidak(0.01, CASES)
    assert float(error.max()) < 0.02


def test_everything_shifted_together_changes_nothing():
    """Under a constant sky: sample by sample, since nothing moves relative to anything."""
    scene = room("sky", 3)
    names = ("box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world")
    shift = torch.tensor([0.3, -0.2, 0.5], dtype=DOUBLE)
    values = {n: scene.get_parameter(n).detach() for n in names}
    changes = {n: torch.zeros_like(v) for n, v in values.items()}
    for change in changes.values():
        if change.shape == (4, 4):
            change[:3, 3] = shift
        else:
            change += shift

    def f(*tensors):
        return tr.render(scene, spp=16, seed=2, params=dict(zip(names, tensors)))

    _, change = torch.func.jvp(f, tuple(values.values()), tuple(changes.values()))
    camera = values["camera.to_world"]
    _, part = torch.func.jvp(lambda c: tr.render(scene, spp=16, seed=2, params={"camera.to_world": c}),
                             (camera,), (changes["camera.to_world"],))  # fmt: skip
    assert float(change.abs().max()) < 1e-9 * float(part.abs().max())


@pytest.mark.parametrize("light", ["rectangle", "point", "sky"])
def test_forward_mode_is_reverse_mode(light):
    scene = room(light, 3)
    names = ["box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world"]
    names += {"rectangle": ["lamp.to_world"], "point": ["lamp.position"]}.get(light, [])
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message


def test_numbers_of_samples():
    """Either part can be left out, and more samples change nothing but the noise."""
    scene = room("point")
    (leaf,) = scene.train_only("plate.to_world")

    def gradient(**settings):
        return torch.autograd.grad(tr.render(scene, spp=256, seed=1, **settings).mean(), leaf)[0][:3, 3]

    none, seen, cast = (gradient(spp_visibility=s) for s in ((0, 0), (64, 0), (0, 64)))
    torch.testing.assert_close(none, gradient(visibility=False), rtol=0, atol=0)
    both = gradient(spp_visibility=64)
    torch.testing.assert_close(both - none, (seen - none) + (cast - none), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(both, gradient(spp_visibility=(256, 256)), rtol=0.05, atol=2e-3)
    for bad, error in (((1, 2, 3), ValueError), (-1, ValueError), ((1, -1), ValueError), ("4", TypeError)):
        with pytest.raises(error, match=r"render: spp_visibility"):
            tr.render(scene, spp=1, spp_visibility=bad)


def test_no_pixels_have_no_gradient():
    scene = room("sky", 3)
    leaves = scene.train_only("box.vertex_positions", "camera.to_world")
    image = tr.render(scene, spp=4, pixels=torch.zeros(0, 2, dtype=torch.int64))
    assert all(not g.any() for g in torch.autograd.grad(image.sum(), leaves))


def test_two_threads_with_cameras_of_their_own():
    """They share what the core knows of the outlines."""
    scene = room("rectangle", 3).to(torch.float32)
    moved = torch.eye(4)
    moved[0, 3] = 0.7
    start = scene.get_parameter("box.vertex_positions").detach()
    poses = [scene.get_parameter("camera.to_world").detach(), moved @ scene.get_parameter("camera.to_world").detach()]

    def gradient(pose: torch.Tensor) -> torch.Tensor:
        corners = start.clone().requires_grad_()
        params = {"box.vertex_positions": corners, "camera.to_world": pose}
        return torch.autograd.grad(tr.render(scene, spp=4, spp_visibility=64, seed=1, params=params).sum(), corners)[0]

    alone = [gradient(pose) for pose in poses]
    with ThreadPoolExecutor(2) as pool:
        for _ in range(8):
            assert all(torch.equal(a, b) for a, b in zip(pool.map(gradient, poses), alone))


def test_the_same_seed_gives_the_same_gradient():
    scene = room("rectangle", 3).to(torch.float32)
    leaves = scene.train_only("box.vertex_positions", "lamp.to_world")
    found, before = [], torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        try:
            found.append(torch.autograd.grad(tr.render(scene, spp=8, seed=4).sum(), leaves))
            assert torch.get_num_threads() == threads
        finally:
            torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found))
