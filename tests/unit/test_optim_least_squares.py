"""Least squares by the light that parameters have: the formula, the pyramid, convergence, errors."""

import io

import pytest
import torch
from torch import nn

from torchrender.optim import LeastSquares, upsample_tensor


def matrix(pixels, entries, seed=0, dtype=torch.float64):
    """How much of each pixel's light is due to each parameter; no number is negative, one in three is zero."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(pixels, entries, generator=generator, dtype=dtype)
    return weights * (torch.rand(pixels, entries, generator=generator) > 1 / 3)


def parameter(*shape, seed=1, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    return nn.Parameter(torch.rand(shape, generator=generator, dtype=dtype) + 0.1)


def test_a_step_is_the_gradient_by_the_bound_of_the_curvature():
    light, a = matrix(40, 6), parameter(6)
    target, w = torch.rand(40, dtype=torch.float64), torch.rand(40, dtype=torch.float64)
    start, picture = a.detach().clone(), light @ a.detach()
    loss = LeastSquares([a], lr=0.7, damping=2.0).step(light @ a, target, w)
    assert torch.isclose(loss, (w * (picture - target)).square().mean())
    gradient = 2 / 40 * light.T @ (w**2 * (picture - target))
    assert torch.allclose(a.grad, gradient, rtol=1e-12)
    bound = 2 / 40 * light.T @ (w**2 * picture) / start
    damping = 2.0 * bound.sum() / 40  # two pixels' worth
    expected = (start - 0.7 * gradient / (bound + damping)).clamp(min=0)
    assert torch.allclose(a, expected, rtol=1e-12)


def test_the_loss_never_grows_and_the_solution_is_found():
    light, truth = matrix(200, 8), parameter(8, seed=2).detach()
    a = nn.Parameter(torch.full((8,), 0.5, dtype=torch.float64))
    optimizer, losses = LeastSquares([a], damping=1e-6, memory=0.0), []
    for _ in range(300):
        optimizer.zero_grad()
        losses.append(float(optimizer.step(light @ a, light @ truth)))
    assert losses == sorted(losses, reverse=True)
    assert torch.allclose(a, truth, rtol=1e-3)


@pytest.mark.parametrize("units", [1e-4, 1.0, 1e5])
def test_steps_do_not_depend_on_units(units):
    light, target = matrix(40, 6), torch.rand(40, dtype=torch.float64)
    values = []
    for scale in (1.0, units):  # of the picture's light; and of the parameter's
        a = nn.Parameter(parameter(6).detach() * scale)
        optimizer = LeastSquares([a])
        for _ in range(5):
            optimizer.zero_grad()
            optimizer.step(light @ a * 3.0, target * scale * 3.0)
        values.append(a.detach() / scale)
    assert torch.allclose(*values, rtol=1e-9)


def test_visits_are_averaged_and_entries_without_light_forget_nothing():
    # Two entries, one pixel each; the picture shows the second one in every other step alone.
    a = nn.Parameter(torch.ones(2, dtype=torch.float64))
    optimizer = LeastSquares([a], damping=1e-9, memory=0.5)
    shown = [torch.tensor([1.0, float(step % 2 == 0)], dtype=torch.float64) for step in range(4)]
    for mask in shown:
        optimizer.zero_grad()
        optimizer.step(a * mask, a.detach() * mask)  # nothing to move
    bound = 2 / 2 * 1.0
    kept = optimizer.state[a]["light"]
    expected = torch.tensor([1 + 0.5 + 0.25 + 0.125, 1 + 0.5], dtype=torch.float64)
    assert torch.allclose(kept, bound * expected, rtol=0.02)
    before = kept[0].item()
    for _ in range(50):  # next to none, by a stray path
        optimizer.zero_grad()
        optimizer.step(a * torch.tensor([1e-4, 1.0]), a.detach() * torch.tensor([1e-4, 1.0]))
    assert optimizer.state[a]["light"][0].item() == pytest.approx(before, rel=1e-3)


@pytest.mark.parametrize("shape", [(8, 8, 3), (7, 5, 2), (6, 3, 9, 1), (5, 4, 1), (17, 2, 1)])
def test_entries_without_light_move_with_their_neighbours(shape):
    # One entry in five is seen; all of them have to become three times as bright.
    a = nn.Parameter(torch.full(shape, 0.2, dtype=torch.float64))
    seen = (torch.rand(shape[:-1], generator=torch.Generator().manual_seed(0)) < 0.2).double()[..., None]
    seen.view(-1)[::7] = 1.0
    optimizer = LeastSquares([a], damping=0.1)
    for _ in range(30):
        optimizer.zero_grad()
        optimizer.step(a * seen, torch.full_like(a, 0.6) * seen)
    hidden = (seen == 0).expand(shape)
    assert torch.allclose(a[~hidden], torch.tensor(0.6, dtype=torch.float64), rtol=1e-3)
    assert 0.5 < a[hidden].mean() < 0.6  # they are left where the neighbours do not move any more
    alone = nn.Parameter(torch.full(shape, 0.2, dtype=torch.float64))
    optimizer = LeastSquares([alone], damping=0.1, dims=0)
    optimizer.step(alone * seen, torch.full_like(a, 0.6) * seen)
    assert bool((alone[hidden] == 0.2).all()) and bool((alone[~hidden] != 0.2).all())


def test_neighbourhoods_are_interpolated():
    """A step of a linear ramp of which every fourth texel is seen: the others follow the line between these."""
    truth = torch.linspace(0.3, 0.7, 64)[None, :, None].expand(64, 64, 1)
    a, seen = nn.Parameter(torch.full((64, 64, 1), 0.5)), torch.zeros(64, 64, 1)
    seen[::4, ::4] = 1.0
    optimizer = LeastSquares([a], damping=0.05)
    for _ in range(20):
        optimizer.zero_grad()
        optimizer.step(a * seen, truth * seen)
    hidden = (a - truth)[8:-8, 8:-8].detach().abs()[seen[8:-8, 8:-8] == 0]
    assert hidden.max() < 0.012  # a block of four texels is 0.025 long


def test_the_pyramid_changes_the_way_and_not_the_result():
    # noise: neighbours are not alike
    truth = torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(3)) * 0.8 + 0.1
    a = nn.Parameter(torch.full((16, 16, 3), 0.5))
    optimizer = LeastSquares([a], damping=10.0)
    for _ in range(100):
        optimizer.zero_grad()
        optimizer.step(a * 2.0, truth * 2.0)
    assert torch.allclose(a, truth, atol=1e-3)


def test_values_stay_between_bounds():
    a = nn.Parameter(torch.full((2, 3), 0.5))
    high = torch.tensor([0.6, 0.7, 2.0])
    optimizer = LeastSquares([a], low=0.1, high=high)
    for _ in range(40):
        optimizer.zero_grad()
        optimizer.step(a * torch.ones(()), torch.tensor([[-1.0, -1.0, 1.0], [9.0, 9.0, 1.0]]))
    expected = torch.tensor([[0.1, 0.1, 1.0], [0.6, 0.7, 1.0]])
    assert torch.allclose(a, expected, atol=1e-3)


def test_other_parameters_get_the_gradient_of_the_loss():
    light, a, other = matrix(30, 4), parameter(4), parameter(30, seed=5)
    target = torch.rand(30, dtype=torch.float64)
    ((light @ a * other - target).square().mean()).backward()
    expected, other.grad, a.grad = other.grad.clone(), None, None
    LeastSquares([a], lr=0.0).step(light @ a * other, target)
    assert torch.allclose(other.grad, expected, rtol=1e-12)


def test_what_grad_had_before_is_part_of_the_step():
    light, start = matrix(30, 4), parameter(4).detach()
    values = []
    for prior in (0.0, 0.01):
        a = nn.Parameter(start.clone())
        (prior * a.sum()).backward()
        optimizer = LeastSquares([a], damping=1e-9)
        optimizer.step(light @ a, light @ start)  # which has no gradient
        values.append(a.detach())
    assert torch.equal(values[0], start)
    bound = 2 / 30 * light.T @ (light @ start) / start
    assert torch.allclose(values[1], start - 0.01 / bound, rtol=1e-6)


def test_groups_have_options_of_their_own_and_frozen_parameters_rest():
    light, target = matrix(40, 3), torch.rand(40, dtype=torch.float64)
    a, b, frozen = (parameter(3, seed=seed) for seed in (1, 2, 3))
    frozen.requires_grad_(False)
    start = [p.detach().clone() for p in (a, b, frozen)]
    optimizer = LeastSquares([{"params": [a]}, {"params": [b, frozen], "lr": 0.0, "high": 9.0}])
    optimizer.step(light @ (a + b + frozen), target)
    assert not torch.equal(a, start[0]) and torch.equal(b, start[1]) and torch.equal(frozen, start[2])
    a.requires_grad_(False), b.requires_grad_(False)
    other = nn.Parameter(torch.ones((), dtype=torch.float64))
    optimizer.step(light @ a * other, target)  # all are frozen, another learns
    assert other.grad is not None and torch.equal(b, start[1])
    optimizer.add_param_group({"params": [other], "lr": 0.5})
    optimizer.step(light @ a * other, target)
    assert other != 1


def test_values_of_many_magnitudes_come_to_rest():
    """A dark sky with a sun comes to what the picture has, without going to and fro."""
    truth = torch.full((16, 32, 3), 0.2)
    truth[5, 7] = 1e5
    a = nn.Parameter(torch.where(truth > 1, truth, torch.full_like(truth, 0.1)))
    optimizer = LeastSquares([a])
    for _ in range(100):
        optimizer.zero_grad()
        loss = optimizer.step(a * 2.0, truth * 2.0)
    assert loss < 1e-4
    assert torch.allclose(a, truth, rtol=0.05)


def test_pictures_of_filters_with_negative_lobes():
    sharp = torch.eye(12, dtype=torch.float64) * 1.4 - torch.diag(torch.full((11,), 0.2, dtype=torch.float64), 1)
    sharp -= torch.diag(torch.full((11,), 0.2, dtype=torch.float64), -1)
    truth = torch.tensor([0.01, 1.0] * 6, dtype=torch.float64)  # dark pixels become negative
    assert (sharp @ truth).min() < 0
    a = nn.Parameter(torch.full((12,), 0.5, dtype=torch.float64))
    optimizer = LeastSquares([a])
    for _ in range(300):
        optimizer.zero_grad()
        loss = optimizer.step(sharp @ a, sharp @ truth)
        assert bool((optimizer.state[a]["light"] >= 0).all())
    assert loss < 1e-4


def test_a_firefly_is_forgotten():
    a = nn.Parameter(torch.full((4, 4, 3), 0.5))
    optimizer = LeastSquares([a])
    gain = torch.ones(4, 4, 3)
    gain[0, 0] = 1e3
    optimizer.step(a * gain, torch.full((4, 4, 3), 0.8))
    for _ in range(60):
        optimizer.zero_grad()
        optimizer.step(a * 1.0, torch.full((4, 4, 3), 0.8))
    assert torch.allclose(a, torch.tensor(0.8), atol=0.01)


def test_masked_pixels_may_be_anything():
    a, b = (nn.Parameter(torch.ones(3)) for _ in range(2))
    target, mask = torch.tensor([0.5, float("nan"), 0.5]), torch.tensor([1.0, 0.0, 1.0])
    loss = LeastSquares([a]).step(a * 1.0, target, mask)
    assert loss == pytest.approx(0.25 * 2 / 3) and not loss.requires_grad
    LeastSquares([b]).step(b + torch.tensor([0.0, float("nan"), 0.0]), torch.tensor([0.5, 7.0, 0.5]), mask)
    assert torch.equal(a, b) and a[1] == 1 and a[0] < 1


class Broken(torch.autograd.Function):
    """A picture whose derivative by its first entry is not a number one can use."""

    @staticmethod
    def forward(ctx, a, what):
        ctx.what = what
        return a.clone()

    @staticmethod
    def backward(ctx, gradient):
        gradient = gradient.clone()
        gradient.view(-1)[0] = ctx.what
        return gradient, None


@pytest.mark.parametrize("what", [float("inf"), float("nan"), -float("inf")])
def test_derivatives_that_are_not_finite_are_refused(what):
    a = nn.Parameter(torch.full((8, 8, 3), 0.5))
    optimizer = LeastSquares([a])
    with pytest.raises(RuntimeError, match=r"derivative by the parameter of shape \(8, 8, 3\) is not finite"):
        optimizer.step(Broken.apply(a, what), torch.zeros(8, 8, 3))
    assert bool((a == 0.5).all()) and not optimizer.state
    a.grad = torch.full_like(a, what)  # of a prior
    with pytest.raises(RuntimeError, match="is not finite"):
        optimizer.step(a * 1.0, torch.zeros(8, 8, 3))
    assert bool((a == 0.5).all()) and not optimizer.state


def test_parameters_whose_derivatives_are_one_tensor():
    a, b = nn.Parameter(torch.full((3,), 0.5)), nn.Parameter(torch.full((3,), 2.0))
    LeastSquares([a, b], damping=1e-6).step(a + b, torch.full((3,), 2.0))
    # I = 2.5, T = 2: a step of -g / D = -(0.5 / 2.5) a.
    assert torch.allclose(a, torch.tensor(0.4), rtol=1e-4) and torch.allclose(b, torch.tensor(1.6), rtol=1e-4)


def test_state_goes_on_after_loading():
    light, target = matrix(60, 12, dtype=torch.float32), torch.rand(60)

    def steps(a, optimizer, count):
        for _ in range(count):
            optimizer.zero_grad()
            optimizer.step(light @ a.flatten(), target)

    a = nn.Parameter(torch.full((2, 2, 3), 0.5))
    optimizer = LeastSquares([a], memory=0.7)
    steps(a, optimizer, 3)
    file = io.BytesIO()
    torch.save({"a": a.detach().clone(), "optimizer": optimizer.state_dict()}, file)
    steps(a, optimizer, 3)
    file.seek(0)
    saved = torch.load(file, weights_only=True)
    b = nn.Parameter(saved["a"])
    other = LeastSquares([b], memory=0.1)
    other.load_state_dict(saved["optimizer"])
    steps(b, other, 3)
    assert torch.equal(a, b)


def test_schedulers_and_growing():
    a = nn.Parameter(torch.full((4, 4, 3), 0.5))
    optimizer = LeastSquares([a])
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5)
    optimizer.step(a * 2.0, torch.ones(4, 4, 3))
    scheduler.step()
    assert optimizer.param_groups[0]["lr"] == 0.5
    light = optimizer.state[a]["light"].sum()
    a = upsample_tensor(a, (8, 8), optimizer)
    assert torch.isclose(optimizer.state[a]["light"].sum(), light, rtol=1e-5)  # shared out among more texels
    optimizer.step(a * 2.0, torch.ones(8, 8, 3))
    assert optimizer.state[a]["visits"] == 1.5  # the first is worth a half


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lr": -1.0}, r"lr: .*got -1\.0"),
        ({"damping": 0.0}, r"damping: .*got 0\.0"),
        ({"memory": 1.5}, r"memory: .*got 1\.5"),
        ({"memory": float("nan")}, "memory: .*got nan"),
        ({"low": -0.1}, r"low: .*got -0\.1"),
        ({"lr": float("inf")}, "lr: .*got inf"),
        ({"damping": float("inf")}, "damping: .*got inf"),
        ({"high": -1.0}, r"high: expected nothing below low, 0\.0, got -1\.0"),
        ({"high": float("nan")}, "high: .*got nan"),
        ({"low": 0.5, "high": torch.tensor([0.4, 1.0])}, "high: expected nothing below low"),
        ({"high": torch.ones(3)}, r"high: \(3,\) does not broadcast to the parameter of shape \(2, 2\)"),
        ({"low": torch.zeros(1, 2, 2)}, r"low: \(1, 2, 2\) does not broadcast"),
        ({"dims": 2.0}, r"dims: .*got 2\.0"),
        ({"dims": 4}, "dims: .*got 4"),
        ({"dims": 3}, r"dims: 3 are more than the axes of \(2, 2\)"),
    ],
)
def test_options_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        LeastSquares([nn.Parameter(torch.ones(2, 2))], **options)
    optimizer = LeastSquares([nn.Parameter(torch.ones(2, 2))])
    with pytest.raises(ValueError, match=message):
        optimizer.add_param_group({"params": [nn.Parameter(torch.ones(2, 2))], **options})
    assert len(optimizer.param_groups) == 1


def test_refused_pictures_leave_values_as_they_are():
    a, b = nn.Parameter(torch.ones(3)), nn.Parameter(torch.ones(3))
    optimizer = LeastSquares([a, b])

    def refused(error, message, image, *rest):
        with pytest.raises(error, match=message):
            optimizer.step(image, *rest)
        assert torch.equal(a, torch.ones(3)) and torch.equal(b, torch.ones(3))
        optimizer.zero_grad()

    refused(ValueError, "image: it has no graph", torch.ones(3), torch.ones(3))
    refused(ValueError, r"target: expected the picture's shape \(3,\), got \(3, 1\)", a * 1, torch.ones(3, 1))
    refused(ValueError, r"weight: \(2, 3\) does not broadcast", a * 1, torch.ones(3), torch.ones(2, 3))
    refused(ValueError, r"weight: \(2,\) does not broadcast", a * 1, torch.ones(3), torch.ones(2))
    refused(RuntimeError, "not finite", a * 1, torch.tensor([0.0, float("nan"), 0.0]))
    refused(ValueError, "do not become brighter", a * (1 - 0.5 * b), torch.zeros(3))
    with torch.no_grad():
        b[0] = -0.5
    with pytest.raises(ValueError, match=r"expected values >= 0, and some above, got -0\.5"):
        optimizer.step(a + b, torch.zeros(3))
    with torch.no_grad():
        b.zero_()
    with pytest.raises(ValueError, match="all are 0 in the parameter of shape"):
        optimizer.step(a + b, torch.zeros(3))
    with pytest.raises(ValueError, match="expected real numbers"):
        LeastSquares([nn.Parameter(torch.ones(3, dtype=torch.complex64))])


def test_black_pictures_and_parameters_that_are_not_seen():
    a, unseen = nn.Parameter(torch.ones(3)), nn.Parameter(torch.ones(3))
    optimizer = LeastSquares([a, unseen])
    optimizer.step(a * 0.0, torch.ones(3))
    assert torch.equal(a, torch.ones(3)) and torch.equal(unseen, torch.ones(3))
    optimizer.step(a * 1.0, torch.full((3,), 0.5), 0.0)
    assert torch.equal(a, torch.ones(3))
    b = nn.Parameter(torch.tensor([0.0, 0.0, 0.1]))  # from nothing
    optimizer = LeastSquares([b])
    for _ in range(30):
        optimizer.zero_grad()
        optimizer.step(b * 2.0, torch.full((3,), 2.0))
    assert torch.allclose(b, torch.ones(3), rtol=0.01)
