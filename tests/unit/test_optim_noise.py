"""Optimisation that knows its noise: when to stop, and how long steps are to be."""

import math

import pytest
import torch
from small_scene import COLOUR, ball_and_wall
from torch import nn

import torchrender as tr
from torchrender.optim import NoiseStop, find_rate


def windows(count: int, size: int, mean: float = 0.0, window: int = 20) -> torch.Tensor:
    """`signal` of many windows of gradients with unit noise around a mean."""
    random = torch.Generator().manual_seed(1)
    parameter = torch.zeros(size)
    stop, found = NoiseStop([parameter], window=window), []
    for _ in range(count):
        for _ in range(window):
            parameter.grad = mean + torch.randn(size, generator=random)
            stop()
        found.append(stop.signal)
    return torch.tensor(found)


class Quadratic:
    """Half the squared distance from the origin, its gradient with unit noise, by torch's SGD."""

    def __init__(self, lr: float, size: int = 10, scale: float = 1.0) -> None:
        self.random = torch.Generator().manual_seed(2)
        self.x = nn.Parameter(torch.full((size,), 10.0))
        self.scale = scale
        self.optimizer = torch.optim.SGD([self.x], lr=lr)

    def step(self, it: int = 0) -> float:
        x = self.x.detach()
        self.x.grad = self.scale * x + torch.randn(x.shape, generator=self.random)
        self.optimizer.step()
        return float(self.scale * x.square().sum() / 2)


# ------------------------------------------------------------------------------------------------------- NoiseStop
def test_signal_of_noise_is_standard_normal():
    """Its mean over 150 windows within 3.3 standard errors (1e-3); the share below 1 is 0.84 within as many."""
    signal = windows(150, 300)
    assert abs(float(signal.mean())) < 3.3 / math.sqrt(150)
    assert abs(float((signal < 1).double().mean()) - 0.84) < 3.3 * math.sqrt(0.84 * 0.16 / 150)


def test_signal_of_a_slope():
    """A mean of a third of the noise is never taken for noise; without noise the signal is that of the docstring."""
    assert float(windows(50, 300, 1 / 3).min()) > 2
    parameter = torch.zeros(3)
    stop = NoiseStop([parameter], window=50)
    for _ in range(50):
        parameter.grad = torch.tensor([1.0, -2.0, 3.0])
        assert not stop()
    assert stop.signal == pytest.approx(math.sqrt(3 * 50) / 2, rel=0.02)


@pytest.mark.parametrize("lr", [0.1, 0.02])
def test_it_stops_where_noise_is_all_there_is(lr):
    """The squared distance of SGD falls from 100 to lr / (2 - lr) an entry, by (1 - lr)^2 a step."""
    problem = Quadratic(lr)
    stop, steps, late = NoiseStop(problem.optimizer), 0, []
    while not stop():
        problem.step()
        steps += 1
        late.append(float(problem.x.detach().square().mean()))
    stationary = lr / (2 - lr)
    reached = math.log(100 / stationary) / (-2 * math.log(1 - lr))  # what is left of the slope equals the noise
    assert reached < steps < reached + 6 * stop.window
    assert sum(late[-20:]) / 20 < 3 * stationary


def test_steps_that_leap_to_and_fro_are_no_slope():
    problem = Quadratic(1.95)
    stop = NoiseStop(problem.optimizer, patience=1)
    while not stop():
        problem.step()
    assert stop.signal < 0


def test_units_do_not_matter():
    """A tensor in small units is weighed like one in large ones; a tensor without a gradient counts as zero."""
    random = torch.Generator().manual_seed(3)
    gradients = torch.randn(20, 2, 50, generator=random)
    signals = []
    for unit in (1.0, 1e-6):
        params = [torch.zeros(50), torch.zeros(50), torch.zeros(2)]
        stop = NoiseStop(params, window=20)
        for first, second in gradients:
            params[0].grad, params[1].grad = first, second * unit
            stop()
        signals.append(stop.signal)
    assert signals[0] == pytest.approx(signals[1], rel=1e-4)


def test_a_colour_under_noise_of_rendering():
    """From a wrong albedo, the loop ends by itself, with the albedo found to a hundredth."""
    scene = tr.load_dict(ball_and_wall(12, 16))
    with torch.no_grad():
        target = tr.render(scene, spp=256, seed=1 << 20)
    (red,) = scene.train_only(COLOUR)
    truth = red.detach().clone()
    nn.init.constant_(red, 0.4)
    optimizer = torch.optim.Adam([red], lr=0.01)
    stop = NoiseStop(optimizer, window=20)
    for it in range(600):
        optimizer.zero_grad()
        (tr.render(scene, spp=2, seed=it) - target).square().mean().backward()
        optimizer.step()
        if stop():
            break
    assert 40 < it < 599
    assert float((red.detach() - truth).abs().max()) < 0.01


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"params": [1.0]}, TypeError, "params: expected an optimiser or tensors, got 1.0"),
        ({"params": []}, ValueError, "params: expected tensors, got none"),
        ({"window": 3}, ValueError, "window: expected at least 4 steps, got 3"),
        ({"patience": 0}, ValueError, "patience: expected at least 1 window, got 0"),
    ],
)
def test_arguments_of_the_criterion_are_checked(arguments, error, message):
    with pytest.raises(error, match=message):
        NoiseStop(**{"params": [torch.zeros(2)], **arguments})


