"""Version counters of tensors, by which this package sees that a parameter was edited in place."""

from __future__ import annotations

from typing import Any

import torch
from torch.optim import Optimizer
from torch.optim.optimizer import register_optimizer_step_post_hook


def count_fused_steps() -> None:
    """Make the steps of torch's fused optimisers count as edits.

    ``torch.optim.Adam(..., fused=True)`` writes into parameters without advancing their version counters, so that
    neither autograd nor this package would notice that a mesh has moved.
    """
    if hasattr(torch.autograd.graph, "increment_version"):  # older versions have no fused optimisers on the CPU
        register_optimizer_step_post_hook(_after_step)


def _after_step(optimizer: Optimizer, _args: Any, _kwargs: Any) -> None:
    for group in optimizer.param_groups:
        if group.get("fused"):
            for parameter in group["params"]:
                if parameter.grad is not None and not parameter.is_inference():
                    torch.autograd.graph.increment_version(parameter)
