"""Derivatives of images of participating media by what moves: boundaries, grids, lights, surfaces and the camera.

Against differences of quadratures along lines, against differences of images, forward against reverse mode, and what a
common shift of everything must leave as it is. Tests of means are Student's over independent seeds, which a right
renderer fails with probability `media_truth.SIGNIFICANCE` each. None of the scenes has the edge of a shadow in view,
whose motion these derivatives lack.
"""

from __future__ import annotations

import media_scenes
import media_truth as truth
import numpy as np
import pytest
import torch
import trimesh
from media_objects import DOUBLE, LIGHTS, ball, colour, random_grid, sky
from media_truth import assert_mean, cameras, lines, scene
from moving_differences import direction_of

import torchrender as tr
from torchrender.scene.training import parameters_by_every_name

SEEDS = range(8)
NULL = {"type": "null"}
STEP = 1e-4


def rates(view: tr.Scene, name: str, direction: torch.Tensor, spp: int, weights: torch.Tensor) -> torch.Tensor:
    """The derivative of a weighted mean of the image along a direction, for every seed."""
    (leaf,) = view.train_only(name)
    found = []
    for seed in SEEDS:
        image = tr.render(view, sensor=list(range(len(view.sensors))), spp=1, spp_grad=spp, seed=seed)
        (g,) = torch.autograd.grad((image.mean((1, 2)) * weights.to(image.dtype)).sum(), leaf)
        found.append((g.double() * direction).sum())
    view.train_only()
    return torch.stack(found)


def weights_of(cameras: int) -> torch.Tensor:
    return torch.linspace(1.0, 0.5, cameras, dtype=DOUBLE)[:, None] * torch.tensor([1.0, 0.7, 1.4])


def lines_along(light=None, nodes: int = 12):
    return lambda view, o, t, params: truth.along(view, o, t, light, params, nodes)


GREY = {"sigma_t": 0.8, "albedo": 0.0}
GRID = {"sigma_t": random_grid(31), "albedo": 0.0}
SCATTERING = {
    "sigma_t": random_grid(32, (2, 3, 3, 3), high=2.0),
    "albedo": random_grid(33, (2, 3, 2, 3), high=0.9),
    "phase": {
        "type": "blendphase",
        "weight": random_grid(34, high=0.9),
        "phase_0": {"type": "rayleigh"},
        "phase_1": {"type": "hg", "g": 0.5},
    },
}
TABLE = {"sigma_t": 0.7, "albedo": 0.8, "phase": {"type": "tabphase", "values": [0.2, 0.5, 0.3, 1.0, 2.0]}}
CLEAR = (lambda view, o, t, params: truth.transmittance(view, o, t, params), {"sky": sky()})
GLOW = (lines_along(nodes=200), {})
POINT = (lines_along(LIGHTS["point"][1], 36), {"light": LIGHTS["point"][0]})
LINES = {
    "absorption-radius": (GREY, *CLEAR, "ball.radius"),
    "absorption-center": (GREY, *CLEAR, "ball.center"),
    "absorption-place of a grid": (GRID, *CLEAR, "ball.interior_medium.sigma_t.to_world"),
    "absorption-boundary of a grid": (GRID, *CLEAR, "ball.center"),
    "emission-place of a grid": (
        {**GREY, "emission": random_grid(35, (2, 3, 3, 3))},
        *GLOW,
        "ball.interior_medium.emission.to_world",
    ),
    "emission-radius": ({**GRID, "emission": colour([0.5, 1.0, 2.0])}, *GLOW, "ball.radius"),
    "single scattering-extinction": (SCATTERING, *POINT, "ball.interior_medium.sigma_t.to_world"),
    "single scattering-albedo": (SCATTERING, *POINT, "ball.interior_medium.albedo.to_world"),
    "single scattering-phases": (SCATTERING, *POINT, "ball.interior_medium.phase_function.weight.to_world"),
    "single scattering-boundary": (TABLE, *POINT, "ball.center"),
    "single scattering-light": (SCATTERING, *POINT, "light.position"),
    "single scattering-light and table": (TABLE, *POINT, "light.position"),
}


