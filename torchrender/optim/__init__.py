"""What ``torch.optim`` lacks for inverse rendering: uniform Adam, masked updates, large steps, growing a parameter."""

from .adam import MaskedAdam, UniformAdam
from .resample import resample, upsample, upsample_tensor
from .smoothing import GridSmoothing, MeshSmoothing

__all__ = [
    "GridSmoothing",
    "MaskedAdam",
    "MeshSmoothing",
    "UniformAdam",
    "resample",
    "upsample",
    "upsample_tensor",
]
