"""A scene among torch's modules: state, copies, sharing, functional calls, optimisers."""

from __future__ import annotations

import copy
import io

import pytest
import torch
from small_scene import COLOUR, TEXELS, ball_and_wall
from torch import nn

import torchrender as tr

MESH = ([[-1.0, -1, 1], [1, -1, 1], [0, 1, 1]], [[0, 1, 2]])


def make(**settings) -> tr.Scene:
    turned = tr.Transform.translate([0, 1, 0]) @ tr.Transform.rotate([1, 0, 0], 90)
    roof = {"type": "rectangle", "to_world": turned, "bsdf": {"type": "ref", "id": "red"}}
    return tr.load_dict(ball_and_wall(roof=roof), **settings)


def picture(scene, **settings):
    return tr.render(scene, **{"seed": 1, **settings}).detach()


class Pipeline(nn.Module):
    """A scene and a network inside a larger module."""

    def __init__(self, scene: tr.Scene) -> None:
        super().__init__()
        self.renderer = tr.Renderer(scene, spp=2)
        self.network = nn.Linear(2, 3)

    def forward(self, inputs: torch.Tensor, seed: int) -> torch.Tensor:
        return self.renderer(seed=seed, params={COLOUR: torch.sigmoid(self.network(inputs))})


# ------------------------------------------------------------------------------------------------------------ state
def test_state_goes_into_another_scene():
    scene, other = make(), make()
    scene["mesh"], other["mesh"] = tr.Mesh(*MESH), tr.Mesh(MESH[0][::-1], [[2, 1, 0]])
    with torch.no_grad():
        for parameter in (scene.red.reflectance.value, scene.mesh.vertex_positions, scene.sensor.x_fov):
            parameter.mul_(0.5)
    state = scene.state_dict()
    assert {COLOUR, TEXELS, "mesh.faces", "sensor.to_world"} <= set(state)
    assert not torch.equal(picture(other), picture(scene))
    report = other.load_state_dict(state)
    assert not report.missing_keys and not report.unexpected_keys
    assert torch.equal(picture(other), picture(scene))
    # Values of one's own from now on.
    with torch.no_grad():
        scene.red.reflectance.value.zero_()
    assert not torch.equal(picture(other), picture(scene))


def test_state_survives_a_file_and_is_checked():
    scene, other = make(), make()
    scene.sky.radiance.value.data.fill_(3)
    stream = io.BytesIO()
    torch.save(scene.state_dict(), stream)
    stream.seek(0)
    state = torch.load(stream, weights_only=True)
    other.load_state_dict(state, assign=True)
    assert torch.equal(picture(other), picture(scene))
    assert other.wall.bsdf is other.red
    del state[COLOUR]
    with pytest.raises(RuntimeError, match=r"Missing key.*red\.reflectance\.value"):
        make().load_state_dict(state)
    with pytest.raises(RuntimeError, match=r"size mismatch for ball\.bsdf\.reflectance\.data"):
        make().load_state_dict({TEXELS: torch.zeros(8, 8, 2)}, strict=False)


def test_faces_that_make_no_sense_are_refused():
    scene = make()
    scene["mesh"] = tr.Mesh(*MESH)
    picture(scene)
    scene.mesh.faces[0, 0] = 7
    with pytest.raises(ValueError, match=r"mesh.*expected vertex indices from 0 to 2, got 7"):
        picture(scene)


@pytest.mark.parametrize("dtype", [torch.int32, torch.int64, torch.uint8, torch.int16])
def test_faces_of_any_integer_dtype(dtype):
    mesh = tr.Mesh(MESH[0], torch.tensor(MESH[1], dtype=dtype))
    assert mesh.faces.dtype == torch.int32 and mesh.faces.tolist() == MESH[1]
    with pytest.raises(ValueError, match="integer indices"):
        tr.Mesh(MESH[0], torch.tensor(MESH[1], dtype=torch.float32))


