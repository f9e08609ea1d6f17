"""The derivative of every parameter of every model, found through the declaration, so that a new model is tested too.

In each of the reference scenes: reverse mode against finite differences of the image (Student test over independent
seeds), forward against reverse mode (equal to rounding), and closed forms where there are some.
"""

from __future__ import annotations

import functools
import math

import pytest
import reference_scenes
import torch

import torchrender as tr

SIGNIFICANCE = 0.01  # of all tests against finite differences together


@functools.cache
def reference(name: str) -> tr.Scene:
    return tr.load_dict(reference_scenes.SCENES[name]().scene, dtype=torch.float64)


def differentiable(scene: tr.Scene) -> dict[str, torch.nn.Parameter]:
    """Parameters with a derivative, by name."""
    found = {}
    for name, parameter in scene.named_parameters():
        try:
            scene.train_only(name)
        except tr.NotDifferentiableError:
            continue
        found[name] = parameter
    scene.train_only()
    return found


# What moves something has tests of its own, in test_motion_derivatives.py.
MOVING = (
    ".to_world .heights .position .center .radius .vertex_positions .vertex_normals .vertex_texcoords .to_uv .eta "
    ".x_fov .principal_point_offset_x .principal_point_offset_y .pixel_aspect .p0 .p1"
).split()
CASES = [
    (name, parameter)
    for name in reference_scenes.SCENES
    for parameter in differentiable(reference(name))
    if not parameter.endswith(tuple(MOVING))
]


def direction_of(value: torch.Tensor) -> torch.Tensor:
    generator = torch.Generator().manual_seed(11)
    return torch.rand(value.shape, generator=generator, dtype=torch.float64) + 0.5


def weight_of(scene: tr.Scene) -> torch.Tensor:
    film = scene.sensors[0].film
    return torch.from_numpy(reference_scenes.weight(*film.window[2:]))


@functools.lru_cache(maxsize=32)
def gradients(name: str, seed: int) -> dict[str, torch.Tensor]:
    """Those of the weighted mean of a scene's image by all of its parameters, in one pass."""
    scene = reference(name)
    values = {p: scene.get_parameter(p).detach().clone().requires_grad_() for n, p in CASES if n == name}
    # Derivatives have samples of their own: where one is asked for, those of the image do not matter.
    image = tr.render(scene, spp=1, spp_grad=4, seed=seed, params=values)
    return dict(zip(values, torch.autograd.grad((image * weight_of(scene)).mean(), list(values.values()))))


@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_reverse_mode_against_finite_differences(name, parameter):
    scene = reference(name)
    value = scene.get_parameter(parameter).detach()
    together = True
    if name == "hidden_and_null" and not value.any():
        # Near a throughput of zero Russian roulette lets almost no path live and weights the rest enormously: the
        # differences would have no usable variance. The derivative at zero is tested in the scenes without roulette.
        value, together = torch.full_like(value, 0.3), False
    weight = weight_of(scene)

    def f(x, seed):
        if x.requires_grad and together:
            return (x * gradients(name, seed)[parameter]).sum()  # which has the derivative that is tested
        image = tr.render(scene, spp=4, seed=seed, params={parameter: x})
        return (image * weight).mean()

    result = tr.testing.check_gradients(
        f,
        value,
        direction=direction_of(value),
        step=1e-3 * max(1e-2, float(value.abs().max())),
        seeds=range(12),
        significance=SIGNIFICANCE,
        tests=len(CASES),
        rtol=2e-3,
    )
    assert result, f"{name} {parameter}: {result.message}"


@pytest.mark.parametrize("name", list(reference_scenes.SCENES))
def test_forward_and_reverse_mode_agree(name):
    scene = reference(name)
    parameters = differentiable(scene)

    def f(*tensors):
        return tr.render(scene, spp=2, seed=5, params=dict(zip(parameters, tensors)))

    result = tr.testing.dot_product_test(f, [p.detach() for p in parameters.values()], rtol=1e-10)
    assert result, result.message


@pytest.mark.parametrize("name", list(reference_scenes.SCENES))
def test_each_parameter_changes_the_image(name):
    """A derivative that is zero would agree with everything: nearly all parameters of these scenes matter."""
    scene = reference(name)
    parameters = list(differentiable(scene).values())
    scene.train_only(*differentiable(scene))
    image = tr.render(scene, spp=4, seed=5)
    gradients = torch.autograd.grad(image.sum(), parameters)
    scene.train_only()
    moved = [bool((g != 0).any()) for g in gradients]
    assert sum(moved) >= 0.5 * len(moved)


# ------------------------------------------------------------------------------------------------------ closed forms
def plain(light: dict, **objects) -> tr.Scene:
    """A diffuse square at z = 0 that fills the view of a camera above it."""
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 2,
                "to_world": tr.Transform.look_at([0, 0, 5], [0, 0, 0]),
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
            "paint": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.8]}},
            "square": {
                "type": "rectangle",
                "to_world": tr.Transform.scale(10),
                "bsdf": {"type": "ref", "id": "paint"},
            },
            "light": light,
            **objects,
        },
        dtype=torch.float64,
    )


