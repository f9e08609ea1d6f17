"""The statistical tools themselves: they accept what is right and reject what is slightly wrong."""

import math
import re

import pytest
import torch

from torchrender.testing import (
    check_gradients,
    chi2_p_value,
    chi2_test,
    dot_product_test,
    finite_differences,
    mean_and_variance,
    normal_p_value,
    sidak,
    student_p_value,
    z_test,
)


def uniform(n, columns=2, seed=0):
    return torch.rand(n, columns, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_p_values():
    # Textbook quantiles: chi-square (10 dof) 18.307 and normal 1.959964 at 5 %, Student at 5 % two-sided.
    assert math.isclose(chi2_p_value(18.307, 10), 0.05, rel_tol=1e-4)
    assert math.isclose(float(normal_p_value(torch.tensor(1.959964))), 0.05, rel_tol=1e-5)
    for dof, quantile in ((1, 12.7062), (2, 4.30265), (5, 2.57058), (10, 2.22814), (30, 2.04227), (1000, 1.96234)):
        p = student_p_value(torch.tensor([quantile, -quantile], dtype=torch.float64), dof)
        assert torch.allclose(p, torch.tensor(0.05, dtype=torch.float64), rtol=2e-4)
    assert math.isclose(1 - (1 - sidak(0.01, 50)) ** 50, 0.01, rel_tol=1e-10)
    for bad in [(0.0, 1), (1.0, 1), (0.1, 0)]:
        with pytest.raises(ValueError, match="expected"):
            sidak(*bad)


def cosine_hemisphere(u):
    """Directions with density cos(theta) / pi."""
    radius, azimuth = u[:, 0].sqrt(), 2 * math.pi * u[:, 1]
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), (1 - u[:, 0]).sqrt()], dim=1)


def cosine_density(d):
    return d[:, 2].clamp(min=0) / math.pi


def test_chi2_accepts_a_correct_sampler():
    for domain in ("sphere", "hemisphere"):
        result = chi2_test(cosine_hemisphere(uniform(100_000)), cosine_density, domain=domain)
        assert result and math.isclose(result.mass, 1, abs_tol=1e-4) and result.dof > 200, result.message
        assert float(result.observed.sum()) == 100_000


def test_chi2_rejection_rate_is_the_significance():
    rejected = sum(
        not chi2_test(cosine_hemisphere(uniform(4000, seed=seed)), cosine_density, bins=(4, 8), significance=0.2)
        for seed in range(100)
    )
    assert 8 <= rejected <= 34  # 20 expected, standard deviation 4


@pytest.mark.parametrize(
    ("samples", "density", "reason"),
    [
        (cosine_hemisphere(uniform(100_000) ** 1.03), cosine_density, "p ="),
        (cosine_hemisphere(uniform(100_000)), lambda d: 1.02 * cosine_density(d), "more than one"),
        (cosine_hemisphere(uniform(100_000)), lambda d: 0.98 * cosine_density(d), "p ="),
        (cosine_hemisphere(uniform(100_000)), lambda d: torch.full((len(d),), 1 / (4 * math.pi)), "p ="),
        (-cosine_hemisphere(uniform(1000)), cosine_density, "zero all around"),
        (torch.cat([cosine_hemisphere(uniform(10_000)), -cosine_hemisphere(uniform(2))]), cosine_density, "2 of 10002"),
        (1.1 * cosine_hemisphere(uniform(1000)), cosine_density, "unit vectors"),
        (cosine_hemisphere(uniform(1000)) * math.nan, cosine_density, "unit vectors|not finite"),
    ],
)
def test_chi2_rejects_wrong_samplers(samples, density, reason):
    result = chi2_test(samples, density)
    assert not result and re.search(reason, result.message), result.message


def test_chi2_integrates_peaks():
    """A lobe cos^n of 2 degrees width, anywhere."""
    axis, n = torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64), 2000
    u = uniform(50_000)
    cosine = u[:, 0] ** (1 / (n + 1))
    radius, azimuth = (1 - cosine**2).sqrt(), 2 * math.pi * u[:, 1]
    other = torch.tensor([0.8, 0.0, -0.6], dtype=torch.float64)
    third = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    samples = (
        radius[:, None] * (azimuth.cos()[:, None] * other + azimuth.sin()[:, None] * third) + cosine[:, None] * axis
    )

    def density(d, n=n):
        return (n + 1) / (2 * math.pi) * (d @ axis).clamp(min=0) ** n

    result = chi2_test(samples, density, bins=(64, 128))
    assert result and math.isclose(result.mass, 1, abs_tol=1e-3), result.message
    assert not chi2_test(samples, lambda d: density(d, 1900), bins=(64, 128))


