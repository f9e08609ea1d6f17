"""`evaluate`, `fit` and `refine`: the field in plain PyTorch, its derivatives of any order, and its grids."""

from __future__ import annotations

import pytest
import torch
from bent_scenes import DOUBLE, centers, direction_like, random_index

import torchrender as tr

BOTH = pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
evaluate, fit, refine = tr.gradientindex.evaluate, tr.gradientindex.fit, tr.gradientindex.refine


def points(n: int, low: float = 0.0, high: float = 1.0, seed: int = 5) -> torch.Tensor:
    return low + (high - low) * torch.rand(n, 3, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


def uneven(seed: int = 0) -> torch.Tensor:
    """5 x 6 x 7 voxels along x, y, z."""
    return 1.5 + 0.1 * torch.randn(7, 6, 5, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


def smooth() -> torch.Tensor:
    """What `fit` can do: noise between neighbours becomes up to 27 times as large."""
    return 1.5 + 0.1 * (uneven() - 1.5)


def grid_points(shape: tuple[int, ...]) -> torch.Tensor:
    """The centres of voxels (Z, Y, X, 3) in the cube."""
    lines = [(torch.arange(n, dtype=DOUBLE) + 0.5) / n for n in shape]
    z, y, x = torch.meshgrid(*lines, indexing="ij")
    return torch.stack([x, y, z], -1)


@BOTH
def test_the_gradient_is_that_of_the_index(interpolation):
    index, at = uneven(), points(50).requires_grad_()
    n, slope = evaluate(index, at, interpolation)
    assert n.shape == (50,) and slope.shape == (50, 3)
    (gradient,) = torch.autograd.grad(n.sum(), at)
    assert torch.allclose(slope, gradient, rtol=1e-12, atol=1e-12)
    shaped = evaluate(index, at.detach().reshape(5, 2, 5, 3), interpolation)
    assert torch.equal(shaped[0].flatten(), n.detach()) and shaped[1].shape == (5, 2, 5, 3)


@BOTH
def test_derivatives_of_first_and_second_order(interpolation):
    index, at = uneven()[:3, :2].contiguous().requires_grad_(), points(4).requires_grad_()
    assert torch.autograd.gradcheck(lambda i, p: evaluate(i, p, interpolation), (index, at))
    assert torch.autograd.gradgradcheck(lambda i, p: evaluate(i, p, interpolation), (index, at))


def test_the_gradient_is_the_same_for_any_number_of_threads():
    """Many points read each number, and what they add to its derivative is added up in one order."""
    generator, before = torch.Generator().manual_seed(3), torch.get_num_threads()
    index = (1.2 + 0.1 * torch.rand(9, 9, 9, generator=generator)).requires_grad_()
    at, weight = torch.rand(20000, 3, generator=generator), torch.rand(20000, generator=generator)
    found = []
    try:
        for threads in (1, 2, 2, 2):
            torch.set_num_threads(threads)
            found += torch.autograd.grad((evaluate(index, at)[0] * weight).sum(), index)
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(found[0], other) for other in found[1:])


@BOTH
def test_the_field_of_rays_is_the_same(interpolation):
    """A ray's index at its end, by the core, is what `evaluate` gives there."""
    from bent_scenes import beam, glass

    index = random_index(9)
    for dtype, tolerance in ((DOUBLE, 1e-13), (torch.float32, 1e-6)):
        scene = glass(index, "null", dtype, interpolation=interpolation)
        rays = tr.gradientindex.trace(scene, "lens", *beam(100))
        n, _ = evaluate(index.to(dtype), (rays.position + 1) / 2, interpolation)
        assert torch.allclose(n, rays.index, rtol=tolerance, atol=0)


@BOTH
def test_between_the_least_and_the_largest_control_value(interpolation):
    index = random_index(6, 0.3)
    n, _ = evaluate(index, points(2000, -0.5, 1.5), interpolation)
    assert float(index.min()) <= float(n.min()) and float(n.max()) <= float(index.max())
    constant, slope = evaluate(torch.full((3, 2, 1), 1.7, dtype=DOUBLE), points(20), interpolation)
    assert (
        torch.allclose(constant, torch.full((20,), 1.7, dtype=DOUBLE), rtol=1e-15) and float(slope.abs().max()) < 1e-14
    )


@BOTH
def test_beyond_the_border_it_goes_on_as_it_ends(interpolation):
    """Constant from half a voxel outside on."""
    index, at = uneven(), points(50, -2, 3)
    size = torch.tensor([5.0, 6.0, 7.0], dtype=DOUBLE)
    inside = torch.minimum(torch.maximum(at, -0.5 / size), 1 + 0.5 / size)
    far, near = evaluate(index, at, interpolation)[0], evaluate(index, inside, interpolation)[0]
    assert torch.allclose(far, near, rtol=1e-14, atol=0)


@BOTH
def test_fit_gives_the_samples(interpolation):
    for samples in (smooth(), 1.3 + 0.1 * torch.rand(1, 1, 4, dtype=DOUBLE), torch.full((1, 1, 1), 2.0, dtype=DOUBLE)):
        control = fit(samples, interpolation)
        n, _ = evaluate(control, grid_points(tuple(samples.shape)), interpolation)
        assert torch.allclose(n, samples, rtol=1e-13, atol=0)


@BOTH
def test_derivatives_of_fit_and_refine(interpolation):
    samples = smooth()[:3, :2, :3].contiguous().requires_grad_()
    assert torch.autograd.gradcheck(lambda s: fit(s, interpolation), (samples,))
    assert torch.autograd.gradcheck(lambda s: refine(s, interpolation), (samples,))
    assert torch.autograd.gradgradcheck(lambda s: fit(s, interpolation), (samples,))


@BOTH
def test_fit_is_accurate(interpolation):
    """Of a smooth index in the inside: the error falls with the third power of the voxels' size, at least."""
    errors = []
    for size in (16, 32):
        x, y, z = centers(size, 1.0)
        control = fit(1.5 + 0.1 * torch.sin(2 * x + y) * torch.cos(z), interpolation)
        at = points(500, 0.3, 0.7)
        n, _ = evaluate(control, at, interpolation)
        x, y, z = (2 * at - 1).unbind(1)
        errors.append(float((n - 1.5 - 0.1 * torch.sin(2 * x + y) * torch.cos(z)).abs().max()))
    assert errors[1] < errors[0] / 7 and errors[1] < 1e-5


def test_refining_a_quadratic_field_changes_nothing():
    index = uneven()
    fine = refine(index, "quadratic")
    assert fine.shape == (14, 12, 10)
    at = points(500)
    for a, b in zip(evaluate(fine, at, "quadratic"), evaluate(index, at, "quadratic")):
        assert torch.allclose(a, b, rtol=1e-12, atol=1e-12)


def test_refining_a_cubic_field_keeps_its_values_in_the_new_centers():
    index = uneven()
    fine = refine(index)
    assert fine.shape == (14, 12, 10)
    at = grid_points((14, 12, 10))
    assert torch.allclose(evaluate(fine, at)[0], evaluate(index, at)[0], rtol=1e-12, atol=0)
    everywhere = points(500)
    off = (evaluate(fine, everywhere)[0] - evaluate(index, everywhere)[0]).abs().max()
    assert 1e-6 < float(off) < 0.02  # close to the field, which no finer grid has


@BOTH
def test_precision_follows_the_tensor(interpolation):
    index, at = uneven(), points(50)
    for made, wanted in (
        (evaluate(index.float(), at.float(), interpolation)[0], evaluate(index, at, interpolation)[0]),
        (fit(smooth().float(), interpolation), fit(smooth(), interpolation)),
        (refine(index.float(), interpolation), refine(index, interpolation)),
    ):
        assert made.dtype == torch.float32
        assert torch.allclose(made.double(), wanted, rtol=1e-5, atol=0)


def test_arguments():
    good, at = uneven(), points(3)
    for function in (lambda i, **m: evaluate(i, at, **m), fit, refine):
        with pytest.raises(ValueError, match=r"interpolation: expected one of .*'cubic'.*got 'linear'"):
            function(good, interpolation="linear")
        name = "samples" if function is fit else "index"
        with pytest.raises(TypeError, match=name + r": expected a floating-point tensor of shape \(Z, Y, X\), got 1.5"):
            function(1.5)
        with pytest.raises(TypeError, match="expected a floating-point tensor"):
            function(torch.ones(2, 2, 2, dtype=torch.int64))
        for shape in ((2, 2), (2, 2, 2, 1), (0, 2, 2)):
            with pytest.raises(ValueError, match=name + r": expected shape \(Z, Y, X\), none of them 0"):
                function(torch.ones(shape))
        for bad in (0.0, -1.0, float("nan"), float("inf")):
            with pytest.raises(ValueError, match=name + ": expected positive numbers that are finite"):
                function(torch.full((2, 2, 2), bad))
    with pytest.raises(ValueError, match=r"points: expected a tensor of shape \(..., 3\)"):
        evaluate(good, torch.zeros(3, 2))
    rough = torch.ones(8, 8, 8)
    rough[4, 4, 4] = 9
    with pytest.raises(ValueError, match="samples: they change so fast"):
        fit(rough)


def test_transforms_of_torch_func():
    """Plain PyTorch: all of them, second derivatives and batches too."""
    index, at = uneven(), points(6)
    one = torch.func.vmap(lambda p: evaluate(index, p)[0])(at)
    assert torch.allclose(one, evaluate(index, at)[0])
    hessian = torch.func.hessian(lambda p: evaluate(index, p)[0])(at[0])
    assert torch.allclose(hessian, hessian.T) and float(hessian.abs().max()) > 0.1
    along, weight = direction_like(index), direction_like(at[:, 0])
    _, change = torch.func.jvp(lambda i: evaluate(i, at)[0], (index,), (along,))
    (by_index,) = torch.func.vjp(lambda i: evaluate(i, at)[0], index)[1](weight)
    assert torch.allclose((by_index * along).sum(), (weight * change).sum(), rtol=1e-12)
