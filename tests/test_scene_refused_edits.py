"""Edits of a scene: what is refused leaves it as it was, what is taken stays a parameter."""

from __future__ import annotations

import copy

import pytest
import torch
from small_scene import COLOUR, ball_and_wall
from torch import nn

import torchrender as tr


def make(**objects) -> tr.Scene:
    return tr.load_dict(ball_and_wall(**objects))


def picture(scene: tr.Scene, **settings) -> torch.Tensor:
    return tr.render(scene, seed=1, **settings).detach()


# ---------------------------------------------------------------------------------------------- references and objects
def test_a_refused_edit_keeps_the_order():
    scene = make(zebra={"type": "disk"})
    names, before = list(scene), tr.render(scene, outputs=("shape_id",), seed=1).shape_id
    parameters = [n for n, _ in scene.named_parameters()]
    with pytest.raises(ValueError, match="no object with the id 'rde'"):
        scene["wall"] = {"type": "rectangle", "bsdf": {"type": "ref", "id": "rde"}}
    with pytest.raises(ValueError, match="reflectance"):
        scene.red.reflectance = 1.5
    with pytest.raises(ValueError, match="radius"):
        scene.ball.radius = float("nan")
    assert list(scene) == names and [n for n, _ in scene.named_parameters()] == parameters
    assert torch.equal(tr.render(scene, outputs=("shape_id",), seed=1).shape_id, before)


def test_references_survive_a_refused_scene():
    ball = tr.Sphere(bsdf={"type": "ref", "id": "late"})
    wall = tr.Rectangle(bsdf={"type": "ref", "id": "red"})
    with pytest.raises(ValueError, match="no object with the id 'late'"):
        make(ball=ball, wall=wall)
    scene = make(late={"type": "diffuse", "reflectance": 0.1}, ball=ball, wall=wall)
    assert scene.ball.bsdf is scene.late and scene.wall.bsdf is scene.red  # and not the refused scene's
    two = tr.TwoSided(front={"type": "ref", "id": "later"})
    with pytest.raises(ValueError, match="no object with the id 'later'"):
        scene["two"] = two
    scene["later"] = tr.Diffuse()
    scene["two"] = two
    assert scene.two.brdf_0 is scene.later


def test_references_are_not_assigned_to_attributes():
    scene = make(black={"type": "diffuse", "reflectance": 0.0})
    before = picture(scene)
    reference = {"type": "ref", "id": "black"}
    for value in (reference, {"type": "twosided", "inside": reference}, tr.TwoSided(inside=reference)):
        with pytest.raises(ValueError, match=r"Sphere\.bsdf: .* assign the object itself: scene\['black'\]"):
            scene.ball.bsdf = value
    assert torch.equal(picture(scene), before)
    scene.ball.bsdf = scene["black"]
    assert not torch.equal(picture(scene), before)
    # What is assigned later counts, not a reference from before that waits for its scene.
    ball = tr.Sphere(bsdf=reference)
    ball.bsdf = tr.Diffuse(reflectance=0.9)
    scene["ball"] = ball
    assert scene.ball.bsdf is not scene.black


# ------------------------------------------------------------------------------------------------------------- leaves
@pytest.mark.parametrize("what", ["leaf", "parameter", "parameter of another precision"])
def test_an_assigned_leaf_becomes_a_parameter(what):
    scene = make()
    names = [n for n, _ in scene.named_parameters()]
    value = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    if what != "leaf":
        value = nn.Parameter(value.detach().to(torch.float32 if what == "parameter" else torch.float64))
    scene.red.reflectance.value = value
    assert [n for n, _ in scene.named_parameters()] == names and COLOUR in scene.state_dict()
    own = scene.get_parameter(COLOUR)
    assert own.requires_grad and own.dtype == torch.float32 and (own is value) == (what == "parameter")
    torch.testing.assert_close(own.detach(), value.detach().float())
    tr.render(scene, seed=1).sum().backward()
    assert bool((scene.red.reflectance.value.grad != 0).any())
    copy.deepcopy(scene)


def test_a_leaf_in_the_place_of_a_texture_becomes_a_parameter():
    scene = make()
    scene.red.reflectance = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    scene.ball.bsdf.reflectance = torch.full((2, 2, 3), 0.5, requires_grad=True)
    assert scene.get_parameter(COLOUR).requires_grad
    assert scene.get_parameter("ball.bsdf.reflectance.data").requires_grad
    with pytest.raises(ValueError, match="result of a computation"):
        scene.red.reflectance.value = torch.rand(3, requires_grad=True) * 0.5
