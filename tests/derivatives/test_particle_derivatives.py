"""Derivatives of light tracing: against finite differences, the path tracer's derivatives, and forward mode.

Beams through smooth glass move pathwise: with the same random numbers a finite difference has no noise, only the error
of its step. What leaves other lamps is glued to the surfaces that it meets; such derivatives are right in expectation,
and are compared with those of the path tracer, of other samples (Student's test). No scene has edges in view or in its
light, whose terms are missing in both.
"""

from __future__ import annotations

import functools
import math

import light_scenes as ls
import pytest
import torch
from light_changes import direction, triangle, weight

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
SIGNIFICANCE = 0.01  # of all comparisons with the path tracer together
SEEDS = 10
T = tr.Transform
STEP = 1e-5
PLANE = T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale(3)
MIRROR = {"type": "conductor", "eta": 0.2, "k": 3.9}
FROSTED = {"type": "roughdielectric", "alpha": 0.4, "int_ior": 1.3, "ext_ior": 1.0}
CAMERA = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "pixel_aspect")


def with_camera(light: dict, **objects) -> dict:
    return ls.floor_view(light=light, **objects)


# ------------------------------------------------------------------------------------------------------------- pathwise
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
SHEET = ("sheet.vertex_positions",)
# (places on the beam follow its texels: test_light_cells and test_particle_oracle have the derivative by these)
BEAM = ("light.to_world",)
CAMERAS = tuple(f"camera.{name}" for name in CAMERA)
PATHWISE = {
    "bare": (lambda: with_camera(ls.beam()), ("floor.to_world", *BEAM, *CAMERAS, "floor.bsdf.reflectance.value")),
    "sheet": (lambda: with_camera(ls.beam(), sheet=ls.wavy_sheet(GLASS)), (*SHEET, *BEAM, "floor.to_world", *CAMERAS)),
    "facets": (lambda: with_camera(ls.beam(), sheet=ls.wavy_sheet(GLASS, n=4, normals=False)), (*SHEET, *BEAM)),
    "own normals": (
        lambda: with_camera(ls.beam(), sheet=triangle(GLASS)),
        (*SHEET, "sheet.vertex_normals", *BEAM, "floor.to_world", *CAMERAS),
    ),
    "ball": (
        lambda: with_camera(
            {**ls.beam(), "to_world": ls.beam()["to_world"] @ T.scale(0.5)},  # that meets the ball's middle only
            lens={"type": "sphere", "center": [0.1, 0.2, 0.1], "radius": 0.6, "bsdf": GLASS},
        ),
        ("lens.radius", "lens.center", "lens.to_world", *BEAM),
    ),
    "bumpy receiver": (
        lambda: with_camera(ls.beam(), ground=triangle({"type": "diffuse", "reflectance": ls.texels(4, 4)}, low=True)),
        ("ground.vertex_positions", "ground.vertex_normals", *BEAM, *CAMERAS),
    ),
    "meter": (lambda: ls.metered(light=ls.beam()), ("floor.to_world", *BEAM)),
    "meter under a sheet": (
        lambda: ls.metered(light=ls.beam(), sheet=ls.wavy_sheet(GLASS)),
        (*SHEET, *BEAM, "floor.to_world"),
    ),
    "meter under normals": (
        lambda: ls.metered(light=ls.beam(), sheet=triangle(GLASS)),
        (*SHEET, "sheet.vertex_normals", *BEAM, "floor.to_world"),
    ),
}
DEPTH = {"ball": 4, "bare": 2, "bumpy receiver": 2, "meter": 2}


@functools.cache
def pathwise(name: str) -> tr.Scene:
    return tr.load_dict(PATHWISE[name][0](), dtype=torch.float64)


