"""The luminance of colours."""

from __future__ import annotations

import torch

from ..scene.context import LUMINANCE


def luminance(color: torch.Tensor) -> torch.Tensor:
    """Of colours (..., C), C = 1 or 3: (...)."""
    return color[..., 0] if color.shape[-1] == 1 else (color * color.new_tensor(LUMINANCE)).sum(-1)
