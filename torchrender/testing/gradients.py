"""Tests of derivatives: finite differences with common random numbers, and forward mode against reverse mode."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import torch
from torch.autograd import forward_ad

from ..errors import describe
from .images import mean_and_variance
from .statistics import sidak, student_p_value


@dataclass(frozen=True)
class FiniteDifferences:
    """Derivatives with their uncertainty.

    Attributes:
        mean: of the seeds' central differences, float64, of the tensor's shape, or () for one direction.
        standard_error: of that mean; the error of the difference quotient itself (order step^2) comes on top.
        count: number of seeds.
    """

    mean: torch.Tensor
    standard_error: torch.Tensor
    count: int


@dataclass(frozen=True)
class GradientResult:
    """What :func:`check_gradients` found; true if the test passed.

    Attributes:
        gradient, expected: means over the seeds of the derivative and of the finite differences.
        standard_error: of their difference.
        p_value: of every entry (two-sided, Student); zero where a deviation has no noise to explain it.
        level: p-values below it reject, corrected for the number of entries.
        message: the outcome in words.
    """

    passed: bool
    gradient: torch.Tensor
    expected: torch.Tensor
    standard_error: torch.Tensor
    p_value: torch.Tensor
    level: float
    message: str

    def __bool__(self) -> bool:
        return self.passed

    @property
    def z_score(self) -> torch.Tensor:
        """``gradient - expected`` in standard errors; infinite where a difference has no noise to explain it."""
        difference = self.gradient - self.expected
        return torch.where(difference == 0, torch.zeros_like(difference), difference / self.standard_error)


@dataclass(frozen=True)
class DotProductResult:
    """What :func:`dot_product_test` found; true if the test passed.

    Attributes:
        forward: <J v, w>.
        reverse: <v, J^T w>.
        relative_error: their difference over the sum of the magnitudes of the products that make them up.
        message: the outcome in words.
    """

    passed: bool
    forward: float
    reverse: float
    relative_error: float
    message: str

    def __bool__(self) -> bool:
        return self.passed


def finite_differences(
    f: Callable[[torch.Tensor, int], torch.Tensor],
    tensor: torch.Tensor,
    *,
    direction: torch.Tensor | None = None,
    step: float = 1e-2,
    seeds: Iterable[int] = range(16),
) -> FiniteDifferences:
    """Central differences ``(f(x + h d, seed) - f(x - h d, seed)) / 2h``, both with the same random numbers.

    Args:
        f: takes a tensor like `tensor` and a seed, returns a scalar tensor.
        tensor: the point, floating point.
        direction: d, of the tensor's shape; without it the derivative in every entry is taken, at two evaluations per
            entry and seed.
        step: h.
        seeds: two or more.

    Returns:
        A `FiniteDifferences`.

    Raises:
        TypeError, ValueError: if an argument is not one of those above.
    """
    if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point():
        raise TypeError(f"tensor: expected a floating-point tensor, got {describe(tensor)}")
    if direction is not None and direction.shape != tensor.shape:
        raise ValueError(f"direction: expected shape {tuple(tensor.shape)}, got {tuple(direction.shape)}")
    if not step > 0:
        raise ValueError(f"step: expected a positive number, got {step!r}")
    seeds = list(seeds)
    base = tensor.detach()
    if direction is not None:
        directions = direction.detach().to(base)[None]
    else:
        directions = torch.eye(base.numel(), dtype=base.dtype, device=base.device).reshape(-1, *base.shape)

    def difference(seed: int) -> torch.Tensor:
        values = []
        with torch.no_grad():
            for d in directions:
                high, low = f(base + step * d, seed), f(base - step * d, seed)
                if high.numel() != 1:
                    raise ValueError(f"f: expected a scalar, got shape {tuple(high.shape)}")
                values.append((high.double() - low.double()).reshape(()) / (2 * step))
        shape = () if direction is not None else base.shape
        return torch.stack(values).reshape(shape)

    mean, variance = mean_and_variance(difference, seeds)
    return FiniteDifferences(mean, variance.sqrt(), len(seeds))


def check_gradients(
    f: Callable[[torch.Tensor, int], torch.Tensor],
    tensor: torch.Tensor,
    *,
    direction: torch.Tensor | None = None,
    step: float = 1e-2,
    seeds: Iterable[int] = range(16),
    significance: float = 0.01,
    rtol: float = 1e-3,
    atol: float = 1e-6,
    tests: int = 1,
) -> GradientResult:
    """Test the gradient that ``backward()`` gives of a noisy function against finite differences.

    The derivative's samples may be independent of the function's, as a renderer's are: what is compared are means over
    the seeds, with a Student test in every entry (Šidák-corrected for their number).

    Args:
        f: takes a tensor like `tensor` and a seed, returns a scalar tensor with a gradient; linear in the rendered
            image, or the derivative of its expectation is not the expectation of its derivative.
        tensor, direction, step, seeds: as in :func:`finite_differences`.
        significance: probability of rejecting a correct gradient in all `tests` tests together.
        rtol, atol: deviations up to ``atol + rtol * |derivative|`` do not count: the error of the difference quotient
            and rounding.
        tests: number of tests that are judged together.

    Returns:
        A `GradientResult`.

    Raises:
        TypeError, ValueError: if an argument is not one of those above, or the result has no gradient.
    """
    seeds = list(seeds)
    expected = finite_differences(f, tensor, direction=direction, step=step, seeds=seeds)

    def gradient(seed: int) -> torch.Tensor:
        leaf = tensor.detach().clone().requires_grad_()
        value = f(leaf, seed)
        if not value.requires_grad:
            raise ValueError("f: its result has no gradient with respect to the tensor")
        (result,) = torch.autograd.grad(value, leaf)
        return result if direction is None else (result.double() * direction.to(result).double()).sum()

    mean, variance = mean_and_variance(gradient, seeds)
    first, second = variance, expected.standard_error**2
    error = (first + second).sqrt()
    excess = ((mean - expected.mean).abs() - atol - rtol * expected.mean.abs()).clamp(min=0)
    # A NaN is a deviation that nothing explains.
    excess = torch.where(torch.isfinite(mean - expected.mean), excess, torch.full_like(excess, torch.inf))
    # Welch and Satterthwaite's degrees of freedom lie between n - 1 and 2 n - 2: the cautious end.
    p_value = torch.where(
        excess == 0,
        torch.ones_like(excess),
        torch.where(error > 0, student_p_value(excess / error, len(seeds) - 1), torch.zeros_like(excess)),
    )
    p_value = torch.where(torch.isfinite(excess), p_value, torch.zeros_like(p_value))
    level = sidak(sidak(significance, tests), p_value.numel())
    passed = bool((p_value >= level).all())
    worst = int(p_value.flatten().argmin())
    where = tuple(int(i) for i in torch.unravel_index(torch.tensor(worst), p_value.shape)) if p_value.dim() else ()
    flat = [value.flatten()[worst].item() for value in (mean, expected.mean, error)]
    message = (
        f"smallest p = {p_value.flatten()[worst].item():.3g} (level {level:.3g}) at {where}: "
        f"gradient {flat[0]:.6g}, finite differences {flat[1]:.6g}, standard error {flat[2]:.2g}"
    )
    return GradientResult(passed, mean, expected.mean, error, p_value, level, message)


def dot_product_test(
    f: Callable[..., torch.Tensor],
    inputs: torch.Tensor | Sequence[torch.Tensor],
    *,
    tangents: torch.Tensor | Sequence[torch.Tensor] | None = None,
    cotangent: torch.Tensor | None = None,
    rtol: float = 1e-4,
    seed: int = 0,
) -> DotProductResult:
    """Test that forward and reverse mode are transposes of each other: ``<J v, w> = <v, J^T w>``.

    Args:
        f: takes the inputs, returns a tensor; has to be the same function in both modes (fix its seeds).
        inputs: one floating-point tensor or several.
        tangents: v, like the inputs; by default normal random numbers.
        cotangent: w, like the result; by default normal random numbers.
        rtol: allowed `relative_error`, a multiple of the rounding of the dtype.
        seed: of the random numbers.

    Returns:
        A `DotProductResult`. A derivative that is zero altogether fails: it would agree with anything.

    Raises:
        TypeError, ValueError: if an argument is not one of those above, or the result has no gradient.
    """
    inputs = (inputs,) if isinstance(inputs, torch.Tensor) else tuple(inputs)
    if not inputs or any(not isinstance(x, torch.Tensor) or not x.is_floating_point() for x in inputs):
        raise TypeError(f"inputs: expected floating-point tensors, got {[describe(x) for x in inputs]}")
    generator = torch.Generator().manual_seed(seed)

    def normal(like: torch.Tensor) -> torch.Tensor:
        return torch.randn(like.shape, generator=generator, dtype=torch.float64).to(like)

    if tangents is None:
        tangents = [normal(x) for x in inputs]
    tangents = (tangents,) if isinstance(tangents, torch.Tensor) else tuple(tangents)
    if [t.shape for t in tangents] != [x.shape for x in inputs]:
        raise ValueError(f"tangents: expected shapes {[tuple(x.shape) for x in inputs]}")
    with forward_ad.dual_level():
        duals = [forward_ad.make_dual(x.detach(), t.to(x)) for x, t in zip(inputs, tangents)]
        primal, derivative = forward_ad.unpack_dual(f(*duals))
        derivative = torch.zeros_like(primal) if derivative is None else derivative.detach().clone()
    leaves = [x.detach().clone().requires_grad_() for x in inputs]
    value = f(*leaves)
    if not value.requires_grad:
        raise ValueError("f: its result has no gradient with respect to the inputs")
    cotangent = normal(value) if cotangent is None else cotangent.to(value)
    if cotangent.shape != value.shape:
        raise ValueError(f"cotangent: expected shape {tuple(value.shape)}, got {tuple(cotangent.shape)}")
    gradients = torch.autograd.grad(value, leaves, cotangent, allow_unused=True)
    products = [derivative.double() * cotangent.double()]
    pulled = [t.double() * g.double() for t, g in zip(tangents, gradients) if g is not None]
    forward = float(sum(p.sum() for p in products))
    reverse = float(sum((p.sum() for p in pulled), torch.zeros(())))
    scale = max(float(sum(p.abs().sum() for p in group)) if group else 0.0 for group in (products, pulled))
    if scale == 0:
        return DotProductResult(False, forward, reverse, float("nan"), "both derivatives are zero: nothing was tested")
    error = abs(forward - reverse) / scale
    message = f"<Jv, w> = {forward:.8g}, <v, J'w> = {reverse:.8g}: relative error {error:.3g} (allowed {rtol:.3g})"
    return DotProductResult(error <= rtol, forward, reverse, error, message)