# Where directions decide how much is reflected (the ball), whether a path is reflected changes with them: such jumps
# are a part of the expectation, but of hardly any single difference.
@pytest.mark.parametrize("name", [name for name in PATHWISE if name != "ball"])
def test_pathwise_derivatives_equal_finite_differences(name):
    scene, names = pathwise(name), PATHWISE[name][1]
    light = tr.ParticleTracer(max_depth=DEPTH.get(name, 3), rr_depth=99)
    values = {n: scene.get_parameter(n).detach() for n in names}

    def f(params: dict) -> torch.Tensor:
        image = tr.render(scene, integrator=light, spp=24, seed=3, correlated=True, params=params)
        return (image * weight(image)).sum()

    leaves = {n: v.clone().requires_grad_() for n, v in values.items()}
    gradients = torch.autograd.grad(f(leaves), list(leaves.values()))
    for parameter, gradient in zip(names, gradients):
        value, change = values[parameter], direction(parameter, values[parameter])
        step = 1e-3 if parameter.endswith("fov") else STEP
        with torch.no_grad():
            high, low = (float(f({**values, parameter: value + s * step * change})) for s in (1, -1))
        difference, found = (high - low) / (2 * step), float((gradient * change).sum())
        # slopes of the filter jump where it ends, by 1e-3 of its height: such jumps are few. Where light crosses an
        # edge of a mesh its shading correction jumps, which the derivative leaves out.
        tolerance = 1e-2 if name in ("meter under a sheet", "own normals") and parameter in SHEET else 1e-3
        assert found == pytest.approx(difference, rel=tolerance, abs=1e-4), f"{name}: {parameter}"
        assert abs(found) > 1e-3, f"{name}: {parameter}"


@pytest.mark.parametrize("name", ["ball", "sheet"])
def test_index_of_refraction(name):
    """Rays that are reflected in one image and refracted in the other are rare and weigh much: long steps."""
    scene = pathwise(name)
    parameter = "lens.bsdf.eta" if name == "ball" else "sheet.bsdf.eta"
    light = tr.ParticleTracer(max_depth=DEPTH.get(name, 3), rr_depth=99)

    def f(x, seed):
        image = tr.render(scene, integrator=light, spp=200, seed=seed, params={parameter: x})
        return (image * weight(image)).mean()

    result = tr.testing.check_gradients(
        f, scene.get_parameter(parameter).detach(), step=0.03, seeds=range(12), significance=0.005, rtol=0.02
    )
    assert result, result.message
    assert abs(float(result.gradient)) > 5 * float(result.standard_error)


# ----------------------------------------------------------------------------------------------- beside the path tracer
WALL = {
    "type": "rectangle",
    "to_world": T.translate([0, 1, -1.2]) @ T.scale(4),
    "bsdf": {"type": "diffuse", "reflectance": ls.RGB},
}
LAMP = ls.area()
SEEN = {  # a lamp that fills the view
    "type": "rectangle",
    "to_world": T.translate([0, -1, 0]) @ T.rotate([1, 0, 0], -80) @ T.scale(4),
    "emitter": {"type": "area", "radiance": ls.texels(3, 3, 4.0)},
}