@pytest.mark.parametrize("case", LINES)
def test_lines(case):
    medium, value, others, name = LINES[case]
    origins, targets = lines(3, 36, spread=0.3)
    kind = "heterogeneous" if isinstance(medium["sigma_t"], dict) and "data" in medium["sigma_t"] else "homogeneous"
    bounded = {"type": "sphere", "center": [0.02, 0.01, 0.03], "radius": 0.95, "bsdf": NULL}
    objects = {**cameras(origins, targets, 8), "ball": {**bounded, "interior": {"type": kind, **medium}}, **others}
    depth = 2 if "light" in others else -1
    view = scene(objects, depth, dtype=DOUBLE)
    at = view.get_parameter(name).detach()
    direction = direction_of(name, at)
    weights = weights_of(3)

    def exact(step: float) -> torch.Tensor:
        return (value(view, origins, targets, {name: at + step * direction}) * weights).sum()

    expected = (exact(STEP) - exact(-STEP)) / (2 * STEP)
    assert abs(float(expected)) > 1e-4
    spp = 1024 if depth == 2 else 256
    assert_mean(rates(scene(objects, depth), name, direction, spp, weights), expected, systematic=2e-2, precision=0.1)


@pytest.mark.parametrize("medium", ["constant", "grid"])
def test_camera_along_lines(medium):
    """A camera that moves past a medium: its line passes other places."""
    origins, targets = lines(1, 37, spread=0.3)
    inside = {"constant": ball(GREY), "grid": ball({**GRID, "emission": random_grid(38)}, "heterogeneous")}[medium]
    others = {"sky": sky()} if medium == "constant" else {}
    view = scene({**cameras(origins, targets, 8), "ball": inside, **others}, dtype=DOUBLE)
    shift = np.array([0.3, -0.5, 0.4])
    direction = torch.zeros(4, 4, dtype=DOUBLE)
    direction[:3, 3] = torch.from_numpy(shift)

    def exact(step: float) -> torch.Tensor:
        o, t = origins + step * shift, targets + step * shift
        value = truth.transmittance(view, o, t, {}) if medium == "constant" else truth.along(view, o, t, nodes=12)
        return (value * weights_of(1)).sum()

    expected = (exact(STEP) - exact(-STEP)) / (2 * STEP)
    found = rates(view, "camera0.to_world", direction, 256, weights_of(1))
    assert_mean(found, expected, systematic=1e-2)


def view_of(objects: dict, depth: int = -1, size: int = 4, **more) -> tr.Scene:
    to_world = tr.Transform.look_at([0.2, 0.1, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "fov": 18, "to_world": to_world, "film": film, **more}
    return scene({"camera": camera, **objects}, depth, dtype=DOUBLE)


def textured_sky() -> dict:
    return {"type": "envmap", "data": np.random.default_rng(3).uniform(0.2, 2, (8, 16, 3))}


def lamp(**more) -> dict:
    return {
        "type": "sphere",
        "radius": 0.8,
        "center": [0.2, 2.8, 0.3],
        "emitter": {"type": "area", "radiance": 5.0},
        "bsdf": {"type": "diffuse", "reflectance": 0.7},
        **more,
    }


CUBE = {"type": "cube", "to_world": tr.Transform.scale(1.7), "bsdf": NULL}
THICK = {"sigma_t": 1.5, "albedo": 0.9, "phase": {"type": "hg", "g": 0.4}}
THIN = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.5}


def nested() -> tr.Scene:
    """A ball in a cube, both null, and a lamp beside them that reflects, too."""
    return view_of({"ball": ball(THICK), "box": {**CUBE, "interior": THIN}, "lamp": lamp()})


def coloured() -> tr.Scene:
    to_world = tr.Transform.look_at([1.5, 2, 2], [0, 0, 0], [0, 1, 0])
    spot = {"type": "spot", "to_world": to_world, "intensity": 8.0, "cutoff_angle": 60, "beam_width": 1}
    cloud = ball({**SCATTERING, "emission": random_grid(39, high=0.5)}, "heterogeneous")
    return view_of({"ball": cloud, "spot": spot, "sky": textured_sky()})


def over_a_floor() -> tr.Scene:
    place = tr.Transform.translate([0, 0, -1.5]) @ tr.Transform.scale(6)
    floor = {"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": 0.6}}
    return view_of({"ball": ball(THICK), "floor": floor, "lamp": lamp(radius=0.4)}, 4)


def in_glass() -> tr.Scene:
    glass = {"type": "dielectric", "int_ior": 1.3}
    return view_of({"ball": {**ball(THICK), "bsdf": glass}, "sky": textured_sky()}, 6)


