"""Derivatives of blends, masks, normal and bump maps, against finite differences.

Statistical statements are z-tests of means over independent seeds; every test's level is 1e-3.
"""

from __future__ import annotations

import math

import layer_scenes
import numpy as np
import pytest
import torch
from layer_rooms import BRUSHED, DARK, MIRROR, PAINT, room, soft
from motion_scenes import at_ball, ball, black_room, camera, floor, lamp, scene

import torchrender as tr
from torchrender import Transform

# --- derivatives ----------------------------------------------------------------------------------------------------


def derivative(loaded: tr.Scene, name: str, direction: torch.Tensor, seed: int, spp: int, **more) -> float:
    x = loaded.get_parameter(name).detach().clone().requires_grad_()
    image = tr.render(loaded, spp=spp, seed=seed, seed_grad=seed + 1000, params={name: x}, **more)
    (gradient,) = torch.autograd.grad(image.mean(), x)
    return float((gradient * direction).sum())


def difference(loaded: tr.Scene, name: str, direction: torch.Tensor, step: float, seed: int, spp: int, **more) -> float:
    x = loaded.get_parameter(name).detach()
    with torch.no_grad():
        a, b = (
            tr.render(loaded, spp=spp, seed=seed, params={name: x + s * direction}, **more).double().mean()
            for s in (step, -step)
        )
    return float(a - b) / (2 * step)


def agree(loaded: tr.Scene, name: str, direction: torch.Tensor, step: float, spp: int = 256, runs: int = 12, **more):
    ours = torch.tensor([derivative(loaded, name, direction, 7 * k, spp, **more) for k in range(runs)])
    theirs = torch.tensor([difference(loaded, name, direction, step, 7 * k, spp, **more) for k in range(runs)])
    error = float((ours.var() / runs + theirs.var() / runs).sqrt())
    gap = abs(float(ours.mean() - theirs.mean()))
    assert gap < 4.4 * error + 3e-3 * abs(float(theirs.mean())), f"{name}: {ours.mean()}, {theirs.mean()} +- {error}"
    assert abs(float(theirs.mean())) > 3 * error, f"{name}: nothing is measured, {theirs.mean()} +- {error}"


@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("kinds", [(PAINT, DARK), (MIRROR, PAINT), (PAINT, BRUSHED)], ids=["paints", "mirror", "metal"])
def test_derivative_by_the_weight(kinds, weight):
    """The image is linear in the weight: the difference of the parts' images is the derivative, at 0 and 1, too."""
    loaded = tr.load_dict(
        scene(2, at_ball(), ball=ball(layer_scenes.blend(*kinds, weight)), room=black_room()), dtype=torch.float64
    )
    name = "ball.bsdf.weight.value"
    ours = torch.tensor([derivative(loaded, name, torch.ones(()), 3 * k, 64) for k in range(16)])
    ends = [
        torch.tensor([float(tr.render(room(kind, 2), spp=64, seed=k).double().mean()) for k in range(16)])
        for kind in kinds
    ]
    expected = ends[1] - ends[0]
    error = float((ours.var() / 16 + expected.var() / 16).sqrt())
    assert abs(float(ours.mean() - expected.mean())) < 4.4 * error


def test_derivative_by_the_opacity():
    loaded = room(layer_scenes.mask({"type": "twosided", "bsdf": PAINT}, 0.6), 4)
    agree(loaded, "ball.bsdf.opacity.value", torch.ones(()), 0.1)


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("opacity", [0.0, 0.9, 1.0])
def test_holes_before_a_lamp(opacity, correlated):
    """The image is 1 - opacity, though no path of an image of opacity 1 meets the lamp."""
    loaded = tr.load_dict(
        scene(
            2,
            camera([0, 0, 5], [0, 0, 0], 30),
            sheet={"type": "rectangle", "to_world": Transform.scale(3.0), "bsdf": layer_scenes.mask(PAINT, opacity)},
            lamp={
                "type": "rectangle",
                "to_world": Transform.translate([0, 0, -1]) @ Transform.scale(9.0),
                "emitter": {"type": "area", "radiance": 1.0},
            },
        )
    )
    found = []
    for seed in range(16):
        x = torch.tensor(opacity, requires_grad=True)
        params = {"sheet.bsdf.opacity.value": x}
        tr.render(loaded, spp=64, seed=seed, correlated=correlated, params=params).mean().backward()
        found.append(float(x.grad))
    mean, error = np.mean(found), np.std(found, ddof=1) / 4
    assert abs(mean + 1) < 4.1 * error + 1e-5, f"{mean} +- {error}"  # Student's t of 15 degrees of freedom


