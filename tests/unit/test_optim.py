"""Optimisers and the growing of parameters with their state."""

import io

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

from torchrender.constraints import UnitInterval
from torchrender.optim import MaskedAdam, UniformAdam, resample, upsample, upsample_tensor


def run(optimizer_class, start, gradients, **options):
    """The values after each step along given gradients."""
    parameter = nn.Parameter(start.clone())
    optimizer = optimizer_class([parameter], **options)
    values = []
    for gradient in gradients:
        parameter.grad = gradient.clone()
        optimizer.step()
        values.append(parameter.detach().clone())
    return torch.stack(values)


@pytest.fixture
def gradients():
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(4, 3, generator=generator, dtype=torch.float64) for _ in range(6)]


def test_uniform_adam_follows_its_formula(gradients):
    values = run(UniformAdam, torch.zeros(4, 3, dtype=torch.float64), gradients, lr=0.1, betas=(0.8, 0.95))
    first = second = value = torch.zeros(4, 3, dtype=torch.float64)
    for t, gradient in enumerate(gradients, 1):
        first = 0.8 * first + 0.2 * gradient
        second = 0.95 * second + 0.05 * gradient**2
        denominator = (second / (1 - 0.95**t)).sqrt().max() + 1e-8
        value = value - 0.1 * first / (1 - 0.8**t) / denominator
        assert torch.allclose(values[t - 1], value, rtol=1e-12)


def test_uniform_adam_steps_along_the_gradient():
    gradient = torch.tensor([3.0, -1.0, 0.5])
    value = run(UniformAdam, torch.zeros(3), [gradient], lr=0.1)[0]
    assert torch.allclose(value, -0.1 * gradient / 3)


def test_masked_adam_equals_adam_where_nothing_is_masked(gradients):
    start = torch.ones(4, 3, dtype=torch.float64)
    assert torch.allclose(
        run(MaskedAdam, start, gradients, lr=0.1), run(torch.optim.Adam, start, gradients, lr=0.1), rtol=1e-10
    )


@pytest.mark.parametrize(("optimizer_class", "options"), [(MaskedAdam, {}), (UniformAdam, {"mask_updates": True})])
def test_masked_entries_keep_value_and_state(optimizer_class, options):
    parameter = nn.Parameter(torch.tensor([1.0, 1.0]))
    optimizer = optimizer_class([parameter], lr=0.1, **options)
    parameter.grad = torch.tensor([1.0, 1.0])
    optimizer.step()
    value, state = parameter.detach().clone(), {k: v.clone() for k, v in optimizer.state[parameter].items()}
    parameter.grad = torch.tensor([0.0, 0.5])
    optimizer.step()
    assert parameter[0] == value[0] and parameter[1] != value[1]
    for key, before in state.items():
        after = optimizer.state[parameter][key]
        assert after[0] == before[0] and after[1] != before[1]


def test_late_first_visit_makes_a_step_of_normal_length():
    gradients = [torch.tensor([1.0, 0.0])] * 50 + [torch.tensor([1.0, 1.0])]
    values = run(MaskedAdam, torch.zeros(2), gradients, lr=0.1)
    assert torch.allclose(values[-1, 1], torch.tensor(-0.1), atol=1e-4) and values[-2, 1] == 0


@pytest.mark.parametrize("optimizer_class", [UniformAdam, MaskedAdam])
def test_convergence_and_state_dict(optimizer_class):
    target = torch.tensor([0.3, -0.7, 2.0])
    parameter = nn.Parameter(torch.zeros(3))
    optimizer = optimizer_class([parameter], lr=0.05)

    def closure():
        optimizer.zero_grad()
        loss = (parameter - target).square().sum()
        loss.backward()
        return loss

    for _ in range(50):
        optimizer.step(closure)
    stream = io.BytesIO()
    torch.save({"p": parameter.data, "o": optimizer.state_dict()}, stream)
    stream.seek(0)
    saved = torch.load(stream)
    twin = nn.Parameter(saved["p"].clone())
    restored = optimizer_class([twin], lr=1.0)
    restored.load_state_dict(saved["o"])
    for p, o in ((parameter, optimizer), (twin, restored)):
        p.grad = torch.tensor([1.0, 2.0, 3.0])
        o.step()
    assert torch.equal(parameter, twin)
    for _ in range(600):
        loss = optimizer.step(closure)
    assert loss < 1e-4