def through_a_lens() -> tr.Scene:
    return view_of({"ball": ball(THICK), "sky": textured_sky()}, type="thinlens", aperture_radius=0.2, focus_distance=3)


def fog() -> tr.Scene:
    """The camera and the lamp in one medium in a room."""
    air = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.7, "id": "fog"}
    same = {"type": "ref", "id": "fog"}
    room = {"type": "cube", "to_world": tr.Transform.scale([2, 2, 5]), "flip_normals": True, "exterior": same}
    return view_of({"fog": air, "room": room, "lamp": lamp(radius=0.3, center=[0.3, 1.2, 1])}, 4, medium=same)


def silhouettes(**camera) -> tr.Scene:
    """What glows and what is black, in and before a cloud that absorbs and glows."""
    turned = tr.Transform.translate([0.1, 0.2, 0.1]) @ tr.Transform.rotate([1, 2, 1], 40) @ tr.Transform.scale(0.2)
    black = {"bsdf": {"type": "diffuse", "reflectance": 0.0}}
    box = trimesh.creation.box((2, 2, 2))  # shared corners
    glowing = {"emitter": {"type": "area", "radiance": colour([4.0, 3.0, 2.0])}}
    cloud = {"sigma_t": random_grid(40), "albedo": 0.0, "emission": random_grid(41, high=0.5)}
    return view_of(
        {
            "ball": ball(cloud, "heterogeneous"),
            "box": {
                "type": "mesh",
                "vertices": box.vertices,
                "faces": box.faces,
                "to_world": turned,
                **black,
                **glowing,
            },
            "inside": {"type": "sphere", "center": [-0.3, -0.1, 0.3], "radius": 0.25, **black},
            "before": {"type": "disk", "to_world": tr.Transform.translate([0.2, -0.3, 1.5]) @ turned, **black},
            "sky": textured_sky(),
        },
        **camera,
    )


def silhouettes_of_a_lens() -> tr.Scene:
    return silhouettes(type="thinlens", aperture_radius=0.1, focus_distance=4)


IMAGES = [
    (silhouettes, "box.vertex_positions", 256),
    (silhouettes, "inside.radius", 256),
    (silhouettes, "before.to_world", 256),
    (silhouettes, "camera.to_world", 256),
    (silhouettes_of_a_lens, "inside.center", 256),
    (nested, "ball.radius", 512),
    (nested, "lamp.center", 256),
    (coloured, "spot.to_world", 256),
    (coloured, "camera.to_world", 1024),
    (over_a_floor, "ball.center", 512),
    (over_a_floor, "lamp.center", 256),
    (in_glass, "ball.bsdf.eta", 1024),
    (through_a_lens, "camera.to_world", 1024),
]


@pytest.mark.parametrize(("make", "name", "spp"), IMAGES, ids=[f"{make.__name__}-{name}" for make, name, _ in IMAGES])
def test_images(make, name, spp):
    """Against differences of images with the same samples, whose mean has an error of its own."""
    view = make().to(torch.float32)  # packets take a fifth of the time
    at = view.get_parameter(name).detach()
    direction = direction_of(name, at)
    if name.endswith("vertex_positions"):
        direction = torch.tensor([0.3, -0.6, 0.4], dtype=DOUBLE).expand(at.shape)
    weights = torch.from_numpy(np.random.default_rng(4).uniform(0.5, 1.5, (4, 4, 3)))
    step = 0.03 if at.ndim else 0.03 * float(at)

    def value(x, seed, **more):
        return (tr.render(view, seed=seed, params={name: x}, **more) * weights).mean()

    differences, found = [], []
    for seed in SEEDS:
        with torch.no_grad():
            ends = [value(at + s * step * direction, seed, spp=4 * spp) for s in (1, -1)]
        differences.append((ends[0] - ends[1]) / (2 * step))
        x = at.clone().requires_grad_()
        (g,) = torch.autograd.grad(value(x, 100 + seed, spp=1, spp_grad=spp), x)
        found.append((g * direction).sum())
    a, b = torch.stack(found), torch.stack(differences)
    error = ((a.var() + b.var()) / len(a)).sqrt()
    assert float(error) < 0.2 * abs(float(b.mean())), (float(error), float(b.mean()))
    z = (a.mean() - b.mean()) / error
    p = tr.testing.student_p_value(z.abs()[None], len(a) - 1)
    assert float(p) >= truth.SIGNIFICANCE, (float(a.mean()), float(b.mean()), float(z))


