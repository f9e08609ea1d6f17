"""Derivatives of phase functions: against finite differences, the oracle, and both modes."""

from __future__ import annotations

import math

import pytest
import torch
from oracle import phases
from oracle.world import World
from phase_cases import (
    ARITHMETIC,
    AXIS,
    PHASES,
    TABLE,
    directions,
    phase_parameters,
    probe_of,
    scene_of,
    uniform,
)

WITH_PARAMETERS = [n for n in PHASES if n not in ("isotropic", "rayleigh")]


@pytest.mark.parametrize("variant", ["rgb", "mono"])
@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_derivatives_against_finite_differences(name, variant):
    probe = probe_of(PHASES[name], variant=variant)
    n = 40
    d, wo, p = directions(n, 11), directions(n, 12), uniform(n, 3, seed=13) * 1.2 - 0.1
    adjoint = uniform(n, probe.scene.channels, seed=14) - 0.3
    gradients = probe.reverse(d, wo, adjoint, p)
    checked = 0
    for path, tensor in phase_parameters(probe.scene).items():
        if path.endswith("to_world"):
            continue
        for i in range(tensor.numel()):
            number, h = tensor.data.view(-1)[i], 1e-6
            x = float(number)
            low = x if x < h else x - h  # zeros of a table or a weight have one side only
            high = x if x > 1 - h and "weight" in path else x + h
            sums = []
            for at in (low, high):
                tensor.data.view(-1)[i] = at
                sums.append(float((adjoint.sum(1) * probe.eval(d, wo, p)).sum()))
            tensor.data.view(-1)[i] = x
            expected = (sums[1] - sums[0]) / (high - low)
            rounding = 1e-15 * abs(sums[0]) * n / (high - low)
            onesided = 1e-5 if high - low < 1.5 * h else 1e-8
            found = float(gradients[path].view(-1)[i])
            assert found == pytest.approx(expected, rel=onesided, abs=onesided + rounding), f"{path}[{i}]"
            checked += 1
    assert checked > 0


@pytest.mark.parametrize("variant", ["rgb", "mono"])
@pytest.mark.parametrize("name", PHASES)
def test_values_and_gradients_are_those_of_the_oracle(name, variant):
    probe = probe_of(PHASES[name], variant=variant)
    n = 40
    d, wo, p = directions(n, 11), directions(n, 12), uniform(n, 3, seed=13) * 1.2 - 0.1
    adjoint = uniform(n, probe.scene.channels, seed=14) - 0.3
    wanted = {path: t.requires_grad_() for path, t in phase_parameters(probe.scene).items() if "to_world" not in path}
    value = phases.evaluate(World(probe.scene), probe.index, p, d, wo)
    torch.testing.assert_close(probe.eval(d, wo, p), value.detach(), rtol=1e-12, atol=0)
    if not wanted:
        return
    expected = torch.autograd.grad((adjoint.sum(1) * value).sum(), list(wanted.values()))
    found = probe.reverse(d, wo, adjoint, p)
    for path, gradient in zip(wanted, expected, strict=True):
        torch.testing.assert_close(
            found[path], gradient, rtol=1e-10, atol=1e-14, msg=lambda m, path=path: f"{path}: {m}"
        )


def test_the_derivative_of_hg_at_0():
    """d/dg at g = 0 is 3 cos / (4 pi), the first Legendre polynomial of the expansion in g."""
    wo = directions(30, 15)
    probe = probe_of({"type": "hg", "g": 0.0})
    (path,) = phase_parameters(probe.scene)
    adjoint = torch.tensor([[1.0, 0, 0]])
    found = probe.forward(AXIS, wo, adjoint, {path: torch.ones(())})
    torch.testing.assert_close(found[:, 0], 3 / (4 * math.pi) * (wo @ AXIS))
    assert not found[:, 1:].any()


@pytest.mark.parametrize("arithmetic", ARITHMETIC)
@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_forward_and_reverse_mode_agree(name, arithmetic):
    probe = probe_of(PHASES[name], arithmetic)
    n = 37
    d, wo, p = directions(n, 21), directions(n, 22), uniform(n, 3, seed=23)
    adjoint = uniform(n, 3, seed=24)
    tangents = {
        path: uniform(*t.shape, seed=25 + i) - 0.5
        for i, (path, t) in enumerate(phase_parameters(probe.scene).items())
        if not path.endswith("to_world")
    }
    gradients = probe.reverse(d, wo, adjoint, p)
    reverse = sum(float((gradients[path].double() * t).sum()) for path, t in tangents.items())
    forward = probe.forward(d, wo, adjoint, tangents, p).double().sum()
    assert float(forward) == pytest.approx(reverse, rel=1e-10 if arithmetic == "double" else 1e-4)


def test_a_gradient_of_a_table_has_no_part_along_the_table():
    """Scaling all numbers changes nothing (Euler's theorem)."""
    probe = probe_of(PHASES["table"])
    (path,) = phase_parameters(probe.scene)
    gradient = probe.reverse(directions(30, 31), directions(30, 32), uniform(30, 3), None)[path]
    along = float(gradient @ torch.tensor(TABLE, dtype=torch.float64))
    assert abs(along) < 1e-13 * float(gradient.norm()) * 10


def test_zeros_next_to_each_other_are_said():
    scene = scene_of(PHASES["table with zeros"])
    assert "without scattering into angles between two zeros" in str(scene)
    assert "between two zeros" not in str(scene_of(PHASES["table"]))
