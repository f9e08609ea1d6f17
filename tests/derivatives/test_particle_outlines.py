"""Silhouettes and shadows that move, in light tracing: differences of images of the path tracer, which has less noise,
the path tracer's own derivative, and what light paths find otherwise than it does.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import warnings

import pytest
import torch
from light_scenes import area as area_light
from light_scenes import metered, texels
from moving_differences import agrees, compare, direction_of
from shadow_scenes import DOWN, area, diffuse, room

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

pytestmark = [pytest.mark.once, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]

DOUBLE = torch.float64
CASES = 48  # statistical tests in this file, at most
T = tr.Transform


def bordered(scene: tr.Scene) -> tr.Scene:
    """With a film that light beyond its edge reaches in the path tracer's images, too."""
    scene.sensors[0].film.sample_border = True
    return scene


def view(background: dict, **objects) -> tr.Scene:
    """Things before a wall at y = 1, seen along y from y = -3."""
    film = {"type": "hdrfilm", "width": 10, "height": 10, "rfilter": {"type": "gaussian"}, "sample_border": True}
    wall = {"type": "rectangle", "to_world": T.translate([0, 1, 0]) @ T.rotate([1, 0, 0], 90) @ T.scale(2.5)}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "rr_depth": 99},
            "camera": {
                "type": "perspective",
                "fov": 40,
                "to_world": T.look_at([0.1, -3, 0.2], [0, 0, 0], [0, 0, 1]),
                "film": film,
            },
            "wall": {**wall, **background},
            **objects,
        },
        dtype=DOUBLE,
    )


BOARD = {
    "type": "rectangle",
    "to_world": T.translate([0.2, -0.3, 0.1]) @ T.rotate([1, 0.2, 0.3], 70) @ T.scale([0.5, 0.3, 1]),
    "bsdf": diffuse([0.2, 0.5, 0.7]),
}
BALL = {"type": "sphere", "center": [-0.2, 0, 0.1], "radius": 0.4, "bsdf": diffuse(0.4)}
GLOW = {"emitter": {"type": "area", "radiance": texels(4, 4, 4.0)}}
LIT = {"bsdf": diffuse(0.6)}
LAMP = area({"type": "rectangle", "to_world": T.translate([0.4, -1.5, 2.2]) @ DOWN @ T.scale(0.5)}, 8.0)


def light_tracer(scene: tr.Scene, **settings) -> tr.ParticleTracer:
    """As deep as the scene's own integrator."""
    return tr.ParticleTracer(scene.integrator.max_depth, 99, **settings)


def check(scene: tr.Scene, parameter: str, spp: int = 512, step: float = 5e-3, rtol: float = 0.02) -> None:
    """The derivative of light paths against differences of images of the scene's own integrator."""
    found = compare(scene, parameter, 6, spp, step, integrator=light_tracer(scene), spp_visibility=(32, 64))
    passed, text = agrees(*found, rtol, CASES)
    assert passed, f"{parameter}: {text}"
    assert float(found[1].abs().mean()) > 1e-4


# ---------------------------------------------------------------------------------------------------- what is in view
@pytest.mark.parametrize("parameter", ["board.to_world", "wall.to_world", "camera.to_world"])
def test_a_silhouette_before_a_light(parameter):
    """What is uncovered keeps its place on the light: that of what rests before a wall that moves counts, too."""
    scene = view(GLOW, board=BOARD)
    scene.integrator = tr.PathTracer(1, 99)
    check(scene, parameter)


@pytest.mark.parametrize("parameter", ["board.to_world", "wall.to_world"])
def test_a_silhouette_before_a_lit_wall(parameter):
    check(view(LIT, board=BOARD, lamp=LAMP), parameter)


@pytest.mark.parametrize("background", [GLOW, LIT], ids=["light", "lit wall"])
@pytest.mark.parametrize("parameter", ["ball.center", "ball.radius"])
def test_a_smooth_contour(background, parameter):
    scene = view(background, ball=BALL, **({"lamp": LAMP} if background is LIT else {}))
    check(scene, parameter)


