"""Maps that keep a parameter in its range, for ``torch.nn.utils.parametrize``.

    from torch.nn.utils import parametrize
    texture = scene.get_submodule("wall.bsdf.reflectance")
    parametrize.register_parametrization(texture, "data", tr.constraints.UnitInterval())

The optimiser then moves an unbounded number, and what the renderer sees is in range: clamping, in contrast, stops the
gradient at the border and leaves Adam's momentum pushing against it.
"""

from __future__ import annotations

import math

import torch
from torch import nn

from .errors import describe


class ScaledSigmoid(nn.Module):
    """``lo + (hi - lo) / (1 + exp(-x))``: values between `lo` and `hi`.

    Args:
        lo, hi: the bounds, finite, ``lo < hi``.
        margin: a value within this fraction of the range from a bound is moved that far inside when it is set, since
            a bound itself would need an infinite x, and values next to it have hardly any gradient.

    Raises:
        ValueError: if the bounds or the margin make no sense.
    """

    def __init__(self, lo: float, hi: float, margin: float = 1e-3) -> None:
        super().__init__()
        self.lo, self.hi, self.margin = float(lo), float(hi), float(margin)
        if not (math.isfinite(self.lo) and math.isfinite(self.hi) and self.lo < self.hi):
            raise ValueError(f"lo, hi: expected two finite numbers, the first one smaller, got {lo!r}, {hi!r}")
        if not 0 < self.margin < 0.5:
            raise ValueError(f"margin: expected a number between 0 and 0.5, got {margin!r}")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map any number into the range."""
        return self.lo + (self.hi - self.lo) * torch.sigmoid(x)

    def right_inverse(self, value: torch.Tensor) -> torch.Tensor:
        """The x that gives `value`.

        Raises:
            ValueError: if an entry is outside of [lo, hi] or not finite.
        """
        _check_range(value, self.lo, self.hi, repr(self))
        fraction = (value - self.lo) / (self.hi - self.lo)
        return torch.logit(fraction.clamp(self.margin, 1 - self.margin))

    def extra_repr(self) -> str:
        return f"lo={self.lo:g}, hi={self.hi:g}"


class UnitInterval(ScaledSigmoid):
    """Values between 0 and 1, such as albedos: `ScaledSigmoid` (0, 1)."""

    def __init__(self, margin: float = 1e-3) -> None:
        super().__init__(0.0, 1.0, margin)


class Positive(nn.Module):
    """``floor + log(1 + exp(x))``: values above `floor`, such as radiances, densities and scales.

    Far above the floor it is the identity, so learning rates keep their meaning there.

    Args:
        floor: finite lower bound.
        margin: values closer than this to the floor are set to this distance, since the floor itself would need an
            infinite x.

    Raises:
        ValueError: if an argument makes no sense.
    """

    def __init__(self, floor: float = 0.0, margin: float = 1e-4) -> None:
        super().__init__()
        self.floor, self.margin = float(floor), float(margin)
        if not math.isfinite(self.floor):
            raise ValueError(f"floor: expected a finite number, got {floor!r}")
        if not 0 < self.margin < math.inf:
            raise ValueError(f"margin: expected a positive number, got {margin!r}")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map any number above the floor."""
        return self.floor + nn.functional.softplus(x)

    def right_inverse(self, value: torch.Tensor) -> torch.Tensor:
        """The x that gives `value`.

        Raises:
            ValueError: if an entry is below the floor or not finite.
        """
        _check_range(value, self.floor, math.inf, repr(self))
        above = (value - self.floor).clamp(min=self.margin)
        # log(exp(y) - 1), written so that neither small nor large y loses digits.
        return above + torch.log(-torch.expm1(-above))

    def extra_repr(self) -> str:
        return f"floor={self.floor:g}"


def _check_range(value: torch.Tensor, lo: float, hi: float, name: str) -> None:
    if not isinstance(value, torch.Tensor) or not value.is_floating_point():
        raise TypeError(f"{name}: expected a floating-point tensor, got {describe(value)}")
    detached = value.detach()
    wrong = ~((detached >= lo) & (detached <= hi) & torch.isfinite(detached))
    if bool(wrong.any()):
        count, example = int(wrong.sum()), float(detached[wrong].flatten()[0])
        raise ValueError(f"{name}: expected values in [{lo:g}, {hi:g}], got {example:g} ({count} of {wrong.numel()})")