def test_chi2_counts_failed_samples():
    """A sampler that fails for a quarter of the numbers, and a density that says so."""
    u = uniform(50_000)
    valid = u[:, 0] < 0.75
    points = torch.stack([u[:, 0] / 0.75, u[:, 1]], dim=1)

    def density(p):
        return torch.full((len(p),), 0.75)

    assert chi2_test(points, density, domain="square", valid=valid)
    assert not chi2_test(points, lambda p: density(p) * 0.97, domain="square", valid=valid)
    assert not chi2_test(points, density, domain="square")


def test_chi2_arguments():
    good = cosine_hemisphere(uniform(100))
    with pytest.raises(ValueError, match="domain"):
        chi2_test(good, cosine_density, domain="cube")
    with pytest.raises(TypeError, match=r"\(N, 3\)"):
        chi2_test(good[:, :2], cosine_density)
    with pytest.raises(ValueError, match=r"pdf: expected shape"):
        chi2_test(good, lambda d: d)
    with pytest.raises(ValueError, match=r"pdf: expected finite"):
        chi2_test(good, lambda d: -torch.ones(len(d)))
    with pytest.raises(ValueError, match="valid"):
        chi2_test(good, cosine_density, valid=torch.ones(3))


def noisy(shape, seed, offset=0.0):
    """Normal numbers of standard deviation 0.1 around a ramp."""
    noise = torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.linspace(0, 1, math.prod(shape), dtype=torch.float64).reshape(shape) + offset + 0.1 * noise


def test_z_test_accepts_and_rejects():
    shape = (32, 48, 3)
    truth = noisy(shape, 0) * 0 + torch.linspace(0, 1, math.prod(shape), dtype=torch.float64).reshape(shape)
    assert z_test(noisy(shape, 1), truth, variance=0.01)
    assert z_test(noisy(shape, 1), noisy(shape, 2), variance=0.01, reference_variance=torch.full(shape, 0.01), block=4)
    biased = z_test(noisy(shape, 1, offset=0.02), truth, variance=0.01)
    assert not biased and biased.mean_z > biased.mean_threshold and biased.max_z < biased.threshold
    local = noisy(shape, 1)
    local[5, 7, 2] += 1
    result = z_test(local, truth, variance=0.01)
    assert not result and result.where == (5, 7, 2) and result.max_z > result.threshold
    patch = noisy(shape, 1)
    patch[8:12, 8:12, 1] += 0.2
    assert not z_test(patch, truth, variance=0.01, block=4)
    broken = noisy(shape, 1)
    broken[0, 0, 0] = math.nan
    assert not z_test(broken, truth, variance=0.01)


def test_z_test_without_noise():
    image = torch.rand(4, 4, 3)
    assert z_test(image, image.clone())
    assert not z_test(image, image + 1e-3)
    assert z_test(image, image + 1e-3, atol=2e-3)


def test_z_test_rejection_rate():
    truth = torch.linspace(0, 1, 192, dtype=torch.float64).reshape(8, 8, 3)
    rejected = sum(not z_test(noisy((8, 8, 3), seed), truth, variance=0.01, significance=0.2) for seed in range(200))
    assert 22 <= rejected <= 60  # 39 expected, standard deviation 5.6


def test_z_test_arguments():
    image = torch.rand(4, 4, 3)
    with pytest.raises(ValueError, match="reference"):
        z_test(image, image[:2])
    with pytest.raises(ValueError, match="reference_variance"):
        z_test(image, image, reference_variance=-1.0)
    with pytest.raises(ValueError, match="block"):
        z_test(image, image, block=5)
    with pytest.raises(TypeError, match="image"):
        z_test(image.long(), image)


def test_mean_and_variance():
    values = torch.rand(5, 2, dtype=torch.float64)
    mean, variance = mean_and_variance(lambda i: values[i], range(5))
    assert torch.allclose(mean, values.mean(0)) and torch.allclose(variance, values.var(0) / 5)
    with pytest.raises(ValueError, match="two or more"):
        mean_and_variance(lambda i: values[i], [0])