def test_resumed_training_is_uninterrupted_training():
    """Adam's state and the scene's, saved and loaded in between: the same numbers, bit for bit."""

    def train(steps, saved=None):
        scene = make()
        leaves = scene.train_only("*.reflectance.*")
        optimizer = torch.optim.Adam(leaves, lr=0.05)
        start = 0
        if saved:
            stream = io.BytesIO()
            torch.save(saved, stream)
            stream.seek(0)
            state = torch.load(stream, weights_only=True)
            scene.load_state_dict(state["scene"])
            optimizer.load_state_dict(state["optimizer"])
            start = state["step"]
        for it in range(start, steps):
            optimizer.zero_grad()
            tr.render(scene, seed=it).square().mean().backward()
            optimizer.step()
        return {"scene": scene.state_dict(), "optimizer": optimizer.state_dict(), "step": steps}

    whole, resumed = train(4)["scene"], train(4, train(2))["scene"]
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)


# ----------------------------------------------------------------------------------------------- copies and sharing
def test_a_copy_keeps_what_is_asked_for():
    scene = make()
    scene.train_only(COLOUR)
    tr.render(scene, seed=1).sum().backward()
    other = copy.deepcopy(scene)
    assert [n for n, p in other.named_parameters() if p.requires_grad] == [COLOUR]
    tr.render(other, seed=1).sum().backward()
    assert other.red.reflectance.value is not scene.red.reflectance.value
    assert copy.copy(scene).red is scene.red


def test_one_parameter_in_two_scenes():
    first, second = make(), make()
    second.red.reflectance.value = first.red.reflectance.value
    (colour,) = first.train_only(COLOUR)
    assert second.red.reflectance.value is colour
    singles = [torch.autograd.grad(tr.render(s, seed=i).sum(), colour)[0] for i, s in enumerate((first, second))]
    (tr.render(first, seed=0).sum() + tr.render(second, seed=1).sum()).backward()
    torch.testing.assert_close(colour.grad, singles[0] + singles[1])
    both = nn.ModuleList([first, second])
    assert sum(p is colour for p in both.parameters()) == 1


def test_one_object_in_two_scenes():
    first, second = make(), make()
    second["red"] = first.red
    assert second.wall.bsdf is first.red
    with torch.no_grad():
        first.red.reflectance.value.zero_()
    assert torch.equal(picture(first), picture(second))


def test_two_scenes_do_not_disturb_each_other():
    first, second = make(), make(variant="mono", dtype=torch.float64)
    before = picture(first), picture(second)
    with torch.no_grad():
        second.sky.radiance.value.mul_(2)
    del second["ball"]
    picture(second)
    assert torch.equal(picture(first), before[0])
    del second
    assert torch.equal(picture(first), before[0])


# --------------------------------------------------------------------------------------------------- precision etc.
def test_moving_a_larger_module():
    pipeline = Pipeline(make())
    pipeline.double()
    image = pipeline(torch.ones(2, dtype=torch.float64), 1)
    assert image.dtype == torch.float64 and pipeline.renderer.scene.dtype == torch.float64
    assert pipeline.float()(torch.ones(2), 1).dtype == torch.float32
    pipeline.half()
    with pytest.raises(TypeError, match=r"float32 and float64 .* torch\.float16"):
        picture(pipeline.renderer.scene)
    pipeline.float()
    torch.testing.assert_close(pipeline(torch.ones(2), 1), image.float(), atol=5e-2, rtol=5e-2)


def test_train_eval_and_zero_grad():
    scene = make()
    image = picture(scene)
    assert torch.equal(picture(scene.eval()), image) and not scene.training
    assert torch.equal(picture(scene.train()), image)
    scene.requires_grad_(False)
    scene.red.requires_grad_(True)
    tr.render(scene, seed=1).sum().backward()
    assert scene.red.reflectance.value.grad is not None
    scene.zero_grad()
    assert scene.red.reflectance.value.grad is None


def test_a_name_that_modules_refuse():
    scene = tr.load_dict({"type": "scene", "train": {"type": "diffuse"}, "cpu": {"type": "rectangle"}})
    assert scene["train"] is scene.train_ and scene["cpu"] is scene.cpu_
    assert isinstance(scene.train(), tr.Scene)
    del scene["cpu"]
    assert "cpu" not in scene


