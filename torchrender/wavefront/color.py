"""Luminance, with the digits that csrc/core/color/spectrum.h has."""

from __future__ import annotations

import torch

LUMINANCE = (0.2126, 0.7152, 0.0722)


def luminance(color: torch.Tensor) -> torch.Tensor:
    """Of colours (..., C), C = 1 or 3: (...)."""
    return color[..., 0] if color.shape[-1] == 1 else (color * color.new_tensor(LUMINANCE)).sum(-1)
