"""Constraints: the maps, their inverses and derivatives, and their use with torch.nn.utils.parametrize."""

import math

import pytest
import torch
from torch.nn.utils import parametrize

from torchrender.constraints import Positive, ScaledSigmoid, UnitInterval

MAPS = [ScaledSigmoid(-2.0, 5.0), UnitInterval(), Positive(), Positive(0.3)]
IDS = ["sigmoid", "unit", "positive", "floor"]


@pytest.mark.parametrize("constraint", MAPS, ids=IDS)
def test_inverse_and_derivative(constraint):
    x = torch.linspace(-5, 5, 21, dtype=torch.float64, requires_grad=True)
    value = constraint(x)
    assert torch.allclose(constraint.right_inverse(value), x, atol=1e-9)
    assert torch.autograd.gradcheck(constraint, x)
    assert torch.autograd.gradcheck(constraint.right_inverse, value.detach().requires_grad_())


@pytest.mark.parametrize(("constraint", "lo", "hi"), [(ScaledSigmoid(-2, 5), -2, 5), (Positive(0.3), 0.3, math.inf)])
def test_range_holds_for_any_number(constraint, lo, hi):
    value = constraint(torch.tensor([-1e4, -30.0, 0.0, 30.0, 1e4]))
    assert bool(((value >= lo) & (value <= hi)).all()) and bool(torch.isfinite(value).all())
    assert bool((value.diff() >= 0).all())


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
def test_wide_range_of_positive_values(dtype, tolerance):
    value = torch.tensor([2e-4, 1e-3, 0.5, 20.0, 1e4], dtype=dtype)
    back = Positive()(Positive().right_inverse(value))
    assert torch.allclose(back, value, rtol=tolerance, atol=0)


@pytest.mark.parametrize(
    ("constraint", "bad"), [(UnitInterval(), 1.2), (UnitInterval(), -0.1), (Positive(0.3), 0.2), (Positive(), math.nan)]
)
def test_values_out_of_range_are_refused(constraint, bad):
    with pytest.raises(ValueError, match=rf"{type(constraint).__name__}.*got {bad:g} \(1 of 2\)"):
        constraint.right_inverse(torch.tensor([0.5, bad]))
    with pytest.raises(TypeError, match="floating-point"):
        constraint.right_inverse(torch.tensor([1, 2]))


def test_bounds_are_moved_inside():
    assert torch.allclose(
        UnitInterval()(UnitInterval().right_inverse(torch.tensor([0.0, 1.0]))), torch.tensor([1e-3, 0.999])
    )
    inside = Positive(1.0)(Positive(1.0).right_inverse(torch.tensor([1.0])))
    assert torch.allclose(inside, torch.tensor([1.0001]))


@pytest.mark.parametrize("arguments", [(1, 1), (2, 1), (0, math.inf), (0, 1, 0.5), (0, 1, 0.0)])
def test_senseless_bounds(arguments):
    with pytest.raises(ValueError, match="expected"):
        ScaledSigmoid(*arguments)


def test_parametrize_keeps_an_optimisation_in_range():
    module = torch.nn.Module()
    module.value = torch.nn.Parameter(torch.tensor([0.5, 0.25, 0.0]))
    parametrize.register_parametrization(module, "value", UnitInterval())
    assert torch.allclose(module.value, torch.tensor([0.5, 0.25, 1e-3]), atol=1e-6)
    optimizer = torch.optim.Adam(module.parameters(), lr=0.3)
    target = torch.tensor([2.0, 0.6, -1.0])  # the first and last cannot be reached
    for _ in range(300):
        optimizer.zero_grad()
        (module.value - target).square().sum().backward()
        optimizer.step()
        assert bool(((module.value >= 0) & (module.value <= 1)).all())
    assert torch.allclose(module.value, torch.tensor([1.0, 0.6, 0.0]), atol=5e-3)
    with pytest.raises(ValueError, match=r"got 1\.5"):
        module.value = torch.tensor([0.5, 0.5, 1.5])
