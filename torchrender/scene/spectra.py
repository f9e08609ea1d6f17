"""Colours: numbers, rgb triples, and dicts that describe one, tabulated spectra among them, which become rgb.

A spectrum becomes the colour that the standard observer sees (`cie`), as in Mitsuba's rgb variants: light as it is, so
that a spectrum of ones is not white but the slightly red (1.2048, 0.9483, 0.9089); factors such as reflectances in
daylight, so that ones are white.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import describe, nearest
from . import cie, values
from .context import Context

_LARGEST_FILE = 1 << 24


def is_spectrum(value: Any) -> bool:
    """Whether `value` is a dict that describes a constant colour."""
    return isinstance(value, Mapping) and value.get("type") in TYPES


def spectrum(value: Any, ctx: Context) -> torch.Tensor:
    """A colour: shape (3,) in rgb, (1,) in mono, or () for a plain number, the same in every channel."""
    if isinstance(value, Mapping):
        return from_dict(value, ctx)
    tensor = values.floating(value, ctx)
    if tensor.ndim == 0:
        return tensor
    if tensor.ndim != 1 or tensor.shape[0] not in (1, 3):
        ctx.error(f"expected a number or a colour of three numbers, got {describe(value)}")
    if tensor.shape[0] == 3:
        return values.to_channels(tensor, ctx)
    return tensor if ctx.color == "mono" else tensor.reshape(())


def from_dict(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """The colour of a spectrum's dict: shape (3,) in rgb, (1,) in mono, or () for one number for all channels."""
    kind = value.get("type")
    if kind not in TYPES:
        ctx.error(f"unknown spectrum {kind!r}; {nearest(str(kind), TYPES)}")
    reader, accepted = TYPES[kind]
    for name in value:
        if name not in (*accepted, "type", "id"):
            ctx.error(f"{kind} has no parameter {name!r}; {nearest(str(name), accepted)}")
    return reader(value, ctx)


def _need(value: Mapping[str, Any], name: str, ctx: Context) -> Any:
    if name not in value:
        ctx.error(f"{value['type']}: {name!r} is missing")
    content = value[name]
    return values.numbers(content, ctx.at(name)) if isinstance(content, str) else content


