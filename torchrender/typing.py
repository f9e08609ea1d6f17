"""What people may write for numbers, colours, matrices and objects of a scene: names for type hints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import torch
from torch import nn

from .transform import Transform

Number: TypeAlias = float | torch.Tensor
"""A number; a tensor has shape ()."""
Array: TypeAlias = torch.Tensor | Sequence[Any] | Any
"""A tensor, a NumPy array or nested lists."""
Vector: TypeAlias = torch.Tensor | Sequence[Number] | Any
"""Three numbers."""
Color: TypeAlias = float | Sequence[Number] | torch.Tensor | Mapping[str, Any]
"""A number for all channels, three numbers, or a dict such as ``{"type": "rgb", "value": [1, 0, 0]}``."""
Matrix: TypeAlias = Transform | torch.Tensor | Sequence[Any] | Any
"""A `Transform` or any 4x4 (3x3) array-like."""
ObjectLike: TypeAlias = nn.Module | Mapping[str, Any] | Any
"""A built object, or the dict that describes one; ``{"type": "ref", "id": "..."}`` refers to another."""
TextureLike: TypeAlias = Color | ObjectLike
"""A colour, a texture object or dict, or texels (H, W, C)."""
VolumeLike: TypeAlias = Color | ObjectLike
"""A number or colour, a volume object or dict, or voxels (Z, Y, X) or (Z, Y, X, C)."""
