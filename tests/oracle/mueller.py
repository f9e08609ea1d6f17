"""Mueller matrices as textbooks have them, of complex amplitudes of two polarisations (Jones matrices).

Light that travels along k has the field Re (x, y) exp(i omega t) along an axis and k x axis, and the Stokes vector
I = |x|^2 + |y|^2, Q = |x|^2 - |y|^2, U = 2 Re x y*, V = -2 Im x y*, to the right circular as its receiver sees it. An
index of refraction is eta - i k. At an interface the axis is that of s polarisation. Directions count, not their
lengths: no length has a derivative.
"""

from __future__ import annotations

import torch

from torchrender.surface import dot, normalize
from torchrender.wavefront.geometry import Frame

# (I, Q, U, V) of the products x x*, x y*, y x*, y y*
COHERENCY = torch.tensor([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, 1j, -1j, 0]], dtype=torch.complex128)
DEPOLARISER = torch.diag(torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64))


def implicit_axis(k: torch.Tensor) -> torch.Tensor:
    """Where no other is known, the axis of light that travels along k (N, 3): a function of k alone."""
    return Frame.about(normalize(k)).s


def across(k: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """The part of axes (N, 3) that is perpendicular to k, of unit length; where there is none, the implicit axis."""
    k = normalize(k)
    part = axis - k * dot(k, axis)[:, None]
    usable = (dot(part, part) > 1e-24).detach()[:, None]
    return torch.where(usable, normalize(torch.where(usable, part, 1.0)), implicit_axis(k))


def rotation(k: torch.Tensor, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """Of Stokes vectors of light along k, all (N, 3), from one axis to another: (N, 1, 4, 4)."""
    angle = 2 * torch.atan2(dot(normalize(k), torch.linalg.cross(before, after)), dot(before, after))
    c, s, zero, one = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle), torch.ones_like(angle)
    rows = [[one, zero, zero, zero], [zero, c, s, zero], [zero, -s, c, zero], [zero, zero, zero, one]]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)[:, None]


def mueller(jones: torch.Tensor) -> torch.Tensor:
    """The Mueller matrices (..., 4, 4) of Jones matrices (..., 2, 2)."""
    products = torch.einsum("...ij,...kl->...ikjl", jones, jones.conj()).flatten(-4, -3).flatten(-2, -1)
    return (COHERENCY @ products @ torch.linalg.inv(COHERENCY)).real


def amplitudes(s: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
    """The Mueller matrices of complex amplitudes (...) of fields along the axis and across it."""
    return mueller(torch.diag_embed(torch.stack(torch.broadcast_tensors(s, p), -1).to(torch.complex128)))


def refracted(c: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
    """m times the cosine behind an interface whose complex index, relative to that before it, is m."""
    q = torch.sqrt(m * m - (1 - c * c) + 0j)
    return torch.where(q.imag > 0, -q, q)  # the wave fades behind the interface


def reflection(c: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
    """Of the cosines c (N, 1): Fresnel's equations with Verdet's signs."""
    q = refracted(c, m)
    return amplitudes((c - q) / (c + q), (m * m * c - q) / (m * m * c + q))


def refraction(c: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
    """The same of what passes, as power: nothing where all is reflected."""
    q = refracted(c, m)
    matrix = amplitudes(2 * c / (c + q), 2 * m * c / (m * m * c + q))
    return matrix * (q.real / c)[..., None, None]


def pane(c: torch.Tensor, m: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What a pane reflects and lets pass: its inner reflections in all, without interference."""
    inner_cosine = torch.where(refracted(c, m).real > 0, refracted(c, m).real / m, 1.0)
    outside, inside = reflection(c, m), reflection(inner_cosine, 1 / m)
    into, out = refraction(c, m), refraction(inner_cosine, 1 / m)
    twice = torch.linalg.inv(torch.eye(4, dtype=c.dtype) - inside @ inside)
    return outside + out @ inside @ twice @ into, out @ twice @ into
