"""Parameters that leave their range while they are optimised."""

import pytest
import torch
from first_scene import make, said

import torchrender as tr


def test_parameters_that_leave_their_range_are_named_once():
    scene = make()
    (albedo,) = scene.train_only("ball.bsdf.reflectance.value")
    assert said(scene) == []
    with torch.no_grad():
        albedo.fill_(1.7)
    (first,) = said(scene)
    assert "ball.bsdf.reflectance.value: 1.7 is outside of [0, 1]" in first
    assert "parameter.clamp_(0, 1)" in first and "tr.constraints.ScaledSigmoid(0, 1)" in first
    with torch.no_grad():
        albedo.fill_(-5e12)
        scene.sky.radiance.value.fill_(-1)
    (second,) = said(scene)
    assert "sky.radiance.value: -1 is outside of [0, inf]" in second and "Positive(0)" in second
    assert said(scene) == []


def test_large_tensors_and_substitutes_are_looked_at():
    texels = torch.full((32, 32, 3), 0.5)
    scene = make(ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texels}})
    name = "ball.bsdf.reflectance.data"
    leaf = texels.clone().requires_grad_()
    shifted = leaf - 0.8
    (text,) = said(scene, params={name: shifted})
    assert f"{name}: -0.3 is outside of [0, 1]" in text
    with pytest.raises(ValueError, match=f"render: {name}: -0.3 is outside of"):
        tr.render(scene, spp=1, params={name: shifted}, range="raise")
    tr.render(scene, spp=1, params={name: shifted}, range="ignore").sum().backward()
    assert leaf.grad is not None
    assert tr.render(scene, spp=1, range="raise").shape == (8, 12, 3)


def test_range_raise_says_it_every_time():
    scene = make()
    with torch.no_grad():
        scene.ball.bsdf.reflectance.value.fill_(-0.5)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"-0.5 is outside of \[0, 1\], the range of reflectance"):
            tr.render(scene, spp=1, range="raise")


def test_rounding_is_no_error():
    scene = make()
    with torch.no_grad():
        scene.ball.bsdf.reflectance.value.fill_(1 + 2e-7)
    assert said(scene, range="raise") == []


def test_ranges_in_function_transforms():
    scene = make()
    name = "ball.bsdf.reflectance.value"
    function = lambda c: tr.render(scene, spp=1, seed=0, params={name: c}).mean()  # noqa: E731
    gradient = torch.func.grad(function)(torch.full((3,), 0.5))
    assert bool((gradient > 0).all())


def test_values_within_textures_are_looked_at():
    scene = make(ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "volume", "volume": 0.5}}})
    value = scene.ball.bsdf.reflectance.volume.value.value
    assert said(scene) == []
    with torch.no_grad():
        value.fill_(1.5)
    (text,) = said(scene)
    assert "ball.bsdf.reflectance.volume.value.value: 1.5 is outside of [0, 1], the range of reflectance" in text