def _rgb(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    content = _need(value, "color" if "color" in value else "value", ctx)
    if is_spectrum(content):
        return from_dict(content, ctx)
    tensor = values.floating(content, ctx)
    if tensor.numel() == 1:
        tensor = tensor.reshape(1).expand(3)
    if tensor.shape != (3,):
        ctx.error(f"rgb: expected three numbers, got {describe(content)}")
    return values.to_channels(tensor, ctx)


def _uniform(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """A number for all channels, as in Mitsuba's rgb variants, whatever range of visible wavelengths is given."""
    for name in ("wavelength_min", "wavelength_max"):
        if name in value:
            values.number(value[name], ctx.at(name))
    return values.number(_need(value, "value", ctx) if "value" in value else 1.0, ctx)


def _rawconstant(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return spectrum(_need(value, "value", ctx), ctx)


def _d65(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """Daylight is white by convention, times a colour and a factor."""
    scale = values.number(value.get("scale", 1.0), ctx.at("scale"))
    if "color" not in value:
        return scale
    return scale * spectrum(value["color"], ctx.at("color"))


def _spectrum(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    if ("value" in value) == ("filename" in value):
        ctx.error("spectrum: give one of value and filename")
    if "filename" in value:
        pairs = read_spectrum(ctx.at("filename").file(value["filename"]))
        return _color(pairs[:, 0], pairs[:, 1], ctx)
    content = value["value"]
    listed = isinstance(content, Sequence) and not isinstance(content, str) and len(content) > 0
    if listed and isinstance(content[0], (Sequence, np.ndarray, torch.Tensor)):
        pairs = values.double_array(content, ctx.at("value"))
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            ctx.at("value").error(f"expected pairs (wavelength in nm, value), got {describe(content)}")
        return _color(pairs[:, 0], pairs[:, 1], ctx)
    number = values.number(_need(value, "value", ctx), ctx)
    if not ctx.emission or ctx.color == "mono":
        return number
    white = cie.XYZ_TO_RGB.sum(1)  # of X = Y = Z = 1
    return number * number.new_tensor(white)


def _regular(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    samples = values.double_array(_need(value, "values", ctx), ctx.at("values"))
    low, high = (
        float(values.number(_need(value, name, ctx), ctx.at(name))) for name in ("wavelength_min", "wavelength_max")
    )
    return _color(np.linspace(low, high, samples.size), samples.reshape(-1), ctx)


def _irregular(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    wavelengths = values.double_array(_need(value, "wavelengths", ctx), ctx.at("wavelengths"))
    samples = values.double_array(_need(value, "values", ctx), ctx.at("values"))
    return _color(wavelengths.reshape(-1), samples.reshape(-1), ctx)


def _blackbody(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    temperature = float(values.number(_need(value, "temperature", ctx), ctx.at("temperature")))
    low = float(values.number(value.get("wavelength_min", cie.FIRST), ctx.at("wavelength_min")))
    high = float(values.number(value.get("wavelength_max", cie.LAST), ctx.at("wavelength_max")))
    if not (0 < temperature < math.inf and max(low, cie.FIRST) < min(high, cie.LAST)):
        ctx.error(f"blackbody: expected a positive temperature and a range of visible wavelengths, got {dict(value)}")
    return _color(*cie.blackbody(temperature, low, high), ctx)


def _color(wavelengths: np.ndarray, samples: np.ndarray, ctx: Context) -> torch.Tensor:
    """The colour of a tabulated spectrum, brought into the range that it may have here."""
    fault = _fault(wavelengths, samples)
    if fault:
        ctx.error(fault)
    rgb = cie.rgb_of_spectrum(wavelengths, samples, ctx.emission)
    clipped = rgb.clip(0.0, 1.0 if ctx.bounded else math.inf)
    if np.abs(clipped - rgb).max() > 1e-3 * max(1.0, np.abs(rgb).max()):
        text = ", ".join(f"{v:.4g}" for v in rgb)
        warnings.warn(f"{ctx.where}: the spectrum's colour ({text}) is out of range and was clipped", stacklevel=2)
    return values.to_channels(values.floating(clipped, ctx), ctx)


def _fault(wavelengths: np.ndarray, samples: np.ndarray) -> str:
    """What is wrong with a table, empty if nothing is."""
    if len(wavelengths) != len(samples) or len(samples) < 2:
        return f"a spectrum needs two wavelengths or more, each with its value; got {len(wavelengths)} wavelengths"
    if not (np.isfinite(wavelengths).all() and np.isfinite(samples).all()):
        return "the spectrum has values that are not finite"
    return "" if (np.diff(wavelengths) > 0).all() else "the wavelengths of a spectrum must increase"


def read_spectrum(path: Path) -> np.ndarray:
    """A text file of pairs, wavelength in nm and value, one a line; ``#`` begins a comment. Returns (N, 2).

    Raises:
        ValueError: naming the file and line.
    """
    if path.stat().st_size > _LARGEST_FILE:
        raise ValueError(f"{path}: a file of {path.stat().st_size} bytes is no list of wavelengths")
    pairs = []
    for number, line in enumerate(path.read_bytes().decode("latin-1").splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            wavelength, value = (float(word) for word in words)
        except ValueError:
            raise ValueError(f"{path}, line {number}: expected a wavelength and a value, got {line[:40]!r}") from None
        pairs.append((wavelength, value))
    if not pairs:
        raise ValueError(f"{path}: the file has no wavelengths")
    table = np.array(pairs, np.float64)
    fault = _fault(table[:, 0], table[:, 1])
    if fault:
        raise ValueError(f"{path}: {fault}")
    return table


# type -> (reader, accepted names)
TYPES: dict[str, tuple[Callable[[Mapping[str, Any], Context], torch.Tensor], tuple[str, ...]]] = {
    "rgb": (_rgb, ("value",)),
    "srgb": (_rgb, ("color", "value")),
    "spectrum": (_spectrum, ("value", "filename")),
    "uniform": (_uniform, ("value", "wavelength_min", "wavelength_max")),
    "rawconstant": (_rawconstant, ("value",)),
    "d65": (_d65, ("color", "scale")),
    "regular": (_regular, ("wavelength_min", "wavelength_max", "values")),
    "irregular": (_irregular, ("wavelengths", "values")),
    "blackbody": (_blackbody, ("temperature", "wavelength_min", "wavelength_max")),
}
