"""OpenEXR files with named channels, in half or single precision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

MAGIC = b"\x76\x2f\x31\x01"


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """All channels of the first part, each as float32 (H, W), by name.

    Raises:
        ValueError: if the file is damaged or truncated, or its channels have different resolutions.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, IndexError) as error:
        raise ValueError(f"{path}: the OpenEXR file is truncated or damaged ({error})") from None
    shapes = {name: pixels.shape for name, pixels in channels.items()}
    if not channels or any(len(shape) != 2 or 0 in shape for shape in shapes.values()):
        raise ValueError(f"{path}: expected an OpenEXR file with at least one flat channel, got {shapes}")
    if len(set(shapes.values())) > 1:
        raise ValueError(f"{path}: expected channels of one resolution, got {shapes}")
    return {name: np.ascontiguousarray(pixels, np.float32) for name, pixels in channels.items()}


def write_exr(path: Path, channels: Mapping[str, np.ndarray], half: bool) -> None:
    """Write channels of shape (H, W), ZIP compressed; ``half`` stores 16-bit floats, else 32-bit ones."""
    import OpenEXR

    dtype = np.float16 if half else np.float32
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with np.errstate(over="ignore"):  # values above 65504 become infinite in half precision, as documented
        pixels = {name: np.ascontiguousarray(values.astype(dtype)) for name, values in channels.items()}
    with OpenEXR.File(header, pixels) as file:
        file.write(str(path))


def colour_channels(path: Path, names: list[str]) -> list[str]:
    """The channels that make up the picture: R, G, B and A where there are some; else Y; else a single channel."""
    if {"R", "G", "B"} <= set(names):
        return ["R", "G", "B"] + (["A"] if "A" in names else [])
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ["Y"]
    if len(names) == 1:
        return names
    raise ValueError(f"{path}: no channels R, G, B or Y; choose with channels=(...) from {sorted(names)}")