MODES = [(make, name) for make, name, _ in IMAGES] + [
    (fog, "lamp.center"),
    (fog, "room.vertex_positions"),
    (nested, "box.vertex_positions"),
    (coloured, "ball.interior_medium.emission.to_world"),
    (over_a_floor, "floor.to_world"),
    (through_a_lens, "sky.to_world"),
]


@pytest.mark.parametrize(("make", "name"), MODES, ids=[f"{make.__name__}-{name}" for make, name in MODES])
def test_forward_is_reverse(make, name):
    view = make()
    check_modes(view, name)


def check_modes(view: tr.Scene, name: str) -> None:
    at = view.get_parameter(name).detach()
    direction = direction_of(name, at)

    def render(x):
        return tr.render(view, spp=1, spp_grad=32, seed=7, params={name: x})

    _, tangent = torch.func.jvp(render, (at,), (direction,))
    weight = torch.randn(tangent.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    x = at.clone().requires_grad_()
    (g,) = torch.autograd.grad((render(x) * weight).sum(), x)
    assert float(g.abs().max()) > 0
    torch.testing.assert_close((g * direction).sum(), (tangent * weight).sum(), rtol=1e-9, atol=1e-12)


def dense() -> tr.Scene:
    """Paths of several hundred scatterings: the tape has them in blocks."""
    milk = {"sigma_t": 30.0, "albedo": 1.0}
    scene = view_of({"ball": ball(milk), "sky": textured_sky()})
    scene.integrator.rr_depth = 10000
    return scene


@pytest.mark.parametrize("name", ["ball.center", "camera.to_world"])
def test_long_paths(name):
    check_modes(dense(), name)


@pytest.mark.parametrize("make", [silhouettes, nested, coloured, over_a_floor, in_glass, through_a_lens, fog, dense])
def test_a_common_shift_changes_nothing(make):
    """Path by path: what one end of a segment gets the other ends and the camera give."""
    view = make()
    shift = torch.tensor([0.3, -0.7, 0.5], dtype=DOUBLE)
    names = [n for n in parameters_by_every_name(view) if n.endswith(("to_world", "vertex_positions", "position"))]
    names = [n for n in names if not n.startswith("sky")]
    leaves = view.train_only(*names)
    grads = torch.autograd.grad(tr.render(view, spp=1, spp_grad=64, seed=3).square().sum(), leaves, allow_unused=True)
    parts = []
    for name, g in zip(names, grads, strict=True):
        if g is None:
            continue
        by = g[:3, 3] if name.endswith("to_world") else g.reshape(-1, 3).sum(0)
        parts.append((by * shift).sum())
    total = torch.stack(parts)
    assert float(total.abs().max()) > 0
    assert abs(float(total.sum())) < 1e-5 * float(total.abs().max()), total


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("depth", [2, 12])
@pytest.mark.parametrize(("dtype", "close"), [(torch.float32, 1e-3), (DOUBLE, 1e-9)], ids=str)
def test_paths_that_end_in_glass(dtype, close, depth):
    """No BSDF's direction is chosen at the last vertex, and none may come into derivatives, not even 0 times."""
    view = tr.load_dict(media_scenes.SCENES["nested"]().scene, dtype=dtype)
    names = ("glass.center", "sensor.x_fov", "glass.bsdf.eta", "box.vertex_positions")
    leaves = view.train_only(*names)
    settings = {"visibility": False, "integrator": tr.VolumetricPathTracer(max_depth=depth, rr_depth=100), "spp": 4}
    image = tr.render(view, seed=3, nan="raise", **settings)
    weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(1), dtype=dtype)
    gradients = torch.autograd.grad(image, leaves, weights)  # nothing is dropped
    for name, leaf, gradient in zip(names, leaves, gradients, strict=True):
        direction = torch.randn(leaf.shape, generator=torch.Generator().manual_seed(2), dtype=dtype)

        def picture(value, name=name):
            return tr.render(view, seed=3, nan="raise", params={name: value}, **settings)

        _, tangent = torch.func.jvp(picture, (leaf.detach(),), (direction,))
        found, expected = (tangent.detach() * weights).double().sum(), (gradient * direction).double().sum()
        assert float(found) == pytest.approx(float(expected), rel=close)
