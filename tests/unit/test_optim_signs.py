"""Least squares by random signs, for parameters that make pictures brighter here and darker there.

Statistical tests are at 0.1 %.
"""

from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from torchrender.optim import LeastSquares

DOUBLE = torch.float64


def matrix(pixels: int, entries: int, seed: int = 0) -> torch.Tensor:
    """Derivatives of both signs; one in three is zero."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(pixels, entries, generator=generator, dtype=DOUBLE)
    return values * (torch.rand(pixels, entries, generator=generator) > 1 / 3)


def numbers(*shape: int, seed: int = 1) -> nn.Parameter:
    return nn.Parameter(torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE))


def signs_of(seed: int, count: int) -> torch.Tensor:
    torch.manual_seed(seed)
    return torch.empty(count, dtype=DOUBLE).bernoulli_() * 2 - 1


def test_a_step_is_the_gradient_by_the_square_of_a_random_sum():
    jacobian, a = matrix(40, 6), numbers(6)
    target, w = torch.rand(40, dtype=DOUBLE), torch.rand(40, dtype=DOUBLE)
    start, picture = a.detach().clone(), jacobian @ a.detach()
    signs = signs_of(3, 40)
    torch.manual_seed(3)
    loss = LeastSquares([a], curvature="signs", probes=1).step(jacobian @ a, target, w)
    assert torch.isclose(loss, (w * (picture - target)).square().mean())
    gradient = 2 / 40 * jacobian.T @ (w**2 * (picture - target))
    assert torch.allclose(a.grad, gradient, rtol=1e-12)
    square = 2 / 40 * (jacobian.T @ (w * signs)) ** 2
    damping = 10.0 * square.sum() / 40  # ten pixels' worth
    assert torch.allclose(a, start - 0.3 * gradient / (square + damping), rtol=1e-12)


@pytest.mark.parametrize("probes", [2, 4, 8])
def test_probes_tell_values_apart_that_follow_each_other(probes):
    """The diagonal of entries that two pixels of `probes` colours show, each with colours of its own, is exact."""
    weights = torch.randn(5, 2, probes, generator=torch.Generator().manual_seed(3), dtype=DOUBLE)
    weights[:, 0, : probes // 2], weights[:, 1, probes // 2 :] = 0, 0
    a = numbers(5)
    optimizer = LeastSquares([a], curvature="signs", probes=probes)
    optimizer.step(a[:, None, None] * weights, torch.zeros_like(weights))
    expected = 2 / weights.numel() * weights.square().sum((1, 2))
    assert torch.allclose(optimizer.state[a]["light"], expected, rtol=1e-12)


@pytest.mark.parametrize("probes", [1, 3, 4])
def test_the_mean_of_the_squares_is_the_diagonal_of_gauss_and_newton(probes):
    jacobian, w = matrix(60, 5), torch.rand(60, generator=torch.Generator().manual_seed(4), dtype=DOUBLE)
    found = []
    torch.manual_seed(0)
    for _ in range(2000):
        a = numbers(5)
        optimizer = LeastSquares([a], curvature="signs", probes=probes)
        optimizer.step(jacobian @ a, torch.zeros(60, dtype=DOUBLE), w)
        found.append(optimizer.state[a]["light"])  # of one visit
    squares = torch.stack(found)
    expected = 2 / 60 * (w[:, None] * jacobian).square().sum(0)
    deviation = (squares.mean(0) - expected) / (squares.std(0) / math.sqrt(len(squares)))
    assert deviation.abs().max() < 3.72  # of five numbers, on both sides


@pytest.mark.parametrize("units", [1e-4, 1.0, 1e5])
def test_numbers_that_share_pixels_with_neighbours_are_found_in_any_units(units):
    """Of a row of 200 each pixel shows three, brighter or darker; values may be negative."""
    generator = torch.Generator().manual_seed(2)
    truth = torch.randn(200, generator=generator, dtype=DOUBLE)
    weights = torch.randn(3, 600, generator=generator, dtype=DOUBLE) / units
    places = torch.randint(200, (3, 600), generator=generator)
    a = nn.Parameter(torch.zeros(200, dtype=DOUBLE))

    def picture(values: torch.Tensor) -> torch.Tensor:
        return (weights * values[places]).sum(0)

    torch.manual_seed(0)
    optimizer, losses = LeastSquares([a], curvature="signs"), []
    for _ in range(200):
        optimizer.zero_grad()
        losses.append(float(optimizer.step(picture(a), picture(truth * units))))
    assert losses[-1] < 1e-3 * losses[0]
    assert (a.detach() / units - truth).abs().max() < 0.3


@pytest.mark.parametrize("size", [8, 16])
@pytest.mark.parametrize("probes", [1, 8])
def test_what_many_entries_of_a_pixel_have_in_common_does_not_explode(size, probes):
    """Pictures without noise are the sums of a cube's entries along its axes, each as wrong as the others."""
    truth = torch.rand(size, size, size, 1, generator=torch.Generator().manual_seed(0))
    a = nn.Parameter(torch.ones(size, size, size, 1))

    def pictures(values: torch.Tensor) -> torch.Tensor:
        return torch.stack([values.mean(dim) for dim in range(3)])

    torch.manual_seed(0)
    optimizer, losses = LeastSquares([a], curvature="signs", probes=probes), []
    for _ in range(40):
        optimizer.zero_grad()
        losses.append(float(optimizer.step(pictures(a), pictures(truth))))
    assert max(losses) == losses[0]
    assert max(losses[3:]) < 0.1 * losses[0] and losses[-1] < 0.01 * losses[0]


