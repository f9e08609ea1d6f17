"""Pictures for people: the sRGB curve, a filmic one, tone mapping and display."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import torch

if TYPE_CHECKING:
    from PIL.Image import Image


TonemapName: TypeAlias = Literal["srgb", "filmic"]
"""How linear radiance becomes what is displayed: see `tonemap`."""
TONEMAPS = ("srgb", "filmic")
Images: TypeAlias = "torch.Tensor | np.ndarray | Sequence[torch.Tensor | np.ndarray]"
"""One image, a batch, or several images: see `show`."""


def linear_to_srgb(linear: torch.Tensor) -> torch.Tensor:
    """Encode linear values with the sRGB curve (IEC 61966-2-1), entry by entry.

    Args:
        linear: tensor of any shape. Values above 1 follow the curve on; negative values stay on its linear part.

    Returns:
        Tensor of the same shape, differentiable everywhere (also at 0 and below).
    """
    # The power is only evaluated where it is used: its derivative at 0 is infinite and would turn 0 * inf into NaN.
    safe = linear.clamp(min=0.0031308)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * safe ** (1 / 2.4) - 0.055)


def srgb_to_linear(encoded: torch.Tensor) -> torch.Tensor:
    """Decode sRGB values in [0, 1] to linear ones, entry by entry; the inverse of :func:`linear_to_srgb`."""
    safe = encoded.clamp(min=0.04045)
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((safe + 0.055) / 1.055) ** 2.4)


def decode_levels(stored: np.ndarray, raw: bool) -> torch.Tensor:
    """Integers of 8 or 16 bits, as image files store them, of any shape: linear values, or with `raw` fractions of 1.

    By a table of all levels: every level is one value everywhere (PyTorch's `pow` rounds differently at the ends of
    tensors), and what the curve would take besides is several times the picture.
    """
    most = 65535 if stored.dtype.itemsize == 2 else 255
    levels = torch.arange(most + 1, dtype=torch.float32) / most
    table = levels if raw else srgb_to_linear(levels)
    return table.index_select(0, torch.from_numpy(stored.astype(np.int32).reshape(-1))).view(stored.shape)


# Hable, "Uncharted 2: HDR Lighting", GDC 2010, and "Filmic Tonemapping Operators", filmicworlds.com, 2010: strengths
# and angles of shoulder, linear part and toe, his exposure bias and the value that becomes white.
_A, _B, _C, _D, _E, _F = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30
_BIAS, _WHITE = 2.0, 11.2
_STEEP = (_C * _B * _D * _F - _D * _E * _B) / (_D * _F) ** 2  # the curve's derivative at 0
_ENOUGH = 1e6  # from here on the curve is its limit to single precision, and squares are far from overflow


def _hable(x: Any) -> Any:
    return (x * (_A * x + _C * _B) + _D * _E) / (x * (_A * x + _B) + _D * _F) - _E / _F


def filmic(linear: torch.Tensor) -> torch.Tensor:
    """Compress linear values as film does, entry by entry: Hable's curve of 2010, with his constants.

    It is 0 at 0 and 1 at 5.6, his white, with a soft shoulder before it and a toe that darkens shadows. The result is
    linear, too: the sRGB curve follows for a display.

    Args:
        linear: tensor of any shape. Values above 5.6 end at 1.287; negative values stay on the tangent at 0.

    Returns:
        Tensor of the same shape, differentiable everywhere (also at 0 and below).
    """
    x = linear * _BIAS
    return torch.where(x > 0, _hable(x.clamp(0, _ENOUGH)), x * _STEEP) / _hable(_WHITE)


def check_tonemap(where: str, name: Any) -> None:
    """ValueError unless `name` is one of TONEMAPS."""
    if name not in TONEMAPS:
        raise ValueError(f"{where}: expected 'srgb' or 'filmic', got {name!r}")


def encode(linear: torch.Tensor, curve: TonemapName) -> torch.Tensor:
    """Display values for linear colours, entry by entry, not clipped."""
    return linear_to_srgb(filmic(linear) if curve == "filmic" else linear)


def tonemap(
    image: torch.Tensor,
    exposure: float | torch.Tensor = 0.0,
    *,
    curve: TonemapName = "srgb",
    clip: bool = True,
) -> torch.Tensor:
    """Turn linear radiance into display values: exposure, a curve, and clipping to [0, 1].

    Args:
        image: linear radiance, channels last. With four channels the last one is alpha, which is only clipped.
        exposure: in stops (powers of two); a float, or a scalar tensor, which may require a gradient.
        curve: ``"srgb"``, the sRGB curve alone, which clips what is brighter than 1, or ``"filmic"``: Hable's filmic
            curve (GDC 2010) before it, which keeps highlights up to 5.6 apart and is darker below.
        clip: clip to [0, 1]. Clipped entries have no gradient; with ``clip=False`` every entry has one.

    Returns:
        Tensor of the image's shape and dtype, differentiable in ``image`` and ``exposure``.

    Raises:
        TypeError: if the image is not a floating-point tensor.
        ValueError: if there is no such curve.
    """
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        raise TypeError(f"image: expected a floating-point tensor, got {_named(image)}")
    check_tonemap("curve", curve)
    gain = torch.exp2(torch.as_tensor(exposure, dtype=image.dtype, device=image.device))
    if image.dim() >= 3 and image.shape[-1] == 4:
        out = torch.cat([encode(image[..., :3] * gain, curve), image[..., 3:]], dim=-1)
    else:
        out = encode(image * gain, curve)
    return out.clamp(0.0, 1.0) if clip else out


_FALSE = ((0, 0, 0), (0.16, 0.04, 0.4), (0.55, 0.1, 0.5), (0.9, 0.3, 0.25), (1, 0.7, 0.15), (1, 1, 0.9))


def false_colors(values: torch.Tensor) -> torch.Tensor:
    """Display values (..., 3) for numbers (...) from 0, black, over violet, red and yellow to 1, nearly white."""
    anchors = values.new_tensor(_FALSE)
    place = torch.nan_to_num(values, nan=0.0).clamp(0, 1) * (len(anchors) - 1)
    below = place.long().clamp(max=len(anchors) - 2)
    return torch.lerp(anchors[below], anchors[below + 1], (place - below)[..., None])


def to_bytes(image: torch.Tensor) -> torch.Tensor:
    """Round display values in [0, 1] to ``uint8``; what is not a number becomes 0."""
    return (torch.nan_to_num(image.detach(), nan=0.0).clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu()


def show(image: Images, exposure: float = 0.0, *, tonemap: TonemapName = "srgb") -> Image | None:
    """Show linear images, several of them side by side.

    Args:
        image: linear radiance of shape (H, W, C) or (H, W), C in 1, 3, 4, a tensor or an array of NumPy; a sequence of
            them of one height; or a batch, (B, H, W, C) or (B, C, H, W). Channels may come first in single images, too.
        exposure: in stops.
        tonemap: ``"srgb"`` or ``"filmic"``, the `curve` of `tr.tonemap`.

    Returns:
        In a notebook the picture is displayed below the cell and ``None`` is returned; elsewhere a ``PIL.Image``,
        which has ``save`` and ``show``.

    Raises:
        TypeError, ValueError: if an image has another shape or dtype.
    """
    from PIL import Image as PILImage

    picture = PILImage.fromarray(side_by_side(image, exposure, tonemap).numpy())
    if in_notebook():
        importlib.import_module("IPython.display").display(picture)  # a notebook has it, other environments may not
        return None
    return picture


def log_images(
    writer: Any,
    tag: str,
    images: Images,
    step: int | None = None,
    *,
    exposure: float = 0.0,
    tonemap: TonemapName = "srgb",
) -> None:
    """Log linear images, tone mapped and side by side, as one picture in TensorBoard.

    Args:
        writer: a `torch.utils.tensorboard.SummaryWriter`, or anything else with ``add_image(tag, tensor, step)``, which
            is given bytes (3, H, W), or (4, H, W) with alpha.
        tag: the picture's name.
        images: as of `show`: (H, W, C) or (H, W), a sequence of them of one height, or a batch.
        step: the iteration.
        exposure: in stops.
        tonemap: ``"srgb"`` or ``"filmic"``, the `curve` of `tr.tonemap`.

    Raises:
        TypeError, ValueError: if the writer cannot take images, or an image has another shape or dtype.
    """
    add = getattr(writer, "add_image", None)
    if not callable(add):
        raise TypeError(
            "writer: expected a torch.utils.tensorboard.SummaryWriter, or something else with add_image, got "
            f"{_named(writer)}"
        )
    add(tag, side_by_side(images, exposure, tonemap, "images").movedim(-1, 0).contiguous(), step)


def side_by_side(image: Images, exposure: float, curve: TonemapName, where: str = "image") -> torch.Tensor:
    """Pictures as `show` takes them, tone mapped, as one: uint8 (H, W, C), C = 3 or 4. Errors begin with `where`."""
    check_tonemap("tonemap", curve)
    if isinstance(image, np.ndarray):
        image = torch.from_numpy(image)
    if not isinstance(image, Iterable) or isinstance(image, str):
        raise TypeError(f"{where}: expected an image (H, W, C) or (H, W), or a sequence of images, got {_named(image)}")
    single = isinstance(image, torch.Tensor) and image.dim() != 4
    images = [image] if single else list(image)
    if not images:
        raise ValueError(f"{where}: expected an image or a non-empty sequence of images, got an empty sequence")
    tiles = []
    for tile in images:
        tile = torch.from_numpy(tile) if isinstance(tile, np.ndarray) else tile
        if not isinstance(tile, torch.Tensor) or tile.dim() not in (2, 3):
            raise TypeError(f"{where}: expected tensors of shape (H, W, C) or (H, W), got {_named(tile)}")
        if tile.dtype == torch.uint8:
            raise TypeError(f"{where}: expected linear radiance, got bytes, {_named(tile)}; they are a picture already")
        tile = tile.unsqueeze(-1) if tile.dim() == 2 else tile
        if tile.shape[-1] not in (1, 3, 4) and tile.shape[0] in (1, 3, 4):
            tile = tile.movedim(0, -1)
        if tile.shape[-1] not in (1, 3, 4):
            raise ValueError(f"{where}: expected 1, 3 or 4 channels, got shape {tuple(tile.shape)}")
        tile = to_bytes(tonemap(tile.detach().float(), exposure, curve=curve))
        tiles.append(tile.expand(*tile.shape[:2], 3) if tile.shape[-1] == 1 else tile)
    if any(tile.shape[-1] == 4 for tile in tiles):
        tiles = [_with_alpha(tile) for tile in tiles]
    if len({tile.shape[0] for tile in tiles}) > 1:
        raise ValueError(f"{where}: expected images of one height, got heights {[tile.shape[0] for tile in tiles]}")
    return torch.cat(tiles, dim=1).contiguous()


def in_notebook() -> bool:
    """Whether the code runs in a Jupyter kernel."""
    if "IPython" not in sys.modules:
        return False
    shell = sys.modules["IPython"].get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


def _with_alpha(tile: torch.Tensor) -> torch.Tensor:
    if tile.shape[-1] == 4:
        return tile
    return torch.cat([tile, torch.full_like(tile[..., :1], 255)], dim=-1)


def _named(value: object) -> str:
    if isinstance(value, torch.Tensor):
        return f"a tensor of dtype {value.dtype} and shape {tuple(value.shape)}"
    return type(value).__name__
