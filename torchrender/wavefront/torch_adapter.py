"""A `TorchBSDF` as the integrator sees BSDFs: what its methods return is checked."""

from __future__ import annotations

import math
from typing import Any

import torch

from ..errors import describe
from ..scene.packing import Record
from ..scene.torch_bsdf import SurfaceInteraction, TorchBSDF
from ..surface import dot
from .bsdf import Bsdf, BsdfSample, one_lobe
from .world import At, World


class TorchAdapter(Bsdf):
    """A `TorchBSDF` among the native models."""

    def __init__(self, world: World, record: Record, at: At, si: SurfaceInteraction) -> None:
        self.world, self.path, self.si, self.channels = world, record.path, si, world.channels
        self.module: TorchBSDF = world.torch_bsdfs[record.field["row"]]

    def eval(self, wi: torch.Tensor, wo: torch.Tensor, lobe: torch.Tensor) -> torch.Tensor:
        value = self._checked("eval", self.module.eval(self.si, wi, wo), (len(wi), self.channels))
        if not bool(torch.isfinite(value.detach()).all()):
            self.world.note_nonfinite(f"{self.path}: eval")
        return value

    def pdf(self, wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return self._density("pdf", self.module.pdf(self._plain(), wi.detach(), wo.detach()), len(wi))

    def sample(self, wi: torch.Tensor, u: torch.Tensor) -> BsdfSample:
        with torch.no_grad():
            found: Any = self.module.sample(self._plain(), wi.detach(), u[:, :3])
            if not isinstance(found, tuple) or len(found) != 2:
                raise TypeError(f"{self.path}: sample: expected a pair (wo, pdf) of tensors, got {describe(found)}")
            wo = self._checked("sample: wo", found[0], (len(wi), 3))
            pdf = self._density("sample: pdf", found[1], len(wi))
            off = torch.where(pdf > 0, (dot(wo, wo) - 1).abs(), 0.0)
            if bool((off > 1e-3).any()):
                length = float(torch.linalg.vector_norm(wo[off.argmax()]))
                raise ValueError(f"{self.path}: sample: wo: expected unit vectors, got one of length {length:.4g}")
            return one_lobe(wo, pdf)

    def _plain(self) -> SurfaceInteraction:
        return SurfaceInteraction(*(t.detach() for t in self.si))

    def _checked(self, what: str, found: Any, shape: tuple[int, ...]) -> torch.Tensor:
        if not isinstance(found, torch.Tensor):
            raise TypeError(f"{self.path}: {what}: expected a tensor of shape {shape}, got {describe(found)}")
        if tuple(found.shape) != shape or not found.is_floating_point():
            raise ValueError(
                f"{self.path}: {what}: expected floating-point numbers of shape {shape}, got {describe(found)}"
            )
        return found.to(self.world.dtype)

    def _density(self, what: str, found: Any, n: int) -> torch.Tensor:
        pdf = self._checked(what, found, (n,))
        if not bool(torch.isfinite(pdf).all()):
            self.world.note_nonfinite(f"{self.path}: {what}")
            return torch.where(torch.isfinite(pdf), pdf, math.nan)
        if bool((pdf < 0).any()):
            raise ValueError(
                f"{self.path}: {what}: expected densities that are not negative, got {float(pdf.min()):.4g}"
            )
        return pdf
