"""Two diagonals in place of the second derivative of a squared error: by light, and by random signs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import torch

FLOOR = 0.01  # of a tensor's typical value: entries below are divided by no less
BRIGHTER = 0.5  # the least share that light, less what is lost, has of both


class Curvature(Protocol):
    """Of the loss 1/2 c sum_p w_p^2 (I - T)^2, by what a picture I depends on.

    `lr`, `damping` and `low` are what `LeastSquares` has for it where nothing is said.
    """

    lr: ClassVar[float]
    damping: ClassVar[float]
    low: ClassVar[float]
    bounds: ClassVar[bool]  # whether the loss cannot grow by steps of 1

    def check(self, parameter: torch.Tensor) -> None:
        """ValueError for values that it is not for."""
        ...

    def adjoints(self, picture: torch.Tensor, weight: torch.Tensor, scale: float) -> list[torch.Tensor]:
        """What the picture's derivative J is multiplied by; `weight` is w, 0 where a picture may be anything."""
        ...

    def diagonal(self, parameter: torch.Tensor, *shares: torch.Tensor) -> torch.Tensor:
        """The diagonal, at least 0; `shares` are the products. ValueError if it is not for such parameters."""
        ...


@dataclass(frozen=True)
class Light:
    """A bound where pictures become brighter with parameters a: c sum_p w_p^2 J_pt I_p / a_t."""

    lr: ClassVar[float] = 1.0
    damping: ClassVar[float] = 3.0
    low: ClassVar[float] = 0.0
    bounds: ClassVar[bool] = True

    def check(self, parameter: torch.Tensor) -> None:
        """Refuse values below 0, or that are all 0."""
        least, most = (float(value) for value in parameter.detach().aminmax())
        if not (least >= 0 and most > 0):
            found = "all are 0" if least == 0 else f"got {least:g}"
            raise ValueError(f"params: expected values >= 0, and some above, {found} in {words(parameter)}")

    def adjoints(self, picture: torch.Tensor, weight: torch.Tensor, scale: float) -> list[torch.Tensor]:
        """The picture itself."""
        return [torch.where(weight != 0, weight * weight * picture.abs() * scale, picture.new_zeros(()))]

    def diagonal(self, parameter: torch.Tensor, *shares: torch.Tensor) -> torch.Tensor:
        """The product, divided by the values."""
        (share,) = shares
        received, both = float(share.sum()), float(torch.linalg.vector_norm(share, 1))
        if received < BRIGHTER * both:
            raise ValueError(
                f"params: pictures do not become brighter with {words(parameter)}; this is for colours, textures and "
                'lights, and curvature="signs" for others'
            )
        # Typical is not the mean of a sky with a sun in it. New memory costs more than the sums: one tensor for all.
        values = parameter.sqrt()
        torch.clamp(parameter, min=FLOOR * float(values.mean()) ** 2, out=values)
        return torch.div(share, values, out=values).clamp_(min=0)


@dataclass(frozen=True)
class Signs:
    """An estimate of the diagonal itself without the second derivative of pictures: c sum_p w_p^2 J_pt^2.

    With random signs s it is the mean of the square of sum_p s_p w_p J_pt. Of `probes` such sums, whose signs are
    products with the rows of a Hadamard matrix, the squares' mean is without the products of values that follow each
    other in the picture, if `probes` is a power of two: the colours of a pixel, and of its neighbour (Bekas,
    Kokiopoulou and Saad, "An estimator for the diagonal of a matrix", Applied Numerical Mathematics 57, 2007). What is
    noise in J is in it, too.
    """

    probes: int

    lr: ClassVar[float] = 0.3
    damping: ClassVar[float] = 10.0
    low: ClassVar[float] = -math.inf
    bounds: ClassVar[bool] = False

    def check(self, parameter: torch.Tensor) -> None:
        """All values will do."""

    def adjoints(self, picture: torch.Tensor, weight: torch.Tensor, scale: float) -> list[torch.Tensor]:
        """Signs of PyTorch's generator."""
        signs = torch.empty_like(picture).bernoulli_().mul_(2).sub_(1)
        signs.mul_(weight).mul_(math.sqrt(scale / self.probes))
        order = 1 << (self.probes - 1).bit_length()
        found = [signs]
        for k in range(1, self.probes):
            row = [float((-1) ** (k & j).bit_count()) for j in range(order)]
            repeated = signs.new_tensor(row).repeat(signs.numel() // order + 1)
            found.append(repeated[: signs.numel()].view(signs.shape) * signs)
        return found

    def diagonal(self, parameter: torch.Tensor, *shares: torch.Tensor) -> torch.Tensor:
        """The sum of the products' squares."""
        found = shares[0].square()
        for share in shares[1:]:
            found.addcmul_(share, share)
        return found


def curvature_of(group: Mapping[str, Any]) -> Curvature:
    """That of a group of parameters. ValueError for options that it does not have."""
    kind, probes = group["curvature"], group["probes"]
    if kind not in ("light", "signs"):
        raise ValueError(f"curvature: expected light or signs, got {kind!r}")
    if not (isinstance(probes, int) and 1 <= probes <= 64):
        raise ValueError(f"probes: expected a whole number from 1 to 64, got {probes!r}")
    return Light() if kind == "light" else Signs(probes)


def words(parameter: torch.Tensor) -> str:
    """What a message calls a parameter."""
    return f"the parameter of shape {tuple(parameter.shape)}"