def test_position_of_a_point_light():
    """Radiance albedo / pi * I cos / r^2 with cos = h / r: everything about it in closed form."""
    scene = plain({"type": "point", "position": [0.6, 0.3, 1.5], "intensity": {"type": "rgb", "value": [3, 2, 1]}})
    position, paint = scene.light.position, scene.paint.reflectance.value
    scene.train_only("light.position", "light.intensity.value", "paint.*")
    image = tr.render(scene, spp=64, seed=1, integrator=tr.PathTracer(max_depth=2)).mean((0, 1))

    exact_position = position.detach().clone().requires_grad_()
    exact_paint = paint.detach().clone().requires_grad_()
    exact_intensity = scene.light.intensity.value.detach().clone().requires_grad_()
    r2 = exact_position.square().sum()
    exact = exact_paint / math.pi * exact_intensity * exact_position[2] / r2**1.5
    torch.testing.assert_close(image, exact, rtol=2e-3, atol=0)
    for c in range(3):
        ours = torch.autograd.grad(image[c], [position, paint, scene.light.intensity.value], retain_graph=True)
        theirs = torch.autograd.grad(exact[c], [exact_position, exact_paint, exact_intensity], retain_graph=True)
        for mine, expected in zip(ours, theirs):
            torch.testing.assert_close(mine, expected, rtol=1e-2, atol=1e-3)


def test_radiance_and_albedo_in_a_furnace():
    """Inside a sphere that emits and reflects: radiance L (1 + a + a^2 + ... ) with as many terms as the path has."""
    inside = {
        "type": "sphere",
        "radius": 3.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.0, 0.9]}},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 0.5]}},
    }
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}},
            "furnace": inside,
        },
        dtype=torch.float64,
    )
    albedo = scene.furnace.bsdf.reflectance.value
    radiance = scene.furnace.emitter.radiance.value
    scene.train_only("furnace.bsdf.*", "furnace.emitter.radiance.*")
    depth = 4
    integrator = tr.PathTracer(max_depth=depth, rr_depth=100)
    image = tr.render(scene, spp=256, seed=1, integrator=integrator).mean((0, 1))
    a = albedo.detach().clone().requires_grad_()
    emitted = radiance.detach().clone().requires_grad_()
    exact = emitted * sum(a**k for k in range(depth))
    torch.testing.assert_close(image, exact, rtol=0.02, atol=0)
    ours = torch.autograd.grad(image.sum(), [albedo, radiance])
    theirs = torch.autograd.grad(exact.sum(), [a, emitted])
    for mine, expected in zip(ours, theirs):
        torch.testing.assert_close(mine, expected, rtol=0.03, atol=0)
    # The middle channel has albedo 0: the derivative there is L, not a silent zero.
    assert float(ours[0][1]) == pytest.approx(2.0, rel=0.03)


def test_scale_and_texels_of_an_environment():
    """A constant environment over a diffuse plane: radiance albedo * L, linear in the texels and in the scale."""
    texels = torch.full((4, 8, 3), 0.7, dtype=torch.float64)
    scene = plain({"type": "envmap", "data": texels, "scale": 2.0})
    scene.train_only("light.data", "light.scale")
    image = tr.render(scene, spp=512, seed=1, integrator=tr.PathTracer(max_depth=2)).mean((0, 1))
    paint = scene.paint.reflectance.value.detach()
    torch.testing.assert_close(image, paint * 1.4, rtol=0.02, atol=0)
    data, scale = torch.autograd.grad(image[1], [scene.light.data, scene.light.scale])
    assert float(scale) == pytest.approx(0.5 * 0.7, rel=0.02)
    assert float((data * 0.7).sum()) == pytest.approx(0.5 * 1.4, rel=0.02)  # Euler's theorem: it is linear
    assert float(data[..., [0, 2]].abs().max()) == 0  # channels do not mix


def test_weights_of_a_bilinear_texture():
    """What the camera sees through a texture seen frontally: weights that add up to the light."""
    texture = {"type": "bitmap", "data": torch.full((3, 5, 3), 0.5, dtype=torch.float64), "raw": True}
    scene = plain(
        {"type": "constant", "radiance": 2.0},
        painting={
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 0, 1]),
            "bsdf": {"type": "diffuse", "reflectance": texture},
        },
    )
    data = scene.painting.bsdf.reflectance.data
    scene.train_only("painting.bsdf.*")
    image = tr.render(scene, spp=256, seed=1, integrator=tr.PathTracer(max_depth=2)).mean((0, 1))
    (gradient,) = torch.autograd.grad(image[0], data)
    assert float(gradient[..., 0].sum()) == pytest.approx(2.0, rel=0.02)
    assert float(gradient[..., 1:].abs().max()) == 0
    # The view is a small square about the middle of the texture, which belongs to the middle texel.
    assert float(gradient[1, 2, 0]) > 0.8 * float(gradient[..., 0].sum())
