"""What ``torch.optim`` lacks for inverse rendering: uniform Adam, masked updates, and growing a parameter."""

from .adam import MaskedAdam, UniformAdam
from .resample import resample, upsample, upsample_tensor

__all__ = ["MaskedAdam", "UniformAdam", "resample", "upsample", "upsample_tensor"]