@pytest.mark.parametrize(
    "name", ["ball.bsdf.weight.data", "ball.bsdf.bsdf_0.reflectance.value", "ball.bsdf.bsdf_1.alpha.value"]
)
def test_derivatives_inside_of_a_textured_blend(name):
    loaded = room(layer_scenes.blend(PAINT, BRUSHED))
    agree(loaded, name, torch.ones_like(loaded.get_parameter(name)), 0.03)


@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=3)], ids=["path", "particles"])
@pytest.mark.parametrize("kind", ["diffuse", "rough"])
def test_derivative_by_a_normal_map(kind, integrator):
    bsdf = PAINT if kind == "diffuse" else {**BRUSHED, "alpha": 0.6}
    lights = {"lamp": lamp("rectangle")}
    mapped = layer_scenes.normal_map(bsdf, flip_invalid_normals=False)
    loaded = tr.load_dict(soft(scene(2, camera([0.3, 1, 4], [0, 0, 0], 20), floor=floor(mapped), **lights)))
    name = "floor.bsdf.normalmap.data"
    generator = torch.Generator().manual_seed(4)
    direction = torch.randn(loaded.get_parameter(name).shape, generator=generator)
    direction[..., 0] += 1.0
    more = {} if integrator is None else {"integrator": integrator}
    agree(loaded, name, direction, 0.01, 256, **more)


@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=2)], ids=["path", "particles"])
@pytest.mark.parametrize("name", ["nested_texture.data", "scale"])
def test_derivative_by_heights(name, integrator):
    mapped = layer_scenes.bump_map(PAINT, 0.2, flip_invalid_normals=False)
    mapped["heights"]["data"] = mapped["heights"]["data"][::6, ::8].copy()
    view = camera([0.3, 1, 4], [0, 0, 0], 20)
    loaded = tr.load_dict(soft(scene(2, view, floor=floor(mapped), lamp=lamp("rectangle"))))
    name = f"floor.bsdf.{name}"
    value = loaded.get_parameter(name)
    direction = torch.randn(value.shape, generator=torch.Generator().manual_seed(4)) if value.ndim else torch.ones(())
    more = {} if integrator is None else {"integrator": integrator}
    agree(loaded, name, direction, 0.02, 256, **more)


@pytest.mark.parametrize("outputs", [None, ("albedo",)], ids=["image", "albedo"])
def test_clamped_weights_have_no_derivative(outputs):
    texels = torch.tensor([[1.5, 1.5], [-0.5, -0.5]])[..., None]  # a row above 1, a row below 0
    weight = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "nearest"}
    loaded = room(layer_scenes.blend(PAINT, DARK, weight), 2)
    loaded.train_only("ball.bsdf.weight.data")
    found = tr.render(loaded, spp=16, seed=1, outputs=outputs)
    (found if outputs is None else found.albedo).sum().backward()
    assert float(loaded.get_parameter("ball.bsdf.weight.data").grad.abs().max()) == 0


@pytest.mark.parametrize("kind", ["blend", "mask", "normalmap", "bumpmap"])
def test_forward_and_reverse_mode_agree(kind):
    both = {"type": "twosided", "bsdf": PAINT}
    bsdf = {
        "blend": layer_scenes.blend(PAINT, BRUSHED),
        "mask": layer_scenes.mask(both),
        "normalmap": layer_scenes.normal_map({**BRUSHED, "alpha": 0.6}),
        "bumpmap": layer_scenes.bump_map({**BRUSHED, "alpha": 0.6}),
    }[kind]
    loaded = tr.load_dict(scene(4, at_ball(), ball=ball(bsdf), room=black_room()), dtype=torch.float64)
    name = {
        "blend": "weight.data",
        "mask": "opacity.data",
        "normalmap": "normalmap.data",
        "bumpmap": "nested_texture.data",
    }[kind]
    name = f"ball.bsdf.{name}"
    value = loaded.get_parameter(name).detach()
    direction = torch.randn(value.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)

    def image(x):
        return tr.render(loaded, spp=8, seed=1, params={name: x})

    _, tangent = torch.func.jvp(image, (value,), (direction,))
    x = value.clone().requires_grad_()
    weight = torch.rand(tangent.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    (gradient,) = torch.autograd.grad((image(x) * weight).sum(), x)
    assert math.isclose(float((gradient * direction).sum()), float((tangent * weight).sum()), rel_tol=1e-8)


def test_derivatives_of_light_paths_through_layers():
    loaded = tr.load_dict(
        scene(
            2,
            camera([0.3, 1, 4], [0, 0, 0], 20),
            floor=floor(layer_scenes.blend(PAINT, BRUSHED, 0.4)),
            lamp=lamp("rectangle"),
        )
    )
    agree(loaded, "floor.bsdf.weight.value", torch.ones(()), 0.1, integrator=tr.ParticleTracer(max_depth=2))
