"""What people may write for numbers, colours, matrices, objects of a scene and scenes: names for type hints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

import numpy as np
import torch
from torch import nn

from .transform import Transform

if TYPE_CHECKING:
    from typing_extensions import TypedDict


class SupportsArray(Protocol):
    """What ``numpy.asarray`` takes: arrays of NumPy and of others."""

    def __array__(self, *args: Any, **kwargs: Any) -> Any: ...


Number: TypeAlias = float | np.number | torch.Tensor
"""A number; a tensor has shape ()."""
Vector: TypeAlias = torch.Tensor | SupportsArray | Sequence[Number]
"""Three numbers."""
Rows: TypeAlias = Sequence[Sequence[Number]]
"""Nested lists of two levels."""
Array: TypeAlias = Vector | Rows | Sequence[Rows] | Sequence[Sequence[Rows]]
"""A tensor, a NumPy array or nested lists."""
Color: TypeAlias = Number | Vector | Mapping[str, Any]
"""A number for all channels, three numbers, or a dict such as ``{"type": "rgb", "value": [1, 0, 0]}``."""
Matrix: TypeAlias = Transform | torch.Tensor | SupportsArray | Rows
"""A `Transform` or any 4x4 (3x3) array-like."""
ObjectLike: TypeAlias = nn.Module | Mapping[str, Any]
"""A built object, or the dict that describes one; ``{"type": "ref", "id": "..."}`` refers to another."""
TextureLike: TypeAlias = Color | Array | ObjectLike
"""A colour, a texture object or dict, or texels (H, W, C)."""
VolumeLike: TypeAlias = Color | Array | ObjectLike
"""A number or colour, a volume object or dict, or voxels (Z, Y, X) or (Z, Y, X, C)."""
VariantName: TypeAlias = Literal["mono", "mono_polarized", "rgb", "rgb_polarized", "spectral", "spectral_polarized"]
"""Colour modes."""
Unsupported: TypeAlias = Literal["error", "substitute"]
"""What becomes of what this version does not have."""

if TYPE_CHECKING:

    class SceneDict(TypedDict, extra_items=Any):
        """The dict of a scene, for `tr.load_dict`: objects and their dicts by id."""

        type: Literal["scene"]

else:
    SceneDict = Mapping[str, Any]
