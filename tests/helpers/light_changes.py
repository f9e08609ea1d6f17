"""Changes of scenes that light paths are traced through, and weights of their images."""

from __future__ import annotations

import light_scenes as ls
import torch

import torchrender as tr


def weight(image: torch.Tensor) -> torch.Tensor:
    """A smooth weight of an image (H, W, C)."""
    h, w, c = image.shape
    y, x, k = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (h, w, c)), indexing="ij")
    return (1 + 0.5 * torch.sin(0.9 * y + 1.3 * x + k)).to(image)


def direction(name: str, value: torch.Tensor) -> torch.Tensor:
    """A change of a parameter: matrices are turned, moved and stretched a little, waves go through the sheet."""
    generator = torch.Generator().manual_seed(5)
    change = torch.randn(value.shape, generator=generator, dtype=torch.float64)
    if name == "sheet.vertex_positions" and len(value) == 24 * 24:
        return ls.wave()
    if value.ndim == 2 and value.shape[0] == value.shape[1]:
        change[-1] = 0
        # floors, walls and lamps are large: what turns them a little moves their ends far
        return 0.3 * change
    return change


def triangle(bsdf: dict, low: bool = False) -> tr.Mesh:
    """One large triangle with normals of its own, over the floor or instead of it."""
    y = torch.tensor([-0.9, -0.8, -1.0] if low else [0.3, 0.4, 0.2], dtype=torch.float64)
    x, z = torch.tensor([-6.0, 6, 0]).double(), torch.tensor([-6.0, -6, 9]).double()
    normals = torch.tensor([[0.3, 1, 0.1], [-0.2, 1, 0.2], [0.1, 1, -0.3]], dtype=torch.float64)
    normals = torch.nn.functional.normalize(normals, dim=1)
    return tr.Mesh(torch.stack([x, y, z], 1), torch.tensor([[0, 2, 1]]), vertex_normals=normals, bsdf=bsdf)