def estimator(x, seed, wrong=1.0):
    """A noisy scalar whose expectation has the gradient cos(x) + 2 x; `wrong` falsifies the derivative only."""
    generator = torch.Generator().manual_seed(seed)
    noise = 1 + 0.3 * torch.randn(x.shape, generator=generator, dtype=torch.float64)
    value = (noise * torch.sin(x) + x * x).sum()
    if x.requires_grad:
        # Independent samples in the derivative, as in a renderer.
        other = 1 + 0.3 * torch.randn(x.shape, generator=generator, dtype=torch.float64)
        derivative = (other * torch.sin(x) + x * x).sum() * wrong
        return value.detach() + derivative - derivative.detach()
    return value


def test_finite_differences():
    x = torch.tensor([0.3, -0.8], dtype=torch.float64)
    result = finite_differences(estimator, x, step=1e-3, seeds=range(400))
    exact = torch.cos(x) + 2 * x
    assert bool(((result.mean - exact).abs() < 4 * result.standard_error + 1e-6).all())
    assert bool((result.standard_error < 0.03).all()) and bool((result.standard_error > 0.005).all())
    direction = torch.tensor([1.0, -2.0], dtype=torch.float64)
    along = finite_differences(estimator, x, direction=direction, step=1e-3, seeds=range(400))
    assert torch.allclose(along.mean, (result.mean * direction).sum(), atol=1e-6) and along.mean.dim() == 0
    with pytest.raises(ValueError, match="direction"):
        finite_differences(estimator, x, direction=direction[:1])
    with pytest.raises(ValueError, match="scalar"):
        finite_differences(lambda x, seed: x, x)


@pytest.mark.parametrize("direction", [None, torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)])
def test_check_gradients(direction):
    x = torch.tensor([0.3, -0.8, 1.2], dtype=torch.float64)
    options = {"direction": direction, "step": 1e-3, "seeds": range(200)}
    right = check_gradients(estimator, x, **options)
    assert right
    result = check_gradients(lambda x, seed: estimator(x, seed, wrong=1.2), x, **options)
    assert not result and "finite differences" in result.message
    # Standard normal for a right gradient: beyond 5 once in 10^6; a wrong one is far out.
    assert float(right.z_score.abs().max()) < 5 < float(result.z_score.abs().max())
    assert not check_gradients(lambda x, seed: estimator(x, seed, wrong=math.nan), x, **options)


def test_check_gradients_without_noise():
    x = torch.tensor([0.3, -0.8], dtype=torch.float64)
    assert check_gradients(lambda x, seed: torch.exp(x).sum(), x, step=1e-4, seeds=range(2))
    linear = check_gradients(lambda x, seed: (2 * x).sum(), x, step=0.5, seeds=range(2))
    assert linear and bool((linear.z_score == 0).all())
    assert not check_gradients(lambda x, seed: torch.exp(x.detach() * 0.01 + x).sum(), x, step=1e-2, seeds=range(2))
    with pytest.raises(ValueError, match="no gradient"):
        check_gradients(lambda x, seed: x.detach().sum(), x, seeds=range(2))


class _Doubled(torch.autograd.Function):
    """2 x, with a reverse mode that is off by a factor."""

    @staticmethod
    def forward(x, factor):
        return 2 * x

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.factor = inputs[1]

    @staticmethod
    def backward(ctx, grad):
        return 2 * ctx.factor * grad, None

    @staticmethod
    def jvp(ctx, tangent, _):
        return 2 * tangent


def test_dot_product_test():
    a, b = torch.rand(4, 3, dtype=torch.float64), torch.rand(3, 5, dtype=torch.float64)
    result = dot_product_test(lambda a, b: torch.sin(a @ b), (a, b), rtol=1e-12)
    assert result and result.forward != 0, result.message
    assert dot_product_test(lambda a: _Doubled.apply(a, 1.0), a, rtol=1e-12)
    assert not dot_product_test(lambda a: _Doubled.apply(a, 1.01), a, rtol=1e-3)
    zero = dot_product_test(lambda a: a * 0, a)
    assert not zero and "zero" in zero.message
    with pytest.raises(ValueError, match="no gradient"):
        dot_product_test(lambda a: a.detach(), a)
    with pytest.raises(TypeError, match="inputs"):
        dot_product_test(lambda a: a, torch.tensor([1]))
    with pytest.raises(ValueError, match="tangents"):
        dot_product_test(lambda a: a, a, tangents=b)
