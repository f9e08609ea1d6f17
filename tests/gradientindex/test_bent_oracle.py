"""Bent rays against the same scheme in plain PyTorch, whose derivatives are autograd's through all steps."""

from __future__ import annotations

import math

import pytest
import torch
from bent_scenes import DOUBLE, beam, direction_like, glass, random_index
from oracle.bend import Phi, trace_box

import torchrender as tr

DEGREE = {"cubic": 3, "quadratic": 2}
SIDES = (11, 9, 13)  # voxels along x, y, z of [-1, 1]^3


def index_of(seed: int = 0) -> torch.Tensor:
    noise = torch.randn(SIDES[::-1], generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)
    return 1.5 + 0.04 * noise


def rays_in(n: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    o, d = beam(n)
    return o, d + 0.1 * direction_like(d)


def in_voxels(
    index: torch.Tensor, o: torch.Tensor, d: torch.Tensor, degree: int, step: float, largest: float = 0.0
) -> tuple[torch.Tensor, ...]:
    """What `trace` finds with a null boundary: position, direction, optical path and length in the world."""
    size = torch.tensor(SIDES, dtype=DOUBLE)
    d = d / d.norm(dim=1, keepdim=True)
    at = o + d * ((-1 - o[:, 2]) / d[:, 2])[:, None]
    q = (at + 1) / 2 * size
    phi = Phi(index, degree)
    largest = largest or math.ceil(float(index.detach().max()) * 16) / 16
    length = step * 2 / max(SIDES) / largest
    n = torch.sqrt(2 * phi(q)[0])
    u = length * d * n[:, None] * size / 2
    found = trace_box(phi, q, u, torch.diag((length * size / 2) ** 2))
    velocity = found.velocity / size
    position = found.position / size * 2 - 1
    direction = velocity / velocity.norm(dim=1, keepdim=True)
    return position, direction, found.optical * length, found.length * length, found.steps


def number_of(position, direction, optical, length):
    found = torch.sin(3 * position).sum(1) + torch.cos(2 * direction).sum(1)
    return ((found + optical.square() + length.sin()) * torch.linspace(0.5, 1.5, len(position), dtype=DOUBLE)).sum()


@pytest.mark.parametrize("step", [1.0, 0.3, 1.9])
@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_values_and_gradients(interpolation, step):
    index = index_of()
    scene = glass(index, "null", interpolation=interpolation, step=step)
    leaves = [t.clone().requires_grad_() for t in (index, *rays_in())]
    rays = tr.gradientindex.trace(scene, "lens", *leaves[1:], params={"lens.interior.index": leaves[0]})
    assert bool(rays.valid.all())
    ours = (rays.position, rays.direction, rays.optical_path, rays.length)
    *theirs, steps = in_voxels(*leaves, DEGREE[interpolation], step)
    assert torch.equal(rays.steps.long(), steps)
    for a, b in zip(ours, theirs):
        assert torch.allclose(a, b, rtol=1e-10, atol=1e-12)
    gradients = torch.autograd.grad(number_of(*ours), leaves)
    for a, b in zip(gradients, torch.autograd.grad(number_of(*theirs), leaves)):
        assert float((a - b).norm()) < 1e-10 * float(b.norm())


def test_forward_mode():
    """Tangents of every output against autograd's through all steps."""
    index, (o, d) = index_of(), rays_in(20)
    along = tuple(direction_like(t, seed=7) for t in (index, o, d))

    def ours(index, o, d):
        rays = tr.gradientindex.trace(scene, "lens", o, d, params={"lens.interior.index": index})
        return rays.position, rays.direction, rays.optical_path, rays.length

    scene = glass(index, "null")
    _, tangents = torch.func.jvp(ours, (index, o, d), along)
    _, wanted = torch.func.jvp(lambda *x: in_voxels(*x, 3, 1.0)[:4], (index, o, d), along)
    for a, b in zip(tangents, wanted):
        assert float((a - b).norm()) < 1e-10 * float(b.norm())


def adjoint_and_difference(degree: int) -> tuple[float, float]:
    """The derivative of an average over many rays: by the scheme's adjoint, and by a difference."""
    index, (o, d) = index_of(), beam(600)
    along, step = direction_like(index, seed=3), 2e-4

    def f(amount):
        *found, _ = in_voxels(index + amount * along, o, d, degree, 1.0, largest=1.75)
        return number_of(*found) / len(o)

    amount = torch.zeros((), dtype=DOUBLE, requires_grad=True)
    (adjoint,) = torch.autograd.grad(f(amount), amount)
    with torch.no_grad():
        return float(adjoint), float(f(torch.tensor(step)) - f(torch.tensor(-step))) / (2 * step)


def test_the_linear_interpolation_that_is_refused_has_another_derivative():
    """Its force jumps from voxel to voxel, of which an adjoint knows nothing; splines pass this very test."""
    for degree in (2, 3):
        adjoint, difference = adjoint_and_difference(degree)
        assert difference == pytest.approx(adjoint, rel=5e-3)
    adjoint, difference = adjoint_and_difference(1)
    assert abs(difference - adjoint) > 0.1 * abs(adjoint)


def test_reference_values_of_splines():
    """The recursion has the values that tables have, and sums to 1."""
    index = random_index(6)
    q = torch.rand(50, 3, generator=torch.Generator().manual_seed(4), dtype=DOUBLE) * 6
    for name, degree in DEGREE.items():
        n, slope = tr.gradientindex.evaluate(index, q / 6, name)
        value, gradient = Phi(index, degree)(q)
        assert torch.allclose(n, torch.sqrt(2 * value), rtol=1e-13, atol=0)
        assert torch.allclose(slope / 6, gradient / n[:, None], rtol=1e-11, atol=1e-13)
        assert torch.allclose(Phi(torch.ones_like(index), degree)(q)[0], torch.full((50,), 0.5, dtype=DOUBLE))