@pytest.mark.parametrize("misfit", [0.3, 3.0])
@pytest.mark.parametrize("start", [1.02, 0.5])
def test_a_loss_that_nothing_makes_smaller_does_not_hide_steps_that_are_too_long(misfit, start):
    """The sums of a cube's entries along its axes beside what no cube has, a pattern of twice as fine pixels."""
    truth = torch.rand(16, 16, 16, 1, generator=torch.Generator().manual_seed(0))
    a = nn.Parameter(start * truth)
    pattern = torch.ones(3, 32, 32, 1)
    pattern[:, ::2] = -1

    def pictures(values: torch.Tensor) -> torch.Tensor:
        return torch.stack([values.mean(dim) for dim in range(3)]).repeat_interleave(2, 1).repeat_interleave(2, 2)

    torch.manual_seed(0)
    optimizer, errors = LeastSquares([a], curvature="signs", low=0.0), []
    for _ in range(40):
        optimizer.zero_grad()
        optimizer.step(pictures(a), pictures(truth) + misfit * pattern)
        errors.append(float((pictures(a) - pictures(truth)).detach().square().mean()))
    before = float((pictures(start * truth) - pictures(truth)).square().mean())
    assert max(errors) < 10 * before + 1e-3 and errors[-1] < max(0.01 * before, 1e-5)


def test_squares_that_overflow_are_refused():
    a = nn.Parameter(torch.full((2,), 0.5))
    optimizer = LeastSquares([a], curvature="signs")
    with pytest.raises(RuntimeError, match=r"D of the parameter of shape \(2,\) is not finite; no step was made"):
        optimizer.step((a * 5e19)[:, None].expand(2, 3000) * 1.0, torch.full((2, 3000), (0.5 - 1e-7) * 5e19))
    assert torch.equal(a, torch.full((2,), 0.5))


@pytest.mark.parametrize("probes", [1, 8])
@pytest.mark.parametrize("entries", [1, 100])
def test_entries_that_many_pixels_show_do_not_jump(entries, probes):
    """Squares of sums of many signs are sometimes next to nothing, and divided by."""
    weights = torch.ones(entries, 60, dtype=DOUBLE)
    truth = torch.linspace(1.0, 2.0, entries, dtype=DOUBLE)
    worst = []
    for seed in range(60):
        torch.manual_seed(seed)
        a = nn.Parameter(torch.full((entries,), 0.5, dtype=DOUBLE))
        optimizer = LeastSquares([a], curvature="signs", probes=probes)
        for _ in range(10):
            optimizer.zero_grad()
            optimizer.step(a[:, None] * weights, truth[:, None] * weights)
            worst.append(float((a.detach() - truth).abs().max()))
    assert max(worst) < 2.5  # of at most 1.5 at the start
    assert sum(worst[9::10]) / 60 < 0.6


def test_texels_that_fill_many_pixels_do_not_jump():
    """400 values a texel, far from each other: a sum of their signs is next to nothing for one texel in ten."""
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand(32, 32, 1, generator=generator)
    weights = torch.randn(400, 32, 32, 1, generator=generator)
    a = nn.Parameter(torch.full((32, 32, 1), 0.5))
    torch.manual_seed(0)
    optimizer = LeastSquares([a], curvature="signs")
    for _ in range(5):
        optimizer.zero_grad()
        optimizer.step(a * weights, truth * weights)
        assert float((a.detach() - truth).abs().max()) < 0.6  # at the start 0.5
    assert float((a.detach() - truth).square().mean().sqrt()) < 0.15


