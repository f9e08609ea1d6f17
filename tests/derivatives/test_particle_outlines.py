"""Silhouettes and shadows that move, in light tracing: differences of images of the path tracer, which has less noise,
the path tracer's own derivative, and what light paths find otherwise than it does.

Statistical tests are at 1 % for all of this file together, by Sidak's correction over its cases.
"""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from light_scenes import area as area_light
from light_scenes import metered, texels
from moving_differences import agrees, direction_of
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
LAMP = area({"type": "rectangle", "to_world": T.translate([0.4, -1.5, 2.2]) @ DOWN @ T.scale(0.5)}, radiance=8.0)


def light_tracer(scene: tr.Scene, **settings) -> tr.ParticleTracer:
    """As deep as the scene's own integrator."""
    return tr.ParticleTracer(scene.integrator.max_depth, 99, **settings)


def weighted(image: torch.Tensor) -> torch.Tensor:
    """A mean of the image with weights that change over it, as smooth ones do."""
    height, width = image.shape[:2]
    y, x = torch.linspace(0, 4, height, dtype=DOUBLE), torch.linspace(0, 5, width, dtype=DOUBLE)
    return (image * (1 + torch.sin(x) * torch.cos(y + 1)[:, None])[..., None]).mean()


def change_of(name: str, value: torch.Tensor) -> torch.Tensor:
    """A motion: matrices shift and turn a little, all vertices and points are shifted, numbers grow."""
    if name.endswith("to_world"):
        change = torch.tensor(
            [[0.1, -0.2, 0.1, 0.5], [0.2, 0.1, -0.3, -0.3], [-0.1, 0.3, 0.1, 0.4], [0, 0, 0, 0]], dtype=DOUBLE
        )
        if "camera" in name:  # which would see hardly anything of a turn by that much
            change[:, :3] *= 0.2
        return change @ value.double()
    if value.ndim and value.shape[-1] == 3:
        return torch.tensor([0.6, -0.3, 0.5], dtype=DOUBLE).expand(value.shape)
    return torch.full_like(value, 20.0 if name.endswith("fov") else 0.5)


def check(
    scene: tr.Scene,
    name: str,
    spp: int = 256,
    step: float = 0.03,
    rtol: float = 0.02,
    seeds: int = 12,
    share: float = 0.15,
    images: tr.Integrator | None = None,
    spp_visibility: tuple[int, int] = (32, 32),
    **settings,
) -> None:
    """The derivative of light paths against differences of images of the scene's own integrator, or of another.

    The error is no more than this share of what outlines have in the derivative.
    """
    scene = scene.to(torch.float32)  # packets take a fifth of the time
    value = scene.get_parameter(name).detach()
    change, light = change_of(name, value), light_tracer(scene, **settings)
    images = scene.integrator if images is None else images

    def derivative(seed: int, **more) -> float:
        x = value.clone().requires_grad_()
        image = tr.render(scene, integrator=light, spp=1, spp_grad=spp, seed=seeds + seed, params={name: x}, **more)
        return float((torch.autograd.grad(weighted(image), x)[0] * change).sum())

    def difference(seed: int) -> float:
        places = (value + s * change for s in (step, -step))
        ends = [
            float(weighted(tr.render(scene, integrator=images, spp=spp, seed=seed, params={name: x}))) for x in places
        ]
        return (ends[0] - ends[1]) / (2 * step)

    derivatives = torch.tensor([derivative(seed, spp_visibility=spp_visibility) for seed in range(seeds)])
    differences = torch.tensor([difference(seed) for seed in range(seeds)])
    outlines = torch.tensor([float(derivatives[seed]) - derivative(seed, visibility=False) for seed in range(3)])
    passed, text = agrees(derivatives, differences, rtol, CASES)
    assert passed, f"{name}: {text}"
    error = float((derivatives - differences).std()) / seeds**0.5
    assert error < share * float(outlines.mean().abs()), f"{name}: {text}, outlines {outlines.mean():.3g}"


# ---------------------------------------------------------------------------------------------------- what is in view
@pytest.mark.parametrize("parameter", ["board.to_world", "wall.to_world", "camera.to_world"])
def test_a_silhouette_before_a_light(parameter):
    """What is uncovered keeps its place on the light: that of what rests before a wall that moves counts, too."""
    scene = view(GLOW, board=BOARD)
    scene.integrator = tr.PathTracer(1, 99)
    check(scene, parameter)


@pytest.mark.parametrize("parameter", ["board.to_world", "wall.to_world", "camera.to_world"])
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
    check(scene, "board.to_world")
    check(scene, "camera.to_world")


