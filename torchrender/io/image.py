"""``read_image`` and ``write_image``: linear float tensors from and to picture files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from ..errors import describe
from ..image import TonemapName, check_tonemap, decode_levels, encode
from ..polarization import channel_names
from . import exr, hdr, pfm, png16
from ._files import check_size, existing_file, reading, writable_file

# Bytes of pixels for a byte of a PNG or JPEG file: deflate ends at 1032, an empty progressive JPEG somewhat higher.
_LARGEST_RATIO = 4096
_LAYER_SUFFIXES = {1: ("",), 2: (".X", ".Y"), 3: (".R", ".G", ".B"), 4: (".R", ".G", ".B", ".A")}
_DEFAULT_NAMES = {1: ("Y",), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}


def read_image(
    path: str | os.PathLike[str], *, raw: bool = False, channels: Sequence[str] | None = None, part: str | None = None
) -> torch.Tensor:
    """Read a picture as linear values. The content, not the ending, says which format it is.

    Args:
        path: an EXR, Radiance HDR, PFM, PNG (8 or 16 bit) or JPEG file.
        raw: do not decode the sRGB curve of PNG and JPEG files: for normals, roughness and other data. Their values
            are then the stored integers over 255 or 65535. The floating-point formats are linear anyway.
        channels: names of the channels of an EXR file, such as ``("depth.Z",)``; by default R, G, B and, where there
            is one, A; or the luminance Y.
        part: name of the part of an EXR file that has several; by default the first.

    Returns:
        float32 tensor (H, W, C), top row first, C = 1, 3 or 4 (EXR with ``channels``: their number). Alpha is never
        decoded. Grey with alpha becomes four channels.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is of an unknown kind, truncated or damaged, or lacks a channel.
    """
    path = existing_file(path)
    with reading(path):
        return _read_image(path, raw, channels, part)


def _read_image(path: Path, raw: bool, channels: Sequence[str] | None, part: str | None) -> torch.Tensor:
    with path.open("rb") as file:
        head = file.read(32)
    if head.startswith(exr.MAGIC):
        stored = exr.read_exr(path, part)
        names = exr.colour_channels(path, list(stored)) if channels is None else list(channels)
        missing = [name for name in names if name not in stored]
        if missing or not names:
            raise ValueError(f"{path}: channels: expected names among {sorted(stored)}, got {names}")
        return torch.from_numpy(np.stack([stored[name] for name in names], axis=-1))
    if channels is not None or part is not None:
        name, what = ("channels", "named channels") if channels is not None else ("part", "parts")
        raise ValueError(f"{path}: {name}: only EXR files have {what}")
    if head.startswith(b"#?"):
        return torch.from_numpy(np.ascontiguousarray(hdr.read_hdr(path)))
    if head[:2] in (b"PF", b"Pf"):
        return torch.from_numpy(pfm.read_pfm(path))
    return _read_integers(path, head, raw)


def read_channels(path: str | os.PathLike[str], *, part: str | None = None) -> dict[str, torch.Tensor]:
    """All channels of an EXR file by name, each float32 (H, W).

    Args:
        path: the file.
        part: name of one of its parts, if it has several; by default the first.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not an EXR file, has no such part, or is truncated or damaged.
    """
    path = _exr_file(path)
    with reading(path):
        return {name: torch.from_numpy(pixels) for name, pixels in exr.read_exr(path, part).items()}


def read_parts(path: str | os.PathLike[str]) -> dict[str, dict[str, torch.Tensor]]:
    """All parts of an EXR file by name, each with its channels by name, float32 (H, W).

    An ordinary file is a single part with the name ``""``. Parts may differ in size.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not an EXR file, or is truncated or damaged.
    """
    path = _exr_file(path)
    with reading(path):
        found = exr.read_parts(path)
    return {
        part: {name: torch.from_numpy(pixels) for name, pixels in channels.items()} for part, channels in found.items()
    }


def _exr_file(path: str | os.PathLike[str]) -> Path:
    path = existing_file(path)
    with path.open("rb") as file:
        if file.read(4) != exr.MAGIC:
            raise ValueError(f"{path}: not an OpenEXR file")
    return path


def write_parts(
    path: str | os.PathLike[str],
    parts: Mapping[str, torch.Tensor | np.ndarray | Mapping[str, torch.Tensor]],
    *,
    half: bool = False,
) -> None:
    """Write an EXR file of several parts, which may differ in size.

    Args:
        path: ``.exr``, in an existing folder.
        parts: by name, each an image or a mapping from layer names to images of one size, as `write_image` takes it.
        half: 16-bit floats instead of 32-bit ones.

    Raises:
        FileNotFoundError: if there is no such folder.
        TypeError, ValueError: if there are no parts, or one of them is none of those.
    """
    path = writable_file(path)
    if path.suffix.lower() != ".exr":
        raise ValueError(f"{path}: only EXR files have parts; expected a name that ends in .exr")
    if not isinstance(parts, Mapping) or not parts:
        raise TypeError(f"parts: expected a mapping from names to images, got {describe(parts)}")
    if not all(isinstance(name, str) and name for name in parts) and len(parts) > 1:
        raise ValueError(f"parts: expected names, got {list(parts)}")
    exr.write_exr(path, {name: _named_channels(path, image, None) for name, image in parts.items()}, half)


def writable_image(path: str | os.PathLike[str]) -> Path:
    """The path, if its folder is there and its ending is that of a format which is written."""
    path = writable_file(path)
    ending = path.suffix.lower()
    if ending not in (".exr", ".hdr", ".pfm", ".png", ".jpg", ".jpeg"):
        raise ValueError(f"{path}: unknown image format {ending!r}; expected .exr, .hdr, .pfm, .png, .jpg or .jpeg")
    return path


def write_image(
    path: str | os.PathLike[str],
    image: torch.Tensor | np.ndarray | Mapping[str, torch.Tensor] | tuple[torch.Tensor, ...],
    *,
    channels: Sequence[str] | None = None,
    half: bool = False,
    bits: int = 8,
    raw: bool = False,
    quality: int = 95,
    tonemap: TonemapName = "srgb",
) -> None:
    """Write a picture of linear values; the ending of the name says in which format.

    Args:
        path: ``.exr``, ``.hdr``, ``.pfm``, ``.png``, ``.jpg`` or ``.jpeg``, in an existing folder.
        image: (H, W, C) or (H, W), floating point, top row first. C is 1, 3 or 4 for PNG, 1 or 3 for JPEG and PFM,
            3 for HDR; any number for EXR with ``channels``. For EXR also a mapping from layer names to such images of
            one size: ``{"": rgb, "depth": z, "normal": n}`` is stored as R, G, B, depth, normal.R, normal.G, normal.B;
            or what `render` gives for ``outputs=``, whose names then are those of the layers; or Stokes vectors (H, W,
            C, 4), stored as S0.R, S0.G, ... S3.B as by Mitsuba (`torchrender.polarization.channel_names`).
        channels: EXR: the name of each channel, of Stokes vectors that of each of the C colours; by default Y, or R, G,
            B, or R, G, B, A.
        half: EXR: 16-bit floats, which end at 65504 (larger values become infinite), instead of 32-bit ones.
        bits: PNG: 8 or 16 bits per channel.
        raw: PNG, JPEG: store the values as they are, without the sRGB curve. They are clipped to [0, 1] in any case.
        quality: JPEG: 1 to 100.
        tonemap: PNG, JPEG: ``"srgb"``, the sRGB curve alone, or ``"filmic"``, with Hable's curve before it, as of
            `tr.tonemap`. Not with `raw`.

    Raises:
        FileNotFoundError: if there is no such folder.
        TypeError, ValueError: if the image or the format is not one of those above.
    """
    path = writable_image(path)
    ending = path.suffix.lower()
    check_tonemap("tonemap", tonemap)
    if tonemap != "srgb" and (raw or ending not in (".png", ".jpg", ".jpeg")):
        raise ValueError(f"tonemap: {tonemap!r} is for PNG and JPEG without raw=True; other files keep linear values")
    if ending == ".exr":
        exr.write_exr(path, {"": _named_channels(path, image, channels)}, half)
        return
    if channels is not None or isinstance(image, (Mapping, tuple)):
        fields = getattr(image, "_fields", None)
        hint = f"; write one output, such as found.{fields[0]}" if fields else ""
        raise ValueError(f"{path}: only EXR files have named channels{hint}")
    pixels = as_pixels("image", cast("torch.Tensor", image))
    if pixels.shape[-1] not in _DEFAULT_NAMES and (hint := advice(pixels)):
        raise ValueError(f"image: expected shape (H, W, C), got {pixels.shape}{hint}")
    if ending == ".hdr":
        hdr.write_hdr(path, pixels)
    elif ending == ".pfm":
        pfm.write_pfm(path, pixels)
    else:
        _write_integers(path, pixels, ending, bits, None if raw else tonemap, quality)


def advice(tensor: torch.Tensor | np.ndarray) -> str:
    """For layouts of images that people have elsewhere."""
    few, shape = (1, 2, 3, 4), tuple(tensor.shape)
    if len(shape) == 3 and shape[0] in few and shape[1] > 4 and shape[2] > 4:
        return ", which looks like (C, H, W): use image.movedim(0, -1)"
    if len(shape) == 4:
        channels_first = shape[1] in few and shape[3] not in few
        return ", which is a batch: write one image at a time, " + (
            "image[i].movedim(0, -1)" if channels_first else "image[i]"
        )
    return ""


def as_pixels(what: str, image: torch.Tensor | np.ndarray) -> np.ndarray:
    """The image as a float32 array (H, W, C)."""
    tensor = torch.as_tensor(image) if isinstance(image, (torch.Tensor, np.ndarray)) else None
    if tensor is None or not tensor.is_floating_point():
        got = f"dtype {tensor.dtype}" if tensor is not None else type(image).__name__
        raise TypeError(f"{what}: expected a floating-point tensor (H, W, C), got {got}")
    if tensor.dim() not in (2, 3) or 0 in tensor.shape:
        raise ValueError(
            f"{what}: expected shape (H, W, C) or (H, W) without zeros, got {tuple(tensor.shape)}{advice(tensor)}"
        )
    tensor = tensor.unsqueeze(-1) if tensor.dim() == 2 else tensor
    return np.ascontiguousarray(tensor.detach().cpu().float().numpy())


def _are_stokes(image: Any) -> bool:
    """Whether this has the shape of Stokes vectors (H, W, C, 4)."""
    return isinstance(image, (torch.Tensor, np.ndarray)) and image.ndim == 4 and image.shape[3] == 4


def _layer(values: torch.Tensor) -> torch.Tensor:
    """An output as floating-point numbers: identifiers are exact up to 2^24."""
    return values if values.is_floating_point() else values.float()


def _named_channels(path: Path, image: Any, channels: Sequence[str] | None) -> dict[str, np.ndarray]:
    """Channel name -> (H, W), from an image or from a mapping of layers."""
    fields = getattr(image, "_fields", None)
    if fields is not None:  # what `render` gives for several outputs
        layers = {"" if name == "rgb" else name: _layer(getattr(image, name)) for name in fields}
        if "" in layers and "alpha" in layers:
            layers[""] = torch.cat([layers[""], layers.pop("alpha")[..., None]], -1)
        image = layers
    if isinstance(image, Mapping):
        if channels is not None:
            raise ValueError("channels: expected None with a mapping of layers, whose keys are the names")
        result: dict[str, np.ndarray] = {}
        for layer, values in image.items():
            if layer == "stokes" and _are_stokes(values):
                result |= _named_channels(path, values, None)
                continue
            pixels = as_pixels(f"image[{layer!r}]", values)
            count = pixels.shape[-1]
            table = _LAYER_SUFFIXES if layer else _DEFAULT_NAMES
            if count not in table:
                raise ValueError(f"image[{layer!r}]: expected {sorted(table)} channels, got {count}")
            result |= {f"{layer}{suffix}": pixels[..., i] for i, suffix in enumerate(table[count])}
        if len({pixels.shape for pixels in result.values()}) != 1:
            sizes = {name: pixels.shape for name, pixels in result.items()}
            raise ValueError(f"image: expected at least one layer, all of one size, got {sizes}")
        return result
    if _are_stokes(image) and (channels is not None or image.shape[2] in (1, 3)):
        if channels is not None and len(channels) != image.shape[2]:
            raise ValueError(f"channels: expected {image.shape[2]} different names of colours, got {channels}")
        channels = channel_names(_DEFAULT_NAMES[image.shape[2]] if channels is None else channels)
        image = image.reshape(*image.shape[:2], -1)
    pixels = as_pixels("image", image)
    count = pixels.shape[-1]
    if channels is None and count not in _DEFAULT_NAMES:
        raise ValueError(f"{path}: {count} channels need names: pass channels=(...){advice(pixels)}")
    names = _DEFAULT_NAMES[count] if channels is None else tuple(channels)
    if len(names) != count or len(set(names)) != count or not all(isinstance(name, str) and name for name in names):
        raise ValueError(f"channels: expected {count} different names, got {names}")
    return {name: pixels[..., i] for i, name in enumerate(names)}


def _read_integers(path: Path, head: bytes, raw: bool) -> torch.Tensor:
    """PNG, JPEG, BMP and TGA."""
    interlaced = len(head) > 28 and head[28] != 0
    deep = png16.bit_depth(head) == 16 and not interlaced
    stored = png16.read_png16(path) if deep else _read_with_pillow(path)
    colours = stored.shape[-1] - (stored.shape[-1] in (2, 4))
    values = decode_levels(stored[..., :colours], raw)
    if colours == stored.shape[-1]:
        return values
    return torch.cat([values.expand(-1, -1, 3), decode_levels(stored[..., colours:], raw=True)], dim=-1)


def _read_with_pillow(path: Path) -> np.ndarray:
    """uint8 (H, W, C), C = 1, 2, 3 or 4."""
    from PIL import Image, UnidentifiedImageError

    try:
        formats = ("PNG", "JPEG", "BMP", *(("TGA",) if path.suffix.lower() == ".tga" else ()))  # TGA has no signature
        with Image.open(path, formats=formats) as picture:
            check_size(path, picture.width * picture.height * len(picture.getbands()), _LARGEST_RATIO)
            if picture.mode == "P":
                picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
            elif picture.mode in ("1", "CMYK", "YCbCr"):
                picture = picture.convert("L" if picture.mode == "1" else "RGB")
            elif picture.mode not in ("L", "LA", "RGB", "RGBA"):
                raise ValueError(f"{path}: pictures of mode {picture.mode!r} are not supported")
            pixels = np.asarray(picture)
    except UnidentifiedImageError:
        known = "EXR, Radiance HDR, PFM, PNG, JPEG, BMP or TGA"
        raise ValueError(f"{path}: not a picture that can be read: expected {known}") from None
    except (OSError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path}: the picture is truncated or damaged ({error})") from None
    return pixels[..., None] if pixels.ndim == 2 else pixels


def display_values(pixels: np.ndarray, curve: TonemapName | None) -> torch.Tensor:
    """Pixels (..., C) as values to store, from 0 to 1: with a curve on all channels but alpha, or without any."""
    values = torch.from_numpy(np.nan_to_num(pixels, nan=0.0)).double()
    if curve is not None:
        colours = 3 if values.shape[-1] == 4 else values.shape[-1]
        values = torch.cat([encode(values[..., :colours], curve), values[..., colours:]], dim=-1)
    return values.clamp(0, 1)


def _write_integers(
    path: Path, pixels: np.ndarray, ending: str, bits: int, curve: TonemapName | None, quality: int
) -> None:
    """PNG and JPEG."""
    allowed = (1, 3, 4) if ending == ".png" else (1, 3)
    count = pixels.shape[-1]
    if count not in allowed:
        raise ValueError(f"{path}: expected {allowed} channels for {ending}, got {count}")
    if bits not in ((8, 16) if ending == ".png" else (8,)):
        raise ValueError(f"bits: expected 8, or 16 for a PNG file, got {bits!r} for {ending}")
    if not 1 <= quality <= 100:
        raise ValueError(f"quality: expected 1 to 100, got {quality!r}")
    stored = (display_values(pixels, curve) * (2**bits - 1) + 0.5).floor().numpy()
    if bits == 16:
        png16.write_png16(path, stored.astype(np.uint16))
        return
    from PIL import Image

    stored = stored.astype(np.uint8)
    picture = Image.fromarray(stored[..., 0] if count == 1 else stored)
    picture.save(path, quality=quality) if ending != ".png" else picture.save(path)