@pytest.mark.parametrize("bad", [{"lr": -1}, {"betas": (1.0, 0.9)}, {"betas": (0.9,)}, {"eps": -1}])
def test_bad_options(bad):
    for optimizer_class in (UniformAdam, MaskedAdam):
        with pytest.raises(ValueError, match=next(iter(bad))):
            optimizer_class([nn.Parameter(torch.zeros(2))], **bad)


def test_resample_equals_torch_where_the_border_is_clamped():
    texture = torch.rand(5, 7, 3, dtype=torch.float64)
    expected = nn.functional.interpolate(texture.permute(2, 0, 1)[None], size=(13, 14), mode="bilinear")[0]
    assert torch.allclose(resample(texture, (13, 14), "clamp"), expected.permute(1, 2, 0), atol=1e-12)
    volume = torch.rand(3, 4, 5, 2, dtype=torch.float64)
    expected = nn.functional.interpolate(volume.permute(3, 0, 1, 2)[None], size=(6, 4, 11), mode="trilinear")[0]
    assert torch.allclose(resample(volume, (6, 4, 11), "clamp"), expected.permute(1, 2, 3, 0), atol=1e-12)


def test_resample_wraps():
    row = torch.tensor([0.0, 1.0, 4.0]).reshape(3, 1)
    # The first of six texels lies a quarter texel before the first of three.
    assert torch.allclose(resample(row, (6,), "repeat")[0], torch.tensor([0.25 * 4.0]))
    assert torch.allclose(resample(row, (6,), "mirror")[0], torch.tensor([0.0]))
    assert torch.allclose(resample(row, (6,), "clamp")[:, 0], torch.tensor([0.0, 0.25, 0.75, 1.75, 3.25, 4.0]))
    both = resample(torch.rand(3, 3, 1), (6, 6), ("clamp", "repeat"))
    assert both.shape == (6, 6, 1)
    texture = torch.rand(4, 4, 1, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: resample(t, (8, 6)), texture)
    for bad in [((0, 3), "repeat"), ((3, 3, 3, 3), "repeat"), ((3, 3), "wrap"), ((3, 3), ("clamp",))]:
        with pytest.raises(ValueError, match="expected"):
            resample(texture, *bad)


def scene_like():
    """Two objects that share one texture module, and a third parameter."""
    torch.manual_seed(0)
    scene = nn.Module()
    scene.wall, scene.floor = nn.Module(), nn.Module()
    texture = nn.Module()
    texture.wrap_mode = "clamp"
    texture.data = nn.Parameter(torch.rand(4, 4, 3))
    scene.wall.texture = scene.floor.texture = texture
    scene.floor.other = texture.data
    scene.radiance = nn.Parameter(torch.ones(3))
    return scene


@pytest.mark.parametrize(
    "make",
    [
        lambda p: torch.optim.Adam(p, lr=0.1, amsgrad=True),
        lambda p: torch.optim.SGD(p, lr=0.02, momentum=0.9),
        lambda p: torch.optim.RMSprop(p, lr=0.1, momentum=0.9),
        lambda p: torch.optim.Adagrad(p, lr=0.1),
        lambda p: UniformAdam(p, lr=0.1),
        lambda p: MaskedAdam(p, lr=0.1),
    ],
    ids=["adam", "sgd", "rmsprop", "adagrad", "uniform", "masked"],
)
def test_upsample_replaces_everywhere(make):
    scene = scene_like()
    old = scene.wall.texture.data
    optimizer = make(list(scene.parameters()))

    def loss():
        return (scene.wall.texture.data - 0.3).square().mean() + scene.radiance.square().sum()

    for _ in range(3):
        optimizer.zero_grad()
        kept = loss()  # a graph that still refers to the old parameter
        kept.backward()
        optimizer.step()
    value = old.detach().clone()
    new = upsample(scene, "wall.texture.data", (8, 16), optimizer)
    assert new is scene.floor.texture.data and new is scene.floor.other and new.shape == (8, 16, 3)
    assert torch.equal(new, resample(value, (8, 16), "clamp"))
    held = [p for group in optimizer.param_groups for p in group["params"]]
    assert any(p is new for p in held) and not any(p is old for p in held) and old not in optimizer.state
    before = loss().item()
    for _ in range(20):
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()
    assert loss().item() < before and not torch.equal(new, resample(value, (8, 16), "clamp"))


