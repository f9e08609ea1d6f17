"""What ``torch.optim`` lacks for inverse rendering: least squares, uniform Adam, large steps, growth, noise."""

from .adam import MaskedAdam, UniformAdam
from .least_squares import LeastSquares
from .noise import NoiseStop
from .rate import find_rate
from .resample import resample, upsample, upsample_tensor
from .smoothing import GridSmoothing, MeshSmoothing

__all__ = [
    "GridSmoothing",
    "LeastSquares",
    "MaskedAdam",
    "MeshSmoothing",
    "NoiseStop",
    "UniformAdam",
    "find_rate",
    "resample",
    "upsample",
    "upsample_tensor",
]
