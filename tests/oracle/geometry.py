"""Vectors, frames, and values with the derivative of something else."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch

from torchrender.surface import dot, normalize

__all__ = ["Frame", "Rows", "dot", "normalize", "reattach", "root"]


class Rows:
    """Base of dataclasses whose members all have N rows."""

    def __getitem__(self, rows: torch.Tensor) -> Rows:
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    @classmethod
    def cat(cls, pieces: list) -> Rows:
        return cls(*(torch.cat([getattr(p, f.name) for p in pieces]) for f in fields(cls)))


def reattach(value: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
    """The numbers of the one with the derivative of the other."""
    return value.detach() + (derivative - derivative.detach())


def root(x: torch.Tensor) -> torch.Tensor:
    """Square root of what should not be negative, whose derivative at zero is taken as zero."""
    positive = x > 0
    return torch.where(positive, torch.sqrt(torch.where(positive, x, 1.0)), 0.0)


@dataclass
class Frame(Rows):
    """Orthonormal vectors (N, 3) around a normal, as csrc/core/math/vector.h chooses them."""

    s: torch.Tensor
    t: torch.Tensor
    n: torch.Tensor

    @classmethod
    def about(cls, n: torch.Tensor) -> Frame:
        x, y, z = n.unbind(1)
        sign = torch.where(z < 0, -1.0, 1.0).to(n)
        a = -1 / (sign + z)
        b = x * y * a
        s = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], 1)
        return cls(s, torch.stack([b, sign + y * y * a, -y], 1), n)

    @classmethod
    def along(cls, n: torch.Tensor, tangent: torch.Tensor) -> Frame:
        """Turned about the normals until s is in the direction of the tangents, csrc/core/shape/tangents.h."""
        s = normalize(tangent - n * dot(n, tangent)[:, None])
        return cls(s, torch.linalg.cross(n, s), n)

    def to_local(self, v: torch.Tensor) -> torch.Tensor:
        return torch.stack([dot(v, self.s), dot(v, self.t), dot(v, self.n)], 1)

    def to_world(self, v: torch.Tensor) -> torch.Tensor:
        return self.s * v[:, :1] + self.t * v[:, 1:2] + self.n * v[:, 2:]