def test_states_from_before_there_were_signs_go_on():
    a, picture = nn.Parameter(torch.ones(3)), torch.full((3,), 0.5)
    optimizer = LeastSquares([a])
    optimizer.step(a * 1.0, picture)
    state = optimizer.state_dict()
    for group in state["param_groups"]:
        del group["curvature"], group["probes"]
    optimizer = LeastSquares([a])
    optimizer.load_state_dict(state)
    optimizer.step(a * 1.0, picture)
    assert bool((a < 1).all())


def test_groups_by_light_move_as_if_they_were_alone():
    jacobian, bright = matrix(40, 6), matrix(40, 4).abs()
    target = torch.rand(40, generator=torch.Generator().manual_seed(5), dtype=DOUBLE)
    found = []
    for together in (True, False):
        a, b = numbers(6), nn.Parameter(numbers(4).detach().abs())
        by_signs = {"params": [a], "curvature": "signs"}
        optimizer = LeastSquares([{"params": [b]}, *([by_signs] if together else [])])
        optimizer.step(jacobian @ a + bright @ b, target)
        found.append((b.detach(), a.grad))
        assert torch.equal(a, numbers(6)) != together
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][1], found[1][1])


def test_what_is_not_given_follows_from_the_kind():
    groups = LeastSquares([{"params": [numbers(2)]}, {"params": [numbers(2)], "curvature": "signs"}]).param_groups
    assert [[group[name] for name in ("lr", "damping", "low")] for group in groups] == [
        [1.0, 3.0, 0.0],
        [0.3, 10.0, -math.inf],
    ]
    optimizer = LeastSquares([numbers(2)], 0.1, curvature="signs", damping=2.0, low=-1.0)
    assert [optimizer.param_groups[0][name] for name in ("lr", "damping", "low")] == [0.1, 2.0, -1.0]
    with pytest.raises(ValueError, match="curvature: expected light or signs, got 'dark'"):
        LeastSquares([numbers(2)], curvature="dark")
    for wrong in (0, 2.0, 65):
        with pytest.raises(ValueError, match=f"probes: expected a whole number from 1 to 64, got {wrong}"):
            LeastSquares([numbers(2)], curvature="signs", probes=wrong)
    with pytest.raises(ValueError, match=r"low: expected nothing below 0, got -1\.0"):
        optimizer.add_param_group({"params": [numbers(2)], "curvature": "light"} | {"low": -1.0})
    assert len(optimizer.param_groups) == 1


def test_values_stay_between_bounds_and_grads_of_others_are_left():
    a, other = numbers(50), numbers(1)
    optimizer = LeastSquares([a], curvature="signs", lr=1.0, low=-0.2, high=0.4)
    start = other.detach().clone()
    for _ in range(5):
        optimizer.zero_grad()
        optimizer.step(a * 3.0 + other, torch.linspace(-9, 9, 50, dtype=DOUBLE))
        assert bool((a >= -0.2).all()) and bool((a <= 0.4).all())
    assert bool((a == -0.2).any()) and bool((a == 0.4).any())
    assert torch.equal(other, start) and other.grad is not None


def test_values_that_nothing_shows_stay():
    a, unseen = numbers(3), numbers(3)
    optimizer = LeastSquares([a, unseen], curvature="signs")
    optimizer.step(a * 0.0, torch.ones(3, dtype=DOUBLE))
    assert torch.equal(a, numbers(3)) and torch.equal(unseen, numbers(3))
    optimizer.step(a * 1.0, torch.ones(3, dtype=DOUBLE), 0.0)  # nothing counts
    assert torch.equal(a, numbers(3))
    masked = torch.tensor([1.0, 1.0, math.nan], dtype=DOUBLE)
    optimizer.step(a * 1.0, masked, torch.tensor([1.0, 1.0, 0.0]))
    assert bool(a.isfinite().all()) and not torch.equal(a[:2], numbers(3)[:2])


def test_a_step_of_equal_seeds_is_the_same():
    found = []
    for seed in (1, 1, 2):
        a = numbers(6)
        torch.manual_seed(seed)
        LeastSquares([a], curvature="signs").step(matrix(40, 6) @ a, torch.ones(40, dtype=DOUBLE))
        found.append(a.detach())
    assert torch.equal(found[0], found[1]) and not torch.equal(found[0], found[2])