# -------------------------------------------------------------------------------------------------- functional calls
def test_functional_call_of_scene_renderer_and_outer_module():
    scene = make()
    pipeline = Pipeline(scene)
    value = torch.tensor([0.2, 0.3, 0.4], requires_grad=True)
    expected = tr.render(scene, seed=1, params={COLOUR: value})
    (gradient,) = torch.autograd.grad(expected.sum(), value)
    before = picture(scene)
    for module, name, kwargs in (
        (scene, COLOUR, {"seed": 1}),
        (scene, "wall.bsdf.reflectance.value", {"seed": 1}),
        (tr.Renderer(scene), f"scene.{COLOUR}", {"seed": 1}),
    ):
        image = torch.func.functional_call(module, {name: value}, kwargs=kwargs)
        assert torch.equal(image, expected)
        assert torch.equal(torch.autograd.grad(image.sum(), value)[0], gradient)
        # The module is what it was: the red material, used by two shapes, too.
        assert isinstance(scene.red.reflectance.value, nn.Parameter)
        assert torch.equal(picture(scene), before)
    weights = {k: v.detach() for k, v in pipeline.network.named_parameters(prefix="network")}
    image = torch.func.functional_call(pipeline, weights, (torch.ones(2), 1))
    assert torch.equal(image, pipeline(torch.ones(2), 1).detach())


def test_functional_call_with_a_texture_of_another_size():
    scene = make()
    texels = torch.rand(7, 9, 3, generator=torch.Generator().manual_seed(0))
    image = torch.func.functional_call(scene, {TEXELS: texels}, kwargs={"seed": 1})
    assert torch.equal(image, picture(scene, params={TEXELS: texels}))


def test_derivatives_of_functional_calls():
    scene = make()

    def f(value):
        return torch.func.functional_call(scene, {COLOUR: value}, kwargs={"seed": 1}).sum()

    value = torch.tensor([0.2, 0.3, 0.4])
    gradient = torch.func.grad(f)(value)
    _, derivative = torch.func.jvp(f, (value,), (torch.ones(3),))
    torch.testing.assert_close(derivative, gradient.sum())
    assert isinstance(scene.red.reflectance.value, nn.Parameter)


# -------------------------------------------------------------------------------------------------------- optimisers
def test_groups_clipping_and_schedules():
    scene = make()
    leaves = scene.train_only("*.reflectance.*")
    assert [tuple(p.shape) for p in leaves] == [(3,), (4, 4, 3)]
    optimizer = torch.optim.SGD([{"params": [leaves[0]], "lr": 0.5}, {"params": [leaves[1]], "lr": 0.0}])
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5)
    before = [p.detach().clone() for p in leaves]
    tr.render(scene, seed=1).sum().backward()
    norm = nn.utils.clip_grad_norm_(leaves, 0.1)
    assert norm > 0.1
    total = torch.stack([p.grad.square().sum() for p in leaves]).sum().sqrt()
    torch.testing.assert_close(total, torch.tensor(0.1))
    expected = before[0] - 0.5 * leaves[0].grad
    optimizer.step()
    schedule.step()
    torch.testing.assert_close(leaves[0].detach(), expected)
    assert torch.equal(leaves[1].detach(), before[1]) and optimizer.param_groups[0]["lr"] == 0.25


@pytest.mark.parametrize("kind", ["loop", "foreach", "fused"])
def test_steps_of_every_implementation_are_seen(kind):
    """Vertices that an optimiser moved: fused ones write without telling autograd, which is made up for."""
    scene = make()
    scene["mesh"] = tr.Mesh(*MESH)
    positions = scene.mesh.vertex_positions
    optimizer = torch.optim.Adam([positions], lr=0.3, foreach=kind == "foreach", fused=kind == "fused")
    before = picture(scene)
    scene.train_only(COLOUR)
    old = tr.render(scene, seed=1, params={"mesh.vertex_positions": positions})
    positions.grad = torch.ones_like(positions)
    optimizer.step()
    after = picture(scene)
    assert not torch.equal(after, before)
    assert torch.equal(picture(copy.deepcopy(scene)), after)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        old.sum().backward()