# name: (scene, parameters besides those of floor and camera, depth)
GLUED = {
    "area": (with_camera(LAMP, wall=WALL), ("light.to_world", "light.emitter.radiance.data", "wall.to_world"), 3),
    "disk": (with_camera({**LAMP, "type": "disk"}), ("light.to_world", "light.emitter.radiance.data"), 2),
    "sphere": (
        with_camera(ls.ball_light(), wall=WALL),
        ("light.center", "light.radius", "light.to_world", "light.emitter.radiance.value", "wall.to_world"),
        3,
    ),
    "mesh": (with_camera(ls.mesh_light()), ("light.vertex_positions", "light.emitter.radiance.value"), 2),
    "point": (
        with_camera(ls.point_light(), wall=WALL),
        ("light.position", "light.intensity.value", "wall.to_world"),
        3,
    ),
    "spot": (
        with_camera(ls.spot(), wall=WALL),
        (
            *(f"light.{n}" for n in ("to_world", "cutoff_angle", "beam_width", "intensity.value", "texture.data")),
            "light.texture.to_uv",
            "wall.to_world",
        ),
        3,
    ),
    "projector": (  # the border of whose image is out of view and meets no wall
        with_camera(ls.projector()),
        tuple(f"light.{n}" for n in ("to_world", "x_fov", "scale", "irradiance.data", "irradiance.to_uv")),
        2,
    ),
    "sun": (with_camera(ls.sun(), wall=WALL), ("light.to_world", "light.irradiance.value", "wall.to_world"), 3),
    "constant": (with_camera({"type": "constant"}, wall=WALL), ("light.radiance.value", "wall.to_world"), 3),
    "turned map": (  # (the wall hides the sky: of that the particle tracer's derivative has nothing)
        with_camera(ls.envmap(), wall=WALL),
        ("light.to_world", "light.data", "light.scale"),
        3,
    ),
    "frosted sheet": (
        with_camera({**LAMP, "to_world": ls.facing_down(0.1, 1.1, 0.1)}, sheet=triangle(FROSTED)),
        (
            "sheet.vertex_positions",
            "sheet.vertex_normals",
            "sheet.bsdf.eta",
            "sheet.bsdf.alpha.value",
            "light.to_world",
        ),
        3,
    ),
    "bumpy ground": (
        with_camera(LAMP, ground=triangle({"type": "diffuse", "reflectance": ls.texels(4, 4)}, low=True)),
        ("ground.vertex_positions", "ground.vertex_normals", "ground.bsdf.reflectance.data", "light.to_world"),
        2,
    ),
    "seen lamp": (
        {"type": "scene", "camera": ls.close_camera(), "light": SEEN},
        ("light.to_world", "light.emitter.radiance.data"),
        1,
    ),
}
HIDDEN_FLOOR = ("bumpy ground", "seen lamp")


def glued_names(name: str) -> list[str]:
    floor = () if name in HIDDEN_FLOOR else ("floor.to_world", "floor.bsdf.reflectance.value")
    return [*GLUED[name][1], *floor, *CAMERAS]


@functools.cache
def glued(name: str) -> tr.Scene:
    return tr.load_dict(GLUED[name][0], dtype=torch.float64)


def slopes(scene: tr.Scene, integrator, names: list[str], seed: int, spp: int, outlines: bool = False) -> torch.Tensor:
    """Derivatives of the weighted mean of an image along a direction of each parameter, (P,)."""
    leaves = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}
    settings = {"spp": 1, "spp_grad": spp, "seed": seed, "visibility": outlines}
    image = tr.render(scene, integrator=integrator, params=leaves, **settings)
    gradients = torch.autograd.grad((image * weight(image)).mean(), list(leaves.values()))
    return torch.stack([(g * direction(n, g)).sum() for n, g in zip(names, gradients)])


COUNT = sum(len(glued_names(name)) for name in GLUED)


@pytest.mark.parametrize("name", list(GLUED))
def test_derivatives_are_those_of_the_path_tracer(name):
    scene, names, depth = glued(name), glued_names(name), GLUED[name][2]
    light, path = (cls(max_depth=depth, rr_depth=99) for cls in (tr.ParticleTracer, tr.PathTracer))
    # where the wall meets the floor light of the sun has an edge: a moving outline for one, for the other it is glued
    outlines = name == "sun"
    found = torch.stack([slopes(scene, light, names, i, 300, outlines) for i in range(SEEDS)])
    expected = torch.stack([slopes(scene, path, names, 50 + i, 300, outlines) for i in range(SEEDS)])
    error = (found.var(0) / SEEDS + expected.var(0) / SEEDS).sqrt()
    gap = (found.mean(0) - expected.mean(0)).abs()
    # rays start a little off the surface, by an amount whose derivative is left out: 1e-4 of the distances
    gap = (gap - 2e-3 * expected.mean(0).abs() - 5e-5).clamp_min(0)
    p = torch.where(gap == 0, torch.ones_like(gap), student_p_value(gap / error, SEEDS - 1))
    text = [
        f"{n}: {float(a):.5g}, path tracer {float(b):.5g} +- {float(e):.2g}, p = {float(q):.2g}"
        for n, a, b, e, q in zip(names, found.mean(0), expected.mean(0), error, p)
    ]
    assert bool((p >= sidak(SIGNIFICANCE, COUNT)).all()), "\n".join([name, *text])
    # at least half of the derivatives are known to half of them; light from all around mostly misses the camera's view
    if name not in ("constant", "turned map", "seen lamp", "sun"):
        assert float((error / expected.mean(0).abs()).median()) < 0.5, "\n".join([name, *text])


