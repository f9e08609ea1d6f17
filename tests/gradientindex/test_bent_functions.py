"""Bent rays within `torch.func` and `torch.compile`, on several threads, and in memory that steps do not fill."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from bent_scenes import DOUBLE, beam, direction_like, glass, in_both_modes, number_of, random_index

import torchrender as tr

TESTS = Path(__file__).parent.parent
INDEX = "lens.interior.index"


def setting(n: int = 10) -> tuple[tr.Scene, tuple[torch.Tensor, torch.Tensor], torch.Tensor]:
    index = random_index(5)
    return glass(index, "null"), beam(n), index


def gradient_of(scene, rays, index):
    leaf = index.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(
        number_of(tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: leaf})), leaf
    )
    return gradient


# ------------------------------------------------------------------------------------------------------- torch.func
def test_grad_vjp_and_jacobians():
    scene, rays, index = setting(4)
    small = index[:2, :2, :2].contiguous()

    def position(values):
        return tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: values}).position[:2]

    def number(values):
        return number_of(tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: values}))

    scene = glass(small, "null")
    assert torch.allclose(torch.func.grad(number)(small), gradient_of(scene, rays, small), rtol=1e-13)
    weight = direction_like(position(small))
    (pulled,) = torch.func.vjp(position, small)[1](weight)
    jacobian = torch.func.jacrev(position, chunk_size=1)(small)
    assert jacobian.shape == (2, 3, 2, 2, 2)
    assert torch.allclose((jacobian * weight[..., None, None, None]).sum((0, 1)), pulled, rtol=1e-12, atol=1e-14)
    along = direction_like(small)
    _, pushed = torch.func.jvp(position, (small,), (along,))
    assert torch.allclose((jacobian * along).sum((2, 3, 4)), pushed, rtol=1e-11, atol=1e-14)


def test_several_tangents_at_once():
    """Rays, index and boundary move together: the sum of what each does alone."""
    scene, rays, index = setting()
    along = tuple(direction_like(t, seed=k) for k, t in enumerate((index, *rays)))

    def f(values, o, d):
        return tr.gradientindex.trace(scene, "lens", o, d, params={INDEX: values}).direction

    _, together = torch.func.jvp(f, (index, *rays), along)
    alone = torch.zeros_like(together)
    for k in range(3):
        one = tuple(t if i == k else torch.zeros_like(t) for i, t in enumerate(along))
        alone = alone + torch.func.jvp(f, (index, *rays), one)[1]
    assert torch.allclose(together, alone, rtol=1e-11, atol=1e-14)


def test_batches_are_refused():
    scene, rays, index = setting()
    with pytest.raises(tr.NotDifferentiableError, match="vmap does not reach into a rendering"):
        torch.func.vmap(lambda o: tr.gradientindex.trace(scene, "lens", o[None], rays[1][:1]).position)(rays[0])
    with pytest.raises(tr.NotDifferentiableError, match="vmap does not reach into a rendering"):
        torch.func.vmap(lambda i: tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: i}).position)(index[None])
    position = lambda i: tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: i}).position  # noqa: E731
    with pytest.raises(tr.NotDifferentiableError, match="chunk_size=1"):
        torch.func.jacrev(position)(index)
    leaf = index.clone().requires_grad_()
    found = position(leaf)
    with pytest.raises(tr.NotDifferentiableError, match="vmap does not reach into a rendering"):
        torch.autograd.grad(found, leaf, torch.ones(2, *found.shape, dtype=DOUBLE), is_grads_batched=True)


def test_second_derivatives_are_refused():
    """Rather than wrong: in all four orders of the modes."""
    scene, rays, index = setting()

    def f(values):
        return number_of(tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: values}))

    leaf = index.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(f(leaf), leaf, create_graph=True)
    with pytest.raises(tr.NotDifferentiableError, match="first derivatives only"):
        gradient.sum().backward()
    along = direction_like(index)
    for outer in ("grad", "jvp"):
        for inner in ("grad", "jvp"):

            def first(values, inner=inner):
                if inner == "grad":
                    return (torch.func.grad(f)(values) * along).sum()
                return torch.func.jvp(f, (values,), (along,))[1]

            with pytest.raises(tr.NotDifferentiableError, match="first derivatives only"):
                torch.func.grad(first)(index) if outer == "grad" else torch.func.jvp(first, (index,), (along,))


def test_a_compiled_caller():
    scene, rays, index = setting()

    def f(values):
        found = tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: values * 1.01})
        return found.position.square().sum() + found.optical_path.sum()

    compiled = torch.compile(f, backend="eager")
    results = []
    for function in (f, compiled):
        leaf = index.clone().requires_grad_()
        value = function(leaf)
        value.backward()
        results.append((value.detach(), leaf.grad))
    assert all(torch.equal(a, b) for a, b in zip(*results))


def test_nothing_is_kept_without_derivatives():
    scene, rays, index = setting()
    with torch.no_grad():
        found = tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: index.clone().requires_grad_()})
    assert not any(x.requires_grad for x in found)
    found = tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: index.clone().requires_grad_()})
    assert all(
        getattr(found, name).requires_grad for name in ("position", "direction", "optical_path", "length", "index")
    )
    assert not any(getattr(found, name).requires_grad for name in ("steps", "shape_id", "valid"))


def test_autocast_changes_nothing():
    scene, rays, _ = setting()
    plain = tr.gradientindex.trace(scene, "lens", *rays)
    with torch.autocast("cpu", torch.bfloat16):
        cast = tr.gradientindex.trace(scene, "lens", *rays)
    assert all(torch.equal(a, b) for a, b in zip(plain, cast))


# ------------------------------------------------------------------------------------------------------------ threads
@pytest.mark.core
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_threads(dtype):
    """Rays have the same bits on one and two threads, and tangents; sums over rays are equal to rounding."""
    index = random_index(12).to(dtype)
    scene, rays = glass(index, dtype=dtype), tuple(r.to(dtype) for r in beam(5000))
    along = direction_like(index)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found, tangents = torch.func.jvp(
                lambda i: tuple(tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: i})[:6]), (index,), (along,)
            )
            results.append((found, tangents, gradient_of(scene, rays, index)))
    finally:
        torch.set_num_threads(before)
    (one, one_tangent, one_gradient), (two, two_tangent, two_gradient) = results
    assert all(torch.equal(a, b) for a, b in zip(one, two))
    assert all(torch.equal(a, b) for a, b in zip(one_tangent, two_tangent))
    scale = float(one_gradient.abs().max())
    assert float((one_gradient - two_gradient).abs().max()) < (1e-5 if dtype == torch.float32 else 1e-13) * scale


@pytest.mark.core
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_rays_are_those_that_are_traced_alone(dtype, interpolation):
    """What others are in a packet, and how many steps they have, changes no bit of a ray, nor of its derivatives."""
    index = random_index(12).to(dtype)
    scene = glass(index, "null", dtype, interpolation=interpolation)
    o, d = (r.to(dtype) for r in beam(41))
    d = d + 0.3 * direction_like(d)
    along = direction_like(index)

    def f(o, d):
        return torch.func.jvp(
            lambda i: tuple(tr.gradientindex.trace(scene, "lens", o, d, params={INDEX: i})[:6]), (index,), (along,)
        )

    whole = f(o, d)
    for row in (0, 7, 16, 40):
        for a, b in zip(whole, f(o[row : row + 1], d[row : row + 1])):
            assert all(torch.equal(x[row], y[0]) for x, y in zip(a, b))


@pytest.mark.core
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_long_ways_back(dtype):
    """Thousands of steps: reverse mode, which goes back over them, agrees with forward mode, which does not."""
    scene = glass(random_index(8), "null", dtype, step=0.004)
    rays = tuple(r.to(dtype) for r in beam(16))
    assert int(tr.gradientindex.trace(scene, "lens", *rays).steps.min()) > 1900
    index = random_index(8).to(dtype)
    reverse, forward = in_both_modes(
        lambda i: number_of(tr.gradientindex.trace(scene, "lens", *rays, params={INDEX: i})),
        index,
        direction_like(index),
    )
    assert forward == pytest.approx(reverse, rel=1e-3 if dtype == torch.float32 else 1e-10)


# ------------------------------------------------------------------------------------------------------------- memory
PROGRAM = """
import sys
sys.path[:0] = {paths!r}
import torch
from bent_scenes import beam, glass, number_of, random_index
import torchrender as tr

def peak():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))

torch.set_num_threads(1)
rays = tuple(r.float() for r in beam(4000))
for step in (0.16, 0.16, 0.16, {step}):
    scene = glass(random_index(16), "null", torch.float32, step=step)
    leaf = random_index(16).float().requires_grad_()
    found = tr.gradientindex.trace(scene, "lens", *rays, params={{"lens.interior.index": leaf}})
    number_of(found).backward()
    print(int(found.steps.max()), peak())
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux' /proc")
def test_memory_does_not_grow_with_steps():
    """The peak of a process (VmHWM) after derivatives of 100 steps, taken often enough, and after those of 3000.

    A state of 24 bytes a step would be 280 MB for the 4000 rays.
    """
    paths = [str(TESTS.parent), str(TESTS / "helpers")]
    program = PROGRAM.format(paths=paths, step=0.0053)
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=True)
    (few, before), (many, after) = (map(int, line.split()) for line in run.stdout.splitlines()[2:])
    assert 90 < few < 120 and many > 2900
    assert after - before < 1024  # kB
