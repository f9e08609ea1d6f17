"""Random numbers, those of the native core, and discrete distributions that are sampled with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .. import backends

# Blocks of four numbers along a path: the camera's, then one for emitters and one for the BSDF at every vertex.
CAMERA_BLOCK, EMITTER_BLOCK, BSDF_BLOCK, BLOCKS_PER_SCATTERING = 0, 1, 2, 2


@dataclass(frozen=True)
class Numbers:
    """The numbers of one pass of one sensor, whose pixels have `spp` samples: a function of pixel, sample and block."""

    sampler: str
    spp: int
    seed: int
    sensor: int
    dtype: torch.dtype

    def block(self, pixel: torch.Tensor, sample: torch.Tensor, block: int) -> torch.Tensor:
        """Four numbers in [0, 1), multiples of 2^-24, for N samples (int64) of pixels as `pixel_key` numbers them."""
        pixels, samples = pixel.numpy().astype(np.uint32), sample.numpy().astype(np.uint32)
        out = torch.empty(len(pixels), 4, dtype=torch.float64, device="cpu")
        arithmetic = str(self.dtype).removeprefix("torch.")
        addresses = (pixels.ctypes.data, samples.ctypes.data, out.data_ptr())
        settings = (self.sampler, 0, self.spp, self.seed, self.sensor, block, 4, arithmetic)
        backends.core(self.dtype).draw(*settings, len(pixels), *addresses)
        return out.to(self.dtype)


def pixel_key(rows: torch.Tensor, columns: torch.Tensor) -> torch.Tensor:
    """The number by which a pixel's random numbers are keyed; rows and columns may lie outside of the film."""
    return ((rows + 32768) << 16) | (columns + 32768)


def search(cdf: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """For a cumulative distribution (n,) and numbers (N,): index, probability of it, and what is left of the number."""
    index = torch.searchsorted(cdf, u.contiguous(), right=True).clamp(max=len(cdf) - 1)
    before = torch.where(index > 0, cdf[(index - 1).clamp(min=0)], 0.0)
    mass = cdf[index] - before
    return index, mass, (u - before) / mass.clamp(min=1e-20)


def cumulative(weights: torch.Tensor) -> torch.Tensor:
    """Cumulative distribution of weights (..., n), uniform where all are 0."""
    weights = torch.where(weights.sum(-1, keepdim=True) > 0, weights, torch.ones_like(weights))
    total = torch.cumsum(weights.double(), -1)
    cdf = (total / total[..., -1:]).clamp(max=1.0).to(weights.dtype)
    cdf[..., -1] = 1.0
    return cdf


@dataclass(frozen=True)
class Cells:
    """Cells of a grid, chosen by row, then by column; what is left of the two numbers is the place in the cell.

    `marginal` (rows,) and `conditional` (rows, columns) are cumulative.
    """

    marginal: torch.Tensor
    conditional: torch.Tensor

    def sample(self, by_row: torch.Tensor, by_column: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Row and column (N,), how far down and across in the cell, its probability."""
        row, of_row, down = search(self.marginal, by_row)
        # by bisection, since every path has its own row
        low, high = torch.zeros_like(row), torch.full_like(row, self.conditional.shape[1] - 1)
        for _ in range(self.conditional.shape[1].bit_length()):
            middle = (low + high) // 2
            right = (self.conditional[row, middle] <= by_column) & (low < high)
            low, high = torch.where(right, middle + 1, low), torch.where(right, high, middle)
        before = torch.where(low > 0, self.conditional[row, (low - 1).clamp(min=0)], 0.0)
        of_column = self.conditional[row, low] - before
        across = (by_column - before) / of_column.clamp(min=1e-20)
        return row, low, down.clamp(0.0, 1.0), across.clamp(0.0, 1.0), of_row * of_column

    def mass(self, i: torch.Tensor, j: torch.Tensor) -> torch.Tensor:
        """Probability of cells in rows i and columns j."""
        row = self.marginal[i] - torch.where(i > 0, self.marginal[(i - 1).clamp(min=0)], 0.0)
        column = self.conditional[i, j] - torch.where(j > 0, self.conditional[i, (j - 1).clamp(min=0)], 0.0)
        return row * column