def test_a_silhouette_before_the_sky():
    """Directions to it are at rest, so that it does not slide over the film when the camera is shifted."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "camera": view(GLOW).sensors[0],
            "board": BOARD,
            "sky": {"type": "constant", "radiance": 1.0},
        },
        dtype=DOUBLE,
    )
    check(scene, "board.to_world", spp=1024)
    check(scene, "camera.to_world", spp=1024)


# ----------------------------------------------------------------------------------------------- shadows, all of it
@pytest.mark.parametrize(
    ("light", "parameter"),
    [
        *((light, "box.vertex_positions") for light in ("rectangle", "ball", "point", "spot", "sun", "sky")),
        *((light, "plate.to_world") for light in ("rectangle", "point", "sun")),
        ("rectangle", "lamp.to_world"), ("ball", "lamp.radius"), ("tube", "lamp.to_world"), ("point", "lamp.position"),
        ("spot", "lamp.to_world"), ("sun", "lamp.to_world"),
        ("rectangle", "floor.to_world"), ("point", "floor.to_world"), ("sun", "floor.to_world"),
        ("rectangle", "camera.to_world"), ("point", "camera.to_world"), ("point", "camera.x_fov"),
    ],
)  # fmt: skip
def test_direct_light(light, parameter):
    """Things, lamps, the floor that gets the shadows, and the camera."""
    scene = bordered(room(light))
    x_fov = parameter.endswith("fov")  # of which boundaries have no part: lines past them rest
    check(scene, parameter, spp=1024 if light == "sky" else 512, step=0.1 if x_fov else 5e-3)


@pytest.mark.parametrize("light", ["rectangle", "point"])
def test_reflected_light(light):
    check(bordered(room(light, 4)), "box.vertex_positions")


def test_a_glossy_floor():
    check(bordered(room("rectangle", 3, {"type": "roughconductor", "alpha": 0.3})), "box.vertex_positions")


def test_the_derivative_is_that_of_the_path_tracer():
    """In expectation, although in each of them other points rest: of all that moves, in light of three segments."""
    scene = bordered(room("rectangle", 3))
    names = ("box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world", "lamp.to_world")
    changes = [direction_of(n, scene.get_parameter(n)) for n in names]
    leaves = scene.train_only(*names)
    weight = torch.linspace(0, 1, 12, dtype=DOUBLE)[:, None, None] + torch.linspace(0.5, 0, 12)[:, None]
    found = {}
    for integrator in (scene.integrator, light_tracer(scene)):
        rows = []
        for seed in range(8):
            image = tr.render(scene, integrator=integrator, spp=1, spp_grad=512, seed=seed, spp_visibility=(32, 64))
            gradients = torch.autograd.grad((image * weight).mean(), leaves)
            rows.append([float((g * c).sum()) for g, c in zip(gradients, changes)])
        found[integrator.kind] = torch.tensor(rows)
    gap = found["ptracer"] - found["path"]
    for i, name in enumerate(names):
        p = float(student_p_value(gap[:, i].mean().abs() / (gap[:, i].std() / 8**0.5), 7))
        assert p >= sidak(0.01, CASES), name
    assert float(gap.std(0).max()) < 0.25 * float(found["path"].mean(0).abs().max())


# --------------------------------------------------------------------------------------------- what light paths lack
def own_differences(scene: tr.Scene, parameter: str, **settings) -> None:
    """The derivative against differences of the light tracer's own images."""
    scene.integrator = light_tracer(scene, **settings)
    found = compare(scene, parameter, 6, 1024, 0.02, spp_visibility=32)
    passed, text = agrees(*found, 0.03, CASES)
    assert passed, f"{parameter}: {text}"
    assert float(found[1].abs().mean()) > 1e-3


def test_what_is_seen_in_a_mirror_is_black():
    """A lamp behind the board that only a mirror shows: its border before the board is not in the image."""
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor", "eta": 0.2, "k": 3.9}}
    place = T.translate([0, 1, -0.8]) @ T.rotate([1, 0, 0], 90) @ T.scale([2.5, 0.9, 1])
    scene = view(GLOW, board=BOARD, mirror={**mirror, "to_world": T.translate([0, -0.1, 0]) @ place}, lamp=LAMP)
    own_differences(scene, "board.to_world")


def test_what_is_behind_an_invisible_surface_is_black():
    """It hides what is behind it and, in light of two segments, throws a shadow."""
    scene = view(LIT, board={**BOARD, "bsdf": {"type": "null"}}, lamp=LAMP)
    own_differences(scene, "board.to_world")


def test_hidden_lights():
    scene = view(LIT, board=BOARD, lamp=area(BALL))
    own_differences(scene, "lamp.center", hide_emitters=True)


# ------------------------------------------------------------------------------------------------ modes and settings
@pytest.mark.parametrize("light", ["rectangle", "point", "sun", "sky"])
def test_forward_mode_is_reverse_mode(light):
    scene = room(light, 3)
    names = ["box.vertex_positions", "plate.to_world", "floor.to_world", "camera.to_world"]
    names += {"rectangle": ["lamp.to_world"], "point": ["lamp.position"], "sun": ["lamp.to_world"]}.get(light, [])
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        settings = {"integrator": light_tracer(scene), "spp_visibility": 4}
        return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)), **settings)

    result = tr.testing.dot_product_test(f, values, rtol=1e-9)
    assert result, result.message


