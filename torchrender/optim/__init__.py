"""What ``torch.optim`` lacks for inverse rendering: uniform Adam, large steps, growing a parameter, noise."""

from .adam import MaskedAdam, UniformAdam
from .noise import NoiseStop
from .rate import find_rate
from .resample import resample, upsample, upsample_tensor
from .smoothing import GridSmoothing, MeshSmoothing

__all__ = [
    "GridSmoothing",
    "MaskedAdam",
    "MeshSmoothing",
    "NoiseStop",
    "UniformAdam",
    "find_rate",
    "resample",
    "upsample",
    "upsample_tensor",
]