# ----------------------------------------------------------------------------------------------- shadows, all of it
@pytest.mark.parametrize(
    ("light", "parameter"),
    [
        *((light, "box.vertex_positions") for light in ("rectangle", "ball", "point", "sun", "sky")),
        *((light, "plate.to_world") for light in ("point", "sun")),
        ("rectangle", "lamp.to_world"), ("ball", "lamp.center"), ("point", "lamp.position"),
        ("spot", "lamp.to_world"), ("sun", "lamp.to_world"),
        ("rectangle", "floor.to_world"), ("point", "floor.to_world"),
    ],
)  # fmt: skip
def test_direct_light(light, parameter):
    """Things, lamps, and the floor that gets the shadows."""
    scene = bordered(room(light))
    # where a shadow is shifted as a whole outlines have a small part
    small = (light, parameter) in (("sun", "lamp.to_world"), ("ball", "lamp.center"), ("point", "floor.to_world"))
    check(scene, parameter, share=0.25 if small else 0.15)


@pytest.mark.parametrize("light", ["rectangle", "point"])
def test_reflected_light(light):
    check(bordered(room(light, 4)), "box.vertex_positions")


def test_a_glossy_floor():
    check(bordered(room("rectangle", 2, {"type": "roughconductor", "alpha": 0.3})), "box.vertex_positions", spp=160)


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
            image = tr.render(scene, integrator=integrator, spp=1, spp_grad=256, seed=seed, spp_visibility=(32, 64))
            gradients = torch.autograd.grad((image * weight).mean(), leaves)
            rows.append([float((g * c).sum()) for g, c in zip(gradients, changes)])
        found[integrator.kind] = torch.tensor(rows)
    gap = found["ptracer"] - found["path"]
    for i, name in enumerate(names):
        p = float(student_p_value(gap[:, i].mean().abs() / (gap[:, i].std() / 8**0.5), 7))
        assert p >= sidak(0.01, CASES), name
    assert float(gap.std(0).max()) < 0.25 * float(found["path"].mean(0).abs().max())


# --------------------------------------------------------------------------------------------- what light paths lack
def test_what_is_seen_in_a_mirror_is_black():
    """A lamp behind the board that only a mirror shows: its border before the board is not in the image."""
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor", "eta": 0.2, "k": 3.9}}
    place = T.translate([0, 1, -0.8]) @ T.rotate([1, 0, 0], 90) @ T.scale([2.5, 0.9, 1])
    scene = view(GLOW, board=BOARD, mirror={**mirror, "to_world": T.translate([0, -0.1, 0]) @ place}, lamp=LAMP)
    check(scene, "board.to_world", images=light_tracer(scene))


def test_what_is_behind_an_invisible_surface_is_black():
    """It hides what is behind it and, in light of two segments, throws a shadow."""
    scene = view(LIT, board={**BOARD, "bsdf": {"type": "null"}}, lamp=LAMP)
    check(scene, "board.to_world", images=light_tracer(scene))


def test_hidden_lights():
    """They hide nothing from the camera."""
    scene = view(LIT, board=BOARD, lamp=area({**BALL, "center": [-0.6, -0.2, 0.6], "radius": 0.3}))
    images = tr.PathTracer(2, 99, hide_emitters=True)
    check(scene, "board.to_world", images=images, hide_emitters=True)
    check(scene, "lamp.center", images=images, hide_emitters=True, share=math.inf)  # no outline of it is seen


def test_lights_of_no_weight_are_dark():
    """No light path begins there, so that nothing is seen before them."""
    dark = {"emitter": {**GLOW["emitter"], "sampling_weight": 0}, "bsdf": diffuse(0.0)}
    scene = view(dark, board=BOARD, lamp=LAMP)
    (leaf,) = scene.train_only("board.to_world")
    found, without = (gradient(scene, leaf, visibility=v) for v in (True, False))
    assert float(without.abs().max()) > 1e-4
    torch.testing.assert_close(found, without, rtol=0, atol=1e-9 * float(without.abs().max()))


def test_a_silhouette_before_a_caustic():
    """Light that glass has sent to the wall is uncovered like other light where the glass rests."""
    lamp = {"type": "rectangle", "to_world": T.translate([-0.2, -1.6, 1.2]) @ T.rotate([1, 0, 0], -130) @ T.scale(0.3)}
    near = T.translate([0.1, -2.2, -0.15]) @ T.rotate([1, 0.2, 0.3], 70) @ T.scale([0.2, 0.15, 1])
    ball = {**BALL, "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    scene = view(LIT, ball=ball, board={**BOARD, "to_world": near}, lamp=area(lamp, radiance=20.0))
    scene.integrator = tr.PathTracer(4, 99)
    check(scene, "board.to_world", images=light_tracer(scene), spp_visibility=(2048, 1), share=0.25)


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