def test_lbfgs():
    """An optimiser with a closure: one albedo from one image, to the digits that float32 has."""
    scene = make(dtype=torch.float64)
    target = picture(scene)
    (colour,) = scene.train_only(COLOUR)
    true = colour.detach().clone()
    with torch.no_grad():
        colour.fill_(0.4)
    optimizer = torch.optim.LBFGS([colour], max_iter=20, line_search_fn="strong_wolfe")

    def closure():
        optimizer.zero_grad()
        loss = (tr.render(scene, seed=1, correlated=True) - target).square().sum()
        loss.backward()
        return loss

    optimizer.step(closure)
    torch.testing.assert_close(colour.detach(), true, rtol=1e-4, atol=1e-5)


def test_no_drift_from_the_solution():
    """The image itself as target, with the same seed: the loss is zero and Adam stays where it is."""
    scene = make()
    leaves = scene.train_only("*.reflectance.*")
    before = [p.detach().clone() for p in leaves]
    target = picture(scene, seed=4)
    optimizer = torch.optim.Adam(leaves, lr=0.1)
    for _ in range(3):
        optimizer.zero_grad()
        loss = (tr.render(scene, seed=4) - target).square().mean()
        loss.backward()
        optimizer.step()
        assert loss.item() == 0
    assert all(torch.equal(p.detach(), b) for p, b in zip(leaves, before))


def test_constraints_by_parametrization():
    from torch.nn.utils import parametrize

    scene = make()
    parametrize.register_parametrization(scene.ball.bsdf.reflectance, "data", tr.constraints.UnitInterval())
    original = scene.ball.bsdf.reflectance.parametrizations.data.original.requires_grad_()
    optimizer = torch.optim.Adam([original], lr=1.0)
    for it in range(5):
        optimizer.zero_grad()
        (-tr.render(scene, seed=it).sum()).backward()
        optimizer.step()
    data = scene.ball.bsdf.reflectance.data.detach()
    assert bool((data >= 0).all()) and bool((data <= 1).all()) and float(data.max()) > 0.9
    assert torch.equal(picture(copy.deepcopy(scene)), picture(scene))
    assert "ball.bsdf.reflectance.parametrizations.data.original" in scene.state_dict()
    assert "ball.bsdf.reflectance" in repr(scene)


# ----------------------------------------------------------------------------------------------------------- seeds
def test_seeds_of_torch():
    scene = make()
    torch.manual_seed(3)
    first, second = tr.render(scene), tr.render(scene)
    torch.manual_seed(3)
    assert torch.equal(tr.render(scene), first) and torch.equal(tr.render(scene), second)
    assert not torch.equal(first, second)
    generator = torch.Generator().manual_seed(3)
    state = torch.get_rng_state()
    one, two = tr.render(scene, seed=generator), tr.render(scene, seed=generator)
    assert torch.equal(tr.render(scene, seed=torch.Generator().manual_seed(3)), one)
    assert not torch.equal(one, two)
    assert torch.equal(torch.get_rng_state(), state)  # torch's own generator is left alone
    tr.render(scene, seed=5)
    assert torch.equal(torch.get_rng_state(), state)


def test_a_batch_of_one_and_views_alone():
    scene = make()
    for i in range(3):
        scene[f"view{i}"] = tr.PerspectiveCamera.look_at([i, 1, 4], [0, 0, 0], size=(6, 8), filter="box")
    alone = [tr.render(scene, sensor=i, seed=2, spp=2) for i in range(4)]
    assert torch.equal(tr.render(scene, sensor=[2], seed=2, spp=2), alone[2][None])
    assert torch.equal(tr.render(scene, sensor=[3, 0, 2], seed=2, spp=2), torch.stack([alone[i] for i in (3, 0, 2)]))
    single = tr.render(scene, sensor=1, seed=2, spp=2, layout="bchw")
    assert torch.equal(single, alone[1].permute(2, 0, 1)[None])