def test_a_gradient_that_is_not_finite_is_refused():
    parameter = torch.zeros(2)
    parameter.grad = torch.tensor([0.0, math.nan])
    with pytest.raises(ValueError, match="params: the gradient of number 0 is not finite"):
        NoiseStop(parameter)()


# ------------------------------------------------------------------------------------------------------- find_rate
@pytest.mark.parametrize("first", [1e-3, 0.05, 1.0])
def test_the_rate_of_a_quadratic(first):
    """With a curvature of 4 rates from 0.07 on arrive within the trial, and from 0.5 on they diverge."""
    problem = Quadratic(first, scale=4.0)
    rate = find_rate(problem.optimizer, problem.step)
    assert 0.07 < rate < 0.4
    assert math.isclose(math.log(rate / first, 3), round(math.log(rate / first, 3)), abs_tol=1e-9)


def test_rates_that_noise_cannot_tell_apart_stay():
    """Losses of noise alone: in 40 tries the first rate is kept where two trials of 6 losses differ by less than their
    standard error, with a probability of (1 - 0.18)^2 = 0.67; 25 or more of 40 have one of 0.8, 15 one of 1 - 1e-4."""
    random = torch.Generator().manual_seed(4)
    parameter = nn.Parameter(torch.zeros(1))
    parameter.grad = torch.zeros(1)
    optimizer = torch.optim.SGD([parameter], lr=0.1)
    kept = sum(
        find_rate(optimizer, lambda _: float(torch.randn((), generator=random)), steps=18) == 0.1 for _ in range(40)
    )
    assert kept >= 15


def test_everything_is_put_back():
    """Parameters, gradients, moments, learning rates of groups, and torch's generator."""
    torch.manual_seed(5)
    a, b = nn.Parameter(torch.ones(3)), nn.Parameter(torch.ones(2))
    optimizer = torch.optim.Adam([{"params": [a], "lr": 0.01}, {"params": [b], "lr": 0.1}])
    seen = []

    def step(it: int) -> torch.Tensor:
        optimizer.zero_grad()
        loss = (a - 0.5 + 1e-3 * torch.randn(3)).square().sum() + (b - 2).square().sum()
        loss.backward()
        optimizer.step()
        seen.append((it, *(group["lr"] for group in optimizer.param_groups)))
        return loss

    step(0)
    before = [a.detach().clone(), b.detach().clone(), a.grad.clone(), torch.get_rng_state()]
    moments = {k: v["exp_avg"].clone() for k, v in optimizer.state_dict()["state"].items()}
    seen.clear()
    rate = find_rate(optimizer, step, steps=6)
    after = [a.detach(), b.detach(), a.grad, torch.get_rng_state()]
    assert all(torch.equal(x, y) for x, y in zip(before, after, strict=True))
    assert all(torch.equal(v["exp_avg"], moments[k]) for k, v in optimizer.state_dict()["state"].items())
    assert [group["lr"] for group in optimizer.param_groups] == [0.01, 0.1] and rate > 0.01
    assert all(math.isclose(second / first, 10) for _, first, second in seen)
    assert [it for it, _, _ in seen[:6]] == list(range(6))


def test_a_rate_that_diverges_is_left():
    """Also where losses become infinite; but not at the first rate, which is an error."""
    problem = Quadratic(1e-3, scale=4e3)
    assert find_rate(problem.optimizer, problem.step) < 0.4e-3

    def broken(_: int) -> float:
        return math.nan

    with pytest.raises(ValueError, match=r"the loss is not finite with its learning rate 0.001; begin lower"):
        find_rate(problem.optimizer, broken)


def test_the_rate_for_a_colour():
    """With the rate found, ten steps come nearer to the albedo than with the first one."""
    scene = tr.load_dict(ball_and_wall(12, 16))
    with torch.no_grad():
        target = tr.render(scene, spp=64, seed=1 << 20)
    (red,) = scene.train_only(COLOUR)
    truth = red.detach().clone()
    nn.init.constant_(red, 0.5)
    optimizer = torch.optim.Adam([red], lr=1e-4)

    def step(it: int) -> torch.Tensor:
        optimizer.zero_grad()
        loss = (tr.render(scene, spp=2, seed=it) - target).square().mean()
        loss.backward()
        optimizer.step()
        return loss.detach()

    rate = find_rate(optimizer, step, steps=10)
    assert rate >= 0.009  # the albedo is 0.4 away, and Adam's steps are at most about so long
    optimizer.param_groups[0]["lr"] = rate
    for it in range(10):
        step(it)
    assert float((red.detach() - truth).abs().max()) < 0.3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"steps": 5}, "steps: expected at least 6, got 5"),
        ({"factor": 1.0}, "factor: expected a number larger than 1, got 1.0"),
        ({"trials": 1}, "trials: expected at least 2, got 1"),
    ],
)
def test_arguments_of_the_search_are_checked(arguments, message):
    problem = Quadratic(0.1)
    with pytest.raises(ValueError, match=message):
        find_rate(problem.optimizer, problem.step, **arguments)
    problem.optimizer.param_groups[0]["lr"] = 0.0
    with pytest.raises(ValueError, match=r"optimizer: expected a learning rate above 0 to begin with, got 0.0"):
        find_rate(problem.optimizer, problem.step)