def gradient(scene: tr.Scene, leaf: torch.Tensor, spp: int = 64, **settings) -> torch.Tensor:
    image = tr.render(scene, integrator=light_tracer(scene), spp=spp, seed=1, **settings)
    return torch.autograd.grad(image.mean(), leaf)[0]


def test_numbers_of_samples():
    """Either part can be left out, and more samples change nothing but the noise."""
    scene = room("point")
    (leaf,) = scene.train_only("plate.to_world")
    none, seen, cast = (gradient(scene, leaf, spp_visibility=s) for s in ((0, 0), (64, 0), (0, 64)))
    torch.testing.assert_close(none, gradient(scene, leaf, visibility=False), rtol=0, atol=0)
    both = gradient(scene, leaf, spp_visibility=64)
    torch.testing.assert_close(both - none, (seen - none) + (cast - none), rtol=1e-9, atol=1e-12)
    assert min(float((x - none).abs().max()) for x in (seen, cast)) > 1e-3
    torch.testing.assert_close(both, gradient(scene, leaf, spp_visibility=(256, 256)), rtol=0.05, atol=2e-3)


def test_crops_and_pixels_add_up_to_the_whole():
    scene = room("rectangle", 3)
    (leaf,) = scene.train_only("box.vertex_positions")

    def total(**settings) -> torch.Tensor:
        found = [
            torch.autograd.grad(
                tr.render(scene, integrator=light_tracer(scene), spp=64, seed=s, spp_visibility=256, **settings).sum(),
                leaf,
            )[0]
            for s in range(2)
        ]
        return sum(found) / 2

    whole = total()
    halves = total(crop=(0, 0, 12, 5)) + total(crop=(0, 5, 12, 7))
    torch.testing.assert_close(halves, whole, rtol=0.05, atol=0.05 * float(whole.abs().max()))
    grid = torch.cartesian_prod(torch.arange(12), torch.arange(12))
    torch.testing.assert_close(total(pixels=grid), whole, rtol=0.05, atol=0.05 * float(whole.abs().max()))


def test_nothing_runs_where_nothing_moves():
    scene = room("rectangle", 3)
    (colour,) = scene.train_only("box.bsdf.brdf_0.reflectance.value")
    tr.render(scene, integrator=light_tracer(scene), spp=4, seed=1).sum().backward()
    assert colour.grad is not None and float(colour.grad.abs().max()) > 0
    assert "visibility" not in scene.statistics
    (corners,) = scene.train_only("box.vertex_positions")
    tr.render(scene, integrator=light_tracer(scene), spp=4, seed=1).sum().backward()
    assert set(scene.statistics["visibility"]) == {"pilot", "silhouettes", "shadows", "reflections"}
    assert corners.grad is not None


# -------------------------------------------------------------------------------------------------------- what is said
def said(scene: tr.Scene, *names: str, **settings) -> str:
    """What a rendering by light paths says that is missing."""
    integrator = tr.ParticleTracer(max_depth=2)
    scene.train_only(*names)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tr.render(scene, integrator=integrator, spp=1, seed=0, **settings)
    return "; ".join(str(w.message) for w in caught if issubclass(w.category, tr.MissingTermWarning))


def test_what_is_missing_is_said():
    """Where light takes the way of a mirror or glass, and in beams; not that of textures, over which nothing slides."""
    checks = {"bsdf": diffuse({"type": "checkerboard"})}
    assert said(view(checks, board=BOARD, lamp=LAMP), "board.to_world", "camera.to_world") == ""
    glass = {**BALL, "bsdf": {"type": "dielectric"}}
    text = said(view(checks, ball=glass, lamp=LAMP), "camera.to_world")
    assert "camera.to_world is without the motion of edges in the light that comes by way of ball.bsdf" in text
    assert "of jumps of wall.bsdf.brdf_0.reflectance" in text
    beam = {**LAMP, "emitter": {"type": "directionalarea", "radiance": 1.0}}
    assert "of edges in the beams of lamp.emitter" in said(view(LIT, board=BOARD, lamp=beam), "board.to_world")
    assert "silhouettes, creases and edges" in said(view(LIT, board=BOARD, lamp=LAMP), "board.to_world",
                                                    spp_visibility=0)  # fmt: skip
    assert said(view(LIT, board=BOARD, lamp=LAMP), "board.to_world", visibility=False) == ""


def test_an_irradiance_meter_lacks_all_of_it():
    scene = tr.load_dict(metered(lamp=area_light(), board=BOARD), dtype=DOUBLE)
    assert "silhouettes, creases and edges of shadows" in said(scene, "board.to_world")
