"""Two variants of Adam (Kingma & Ba 2015) for textures, volumes and vertex positions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch


class _Adam(torch.optim.Optimizer):
    """Adam with an optional uniform step size and optional masking; the public classes below choose."""

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float,
        betas: tuple[float, float],
        eps: float,
        uniform: bool,
        mask_updates: bool,
    ) -> None:
        defaults = {"lr": lr, "betas": betas, "eps": eps, "uniform": uniform, "mask_updates": mask_updates}
        super().__init__(params, defaults)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add parameters with options of their own, checked here."""
        options = {**self.defaults, **{k: v for k, v in param_group.items() if k != "params"}}
        if not float(options["lr"]) >= 0:
            raise ValueError(f"lr: expected a number >= 0, got {options['lr']!r}")
        betas = options["betas"]
        if len(betas) != 2 or not all(0 <= float(beta) < 1 for beta in betas):
            raise ValueError(f"betas: expected two numbers in [0, 1), got {betas!r}")
        if not float(options["eps"]) >= 0:
            raise ValueError(f"eps: expected a number >= 0, got {options['eps']!r}")
        super().add_param_group(param_group)

    @torch.no_grad()
    def step(self, closure: Callable[[], torch.Tensor] | None = None) -> torch.Tensor | None:
        """One step along the gradients; `closure`, if given, recomputes and returns the loss first.

        Raises:
            RuntimeError: for sparse or complex gradients.
        """
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._update(parameter, parameter.grad, group)
        return loss

    def _update(self, parameter: torch.Tensor, gradient: torch.Tensor, group: dict[str, Any]) -> None:
        if gradient.is_sparse or gradient.is_complex():
            raise RuntimeError(f"{type(self).__name__} takes dense, real gradients only")
        state = self.state[parameter]
        masked = group["mask_updates"]
        if not state:
            # With masked updates every entry counts its own steps: its moments are as old as its visits, and the
            # bias correction has to match or a texel first seen late would make a step several times too long.
            count = torch.zeros_like(parameter) if masked else torch.zeros((), dtype=torch.float32)
            state["step"] = count
            state["exp_avg"] = torch.zeros_like(parameter)
            state["exp_avg_sq"] = torch.zeros_like(parameter)
        beta1, beta2 = group["betas"]
        first, second, step = state["exp_avg"], state["exp_avg_sq"], state["step"]
        if masked:
            seen = gradient != 0
            step.add_(seen)
            first.copy_(torch.where(seen, first.lerp(gradient, 1 - beta1), first))
            second.copy_(torch.where(seen, second.lerp(gradient * gradient, 1 - beta2), second))
            age = step.clamp(min=1)
            corrected = first / (1 - beta1**age)
            spread = (second / (1 - beta2**age)).sqrt()
        else:
            step += 1
            first.lerp_(gradient, 1 - beta1)
            second.lerp_(gradient * gradient, 1 - beta2)
            corrected = first / (1 - beta1 ** step.item())
            spread = (second / (1 - beta2 ** step.item())).sqrt()
        if group["uniform"]:
            spread = spread.max()
        change = corrected / (spread + group["eps"])
        if masked:
            change = torch.where(gradient != 0, change, torch.zeros_like(change))
        parameter.sub_(change * group["lr"])


class UniformAdam(_Adam):
    """Adam with one step size per tensor: the largest second moment of its entries divides all of them.

    Plain Adam scales every entry by its own gradient history, which turns a smooth gradient into a noisy step. Here the
    step is parallel to the smoothed gradient, as vertex positions and preconditioned grids need it (Nicolet, Jacobson
    and Jakob, "Large Steps in Inverse Rendering of Geometry", 2021): ``p -= lr * m / (max(sqrt(v)) + eps)`` with the
    usual bias-corrected moments m and v.

    Args:
        params: tensors or parameter groups.
        lr: the largest change of an entry in one step, about.
        betas: decay of the first and second moment.
        eps: added to the denominator.
        mask_updates: leave entries whose gradient is exactly zero, and their state, as they are (see `MaskedAdam`).

    Raises:
        ValueError: for options out of range.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
        mask_updates: bool = False,
    ) -> None:
        super().__init__(params, lr, betas, eps, True, mask_updates)


class MaskedAdam(_Adam):
    """Adam that touches only entries whose gradient is not exactly zero.

    A texel that no path has met in this step has a gradient of zero, which says nothing. Plain Adam would move it on
    by its old momentum and let its second moment decay, so that the next visit makes too long a step. Here the value,
    the moments and the age of such an entry stay as they are; every entry has its own bias correction.

    Args:
        params: tensors or parameter groups.
        lr: learning rate.
        betas: decay of the first and second moment.
        eps: added to the denominator.

    Raises:
        ValueError: for options out of range.
    """

    def __init__(
        self,
        params: Iterable[torch.Tensor] | Iterable[dict[str, Any]],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__(params, lr, betas, eps, False, True)