def test_step_after_upsampling_is_as_long_as_before():
    """The state is scaled with the gradient, which is shared out among more texels."""
    parameter = nn.Parameter(torch.full((4, 4, 1), 0.9))
    optimizer = torch.optim.Adam([parameter], lr=0.01)

    def step():
        before = parameter.detach().clone()
        optimizer.zero_grad()
        (parameter.mean() * 3).backward()
        optimizer.step()
        return (before - parameter.detach()).mean()

    lengths = [step() for _ in range(5)]
    parameter = upsample_tensor(parameter, (16, 16), optimizer)
    assert parameter.requires_grad
    assert torch.allclose(torch.stack([lengths[-1], *(step() for _ in range(5))]), torch.tensor(0.01), rtol=1e-3)


def test_upsample_of_a_constrained_parameter():
    scene = scene_like()
    texture = scene.wall.texture
    del scene.floor.other
    parametrize.register_parametrization(texture, "data", UnitInterval())
    optimizer = torch.optim.Adam(scene.parameters(), lr=0.1)
    texture.data.mean().backward()
    optimizer.step()
    expected = resample(texture.data.detach(), (8, 8), "clamp")
    new = upsample(scene, "wall.texture.data", (8, 8), optimizer)
    assert torch.allclose(texture.data, expected, atol=1e-5)
    assert new is texture.parametrizations.data.original
    texture.data.mean().backward()
    optimizer.step()
    assert bool((texture.data < expected).all())


@pytest.mark.parametrize("optimizer_class", [torch.optim.Adam, UniformAdam])
def test_upsample_of_heights_without_channels(optimizer_class):
    lens = nn.Module()
    lens.heights = nn.Parameter(torch.rand(3, 4, generator=torch.Generator().manual_seed(1)))
    optimizer = optimizer_class(lens.parameters(), lr=0.01)
    (lens.heights[:2].sum() * 2).backward()
    optimizer.step()
    old, moment = lens.heights.detach().clone(), optimizer.state[lens.heights]["exp_avg"].clone()
    new = upsample(lens, "heights", (6, 8), optimizer)
    assert new is lens.heights and torch.equal(new, resample(old, (6, 8), "clamp"))
    assert torch.equal(optimizer.state[new]["exp_avg"], resample(moment, (6, 8), "clamp") / 4)
    assert upsample_tensor(new, (12, 8), optimizer).shape == (12, 8)
    assert upsample_tensor(old, (6,)).shape == (6, 4)
    with pytest.raises(ValueError, match=r"expected 2 numbers of at least \(6, 8\) for shape \(6, 8\), got \(6, 7\)"):
        upsample(lens, "heights", (6, 7))


def test_upsample_errors():
    scene = scene_like()
    with pytest.raises(ValueError, match=r"'wall\.texture\.dat' is not a parameter.*'wall\.texture\.data'"):
        upsample(scene, "wall.texture.dat", (8, 8))
    with pytest.raises(ValueError, match=r"no parameter 'wal\.texture\.data'"):
        upsample(scene, "wal.texture.data", (8, 8))
    with pytest.raises(ValueError, match=r"at least \(4, 4\)"):
        upsample(scene, "wall.texture.data", (8, 2))
    with pytest.raises(ValueError, match="does not have the parameter"):
        upsample(scene, "wall.texture.data", (8, 8), torch.optim.Adam([scene.radiance]))
    lbfgs = torch.optim.LBFGS([scene.wall.texture.data])
    lbfgs.step(lambda: scene.wall.texture.data.square().sum())
    lbfgs.state[scene.wall.texture.data]["d"] = torch.zeros(48)
    with pytest.raises(TypeError, match="LBFGS"):
        upsample(scene, "wall.texture.data", (8, 8), lbfgs)
    assert scene.wall.texture.data.shape == (4, 4, 3)