# ------------------------------------------------------------------------------------------------- forward and reverse
@pytest.mark.parametrize("name", [*PATHWISE, *GLUED])
def test_forward_and_reverse_mode_agree(name):
    if name in PATHWISE:
        scene, names, depth = pathwise(name), list(PATHWISE[name][1]), 5
    else:
        scene, names, depth = glued(name), glued_names(name), GLUED[name][2] + 1
    light = tr.ParticleTracer(max_depth=depth, rr_depth=3)
    values = [scene.get_parameter(n).detach() for n in names]

    def f(*tensors):
        spp = 64 if name in ("constant", "turned map", "sun", "projector") else 4
        return tr.render(scene, integrator=light, spp=spp, seed=5, params=dict(zip(names, tensors)))

    result = tr.testing.dot_product_test(f, values, rtol=1e-10)
    assert result, result.message
    assert result.forward != 0


def test_what_is_left_out_for_one_parameter_alone_was_not_its_own():
    """Under a field of heights: by the lamp's matrix, the field's, its heights and the floor's matrix, one or all."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 9), torch.linspace(-1, 1, 9), indexing="ij")
    heights = 0.02 * torch.sin(3 * x + 2 * y).double()
    place = T.translate([0, 0.5, 0]) @ T.rotate([1, 0, 0], -90) @ T.scale([1.5, 1.5, 1])
    field = {"type": "heightfield", "heights": heights, "to_world": place, "bsdf": GLASS}
    scene = tr.load_dict(with_camera(ls.beam(), field=field), dtype=torch.float64)
    names = ["light.to_world", "field.heights", "field.to_world", "floor.to_world"]
    light = tr.ParticleTracer(max_depth=4, rr_depth=99)

    def gradients(wanted: list[str]) -> list[torch.Tensor]:
        leaves = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in wanted}
        image = tr.render(scene, integrator=light, spp=16, seed=2, params=leaves)
        return list(torch.autograd.grad((image * weight(image)).sum(), list(leaves.values())))

    for name, together in zip(names, gradients(names), strict=True):
        (alone,) = gradients([name])
        torch.testing.assert_close(alone, together, rtol=1e-10, atol=1e-10 * float(together.abs().max()))
        assert float(together.abs().max()) > 1e-3, name


@pytest.mark.parametrize(
    "name",
    [
        *("sheet", "own normals", "meter under a sheet", "area", "turned map", "bumpy ground"),
        *("spot", "projector", "sun"),
    ],
)
def test_packets_of_single_precision_give_the_gradients_of_double(name):
    table, depth = (PATHWISE, 3) if name in PATHWISE else (GLUED, GLUED[name][2])
    description = table[name][0]() if name in PATHWISE else table[name][0]
    names = PATHWISE[name][1] if name in PATHWISE else glued_names(name)
    gradients = []
    for dtype in (torch.float32, torch.float64):
        scene = tr.load_dict(description, dtype=dtype)
        leaves = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in names}
        light = tr.ParticleTracer(max_depth=depth, rr_depth=99)
        image = tr.render(scene, integrator=light, spp=32, seed=1, params=leaves)
        gradients.append(torch.autograd.grad((image * weight(image)).mean(), list(leaves.values())))
    for parameter, single, double in zip(names, *gradients):
        # a path that rounding turns into another one counts
        assert float((single.double() - double).norm()) <= 0.02 * float(double.norm()) + 1e-6, parameter


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_gradients_repeat_bit_for_bit_at_a_number_of_threads(threads):
    kept = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        scene, names = glued("area"), glued_names("area")
        light = tr.ParticleTracer(max_depth=3)
        first, second = (slopes(scene, light, names, 3, 8) for _ in range(2))
    finally:
        torch.set_num_threads(kept)
    assert torch.equal(first, second)
    assert float(first.abs().min()) > 0


# ---------------------------------------------------------------------------------------------------------- how samples
def test_gradients_of_nonlinear_losses_are_unbiased_with_few_samples():
    """Of the mean of I^2, I = albedo J, by the albedo: twice the mean of I J. Correlated samples add the variance of an
    image, which few light paths a pixel make large. Level: 0.001 (z of 3.3)."""
    scene, light = tr.load_dict(with_camera(ls.point_light()), dtype=torch.float64), tr.ParticleTracer(max_depth=2)
    albedo = scene.get_parameter("floor.bsdf.reflectance.value")
    with torch.no_grad():
        image = tr.render(scene, integrator=light, spp=20000, seed=1) / albedo
    expected = float((2 * image.square().mean((0, 1)) * albedo / 3).sum())

    def found(correlated: bool) -> torch.Tensor:
        values = []
        for seed in range(200):
            x = albedo.detach().clone().requires_grad_()
            image = tr.render(
                scene,
                integrator=light,
                spp=16,  # with fewer a pixel's derivative is mostly zero and rarely huge, no case for a normal law
                seed=seed,
                params={"floor.bsdf.reflectance.value": x},
                correlated=correlated,
            )
            (gradient,) = torch.autograd.grad(image.square().mean(), x)
            values.append(float(gradient.sum()))
        return torch.tensor(values)

    independent, biased = found(False), found(True)
    z = (float(independent.mean()) - expected) / (float(independent.std()) / math.sqrt(200))
    assert abs(z) < 3.3, z
    assert float(biased.mean()) > 1.2 * expected


def test_passes_average_gradients():
    scene, names = glued("area"), ["floor.to_world"]
    light = tr.ParticleTracer(max_depth=2)

    def gradient(**settings) -> torch.Tensor:
        x = scene.get_parameter(names[0]).detach().clone().requires_grad_()
        image = tr.render(scene, integrator=light, spp=2, seed=3, params={names[0]: x}, **settings)
        return torch.autograd.grad((image * weight(image)).sum(), x)[0]

    from torchrender.seeds import mix

    first = mix(3, 0x67726164)
    parts = [gradient(seed_grad=s) for s in (first, mix(first, 1), mix(first, 2))]
    torch.testing.assert_close(gradient(passes=3), sum(parts) / 3, rtol=1e-9, atol=1e-12)


def test_crops_and_pixels_have_the_gradients_of_the_whole():
    scene, name = pathwise("sheet"), "sheet.vertex_positions"
    light = tr.ParticleTracer(max_depth=3)

    def gradient(choose, **settings) -> torch.Tensor:
        x = scene.get_parameter(name).detach().clone().requires_grad_()
        image = tr.render(scene, integrator=light, spp=8, seed=3, params={name: x}, **settings)
        return torch.autograd.grad(choose(image).square().sum(), x)[0]

    pixels = torch.tensor([[2, 3], [5, 1], [2, 3]])
    whole = gradient(lambda image: image[2:6, 1:5])
    assert float(whole.abs().max()) > 0
    torch.testing.assert_close(gradient(lambda i: i, crop=(2, 1, 4, 4)), whole, rtol=1e-9, atol=1e-12)
    some = gradient(lambda image: image[pixels[:, 0], pixels[:, 1]])
    torch.testing.assert_close(gradient(lambda i: i, pixels=pixels), some, rtol=1e-9, atol=1e-12)
