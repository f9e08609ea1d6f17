"""Colours: numbers, rgb triples, and dicts that describe one, tabulated spectra among them.

In a spectral scene a tabulated spectrum stays one, a number a nanometre. Else it becomes the colour that the standard
observer sees (`cie`), as in Mitsuba's rgb variants: light as it is, so that a spectrum of ones is not white but the
slightly red (1.2048, 0.9483, 0.9089); factors such as reflectances in daylight, so that ones are white.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch

from .. import spectrum as tables
from ..errors import describe, nearest
from ..spectrum import cie
from . import values
from .conductors import CONDUCTORS, conductor_spectra
from .context import SAMPLES, SODIUM, Context
from .indices import is_index_spectrum, refractive_index

_LARGEST_FILE = 1 << 24
_GRID = np.linspace(cie.FIRST, cie.LAST, SAMPLES)
_Reader: TypeAlias = Callable[[Mapping[str, Any], Context], torch.Tensor]


def is_spectrum(value: Any) -> bool:
    """Whether `value` is a dict that describes a constant colour."""
    return isinstance(value, Mapping) and value.get("type") in TYPES


def spectrum(value: Any, ctx: Context) -> torch.Tensor:
    """A colour: shape (3,) in rgb, (1,) in mono, or () for a plain number, the same in every channel.

    In a spectral scene it may be a table (471,), too. Tables of numbers become colours elsewhere.
    """
    if isinstance(value, Mapping):
        return from_dict(value, ctx)
    tensor = values.floating(value, ctx)
    if tensor.ndim == 0:
        return tensor
    if tensor.shape == (SAMPLES,):
        return from_table(tensor, ctx)
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
    if ctx.color != "mono" or ctx.wavelength is None:
        return reader(value, ctx)
    found = reader(value, replace(ctx, color="spectral"))
    return from_table(found, ctx) if found.shape == (SAMPLES,) else values.to_channels(found, ctx)


def from_table(table: torch.Tensor, ctx: Context) -> torch.Tensor:
    """A spectrum (471,) as this context has it: itself, or its colour, which keeps the gradient."""
    if ctx.color in (None, "spectral"):
        return table
    if ctx.wavelength is not None:
        return _at(table, ctx.wavelength).reshape(() if ctx.index else (1,))
    if ctx.index:
        return _at(table, SODIUM)
    return values.to_channels(tables.to_rgb(table, None if ctx.emission else tables.d65(table)), ctx)


def _at(table: torch.Tensor, wavelength: float) -> torch.Tensor:
    below = min(int(wavelength - cie.FIRST), SAMPLES - 2)
    return torch.lerp(table[below], table[below + 1], wavelength - cie.FIRST - below)


def _need(value: Mapping[str, Any], name: str, ctx: Context) -> Any:
    content = _present(value, name, ctx)
    return values.numbers(content, ctx.at(name)) if isinstance(content, str) else content


def _present(value: Mapping[str, Any], name: str, ctx: Context) -> Any:
    if name not in value:
        ctx.error(f"{value['type']}: {name!r} is missing")
    return value[name]


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
    limits = [
        float(values.number(value.get(name, end), ctx.at(name)))
        for name, end in (("wavelength_min", cie.FIRST), ("wavelength_max", cie.LAST))
    ]
    number = values.number(_need(value, "value", ctx) if "value" in value else 1.0, ctx)
    if ctx.color != "spectral" or not (ctx.emission or limits != [cie.FIRST, cie.LAST]):
        return number
    return _color(np.array(limits), float(number) * np.ones(2), ctx)


def _rawconstant(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return spectrum(_need(value, "value", ctx), ctx)


def _d65(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """Daylight is white by convention, times a colour and a factor."""
    scale = values.number(value.get("scale", 1.0), ctx.at("scale"))
    if "color" not in value:
        return scale
    if ctx.color != "spectral":
        return scale * spectrum(value["color"], ctx.at("color"))
    color = scale * spectrum(value["color"], replace(ctx.at("color"), emission=False))
    return color * tables.d65(color) if ctx.emission and color.shape == (SAMPLES,) else color


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
    if ctx.color == "spectral":
        return number.expand(SAMPLES).clone()
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


def _metal(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """Part of a metal's index of refraction."""
    name, part = _present(value, "name", ctx), _present(value, "part", ctx)
    if part not in ("eta", "k"):
        ctx.at("part").error(f"expected eta or k, got {describe(part)}")
    if not isinstance(name, str) or name not in CONDUCTORS:
        ctx.at("name").error(f"unknown metal {name!r}; {nearest(str(name), CONDUCTORS)}")
    if ctx.color == "spectral":
        return values.floating(conductor_spectra(name)[part == "k"], ctx)
    return values.to_channels(values.floating(CONDUCTORS[name][part == "k"], ctx), ctx)


def _sigmoid(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """The spectra that colours stand for, by their three coefficients, times a factor."""
    coefficients = values.double_array(_need(value, "coefficients", ctx), ctx.at("coefficients"))
    scale = float(values.number(value.get("scale", 1.0), ctx.at("scale")))
    if coefficients.shape != (3,):
        ctx.at("coefficients").error(f"expected three numbers, got {describe(value['coefficients'])}")
    return _color(_GRID, scale * tables.sigmoid(torch.from_numpy(coefficients)).numpy(), ctx)


def _index(read: Callable[[Mapping[str, Any], Context], torch.Tensor]) -> _Reader:
    """A reader of an index of refraction by wavelength; elsewhere it is that at the sodium line."""

    def reader(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
        with ctx.located():
            table = read(value, ctx)
        return values.floating(table if ctx.color == "spectral" else _at(table, SODIUM), ctx)

    return reader


def _numbers(value: Mapping[str, Any], name: str, count: int, ctx: Context) -> torch.Tensor:
    found = torch.from_numpy(values.double_array(_need(value, name, ctx), ctx.at(name)))
    if found.numel() != count:
        ctx.at(name).error(f"expected {count} number{'s' * (count > 1)}, got {describe(value[name])}")
    return found.reshape(() if count == 1 else (count,))


def _cauchy(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return tables.cauchy(_numbers(value, "A", 1, ctx), _numbers(value, "B", 1, ctx))


def _sellmeier(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return tables.sellmeier(_numbers(value, "B", 3, ctx), _numbers(value, "C", 3, ctx))


def _abbe(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return tables.abbe(_numbers(value, "n_d", 1, ctx), _numbers(value, "V_d", 1, ctx))


def _relative_index(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    """The index inside over that outside, each a number, a name or a spectrum."""

    def index(name: str) -> torch.Tensor:
        given, at = _present(value, name, ctx), replace(ctx.at(name), dtype=torch.float64, index=True)
        return spectrum(given, at) if is_index_spectrum(given) else refractive_index(given, at)

    return values.floating(index("int_ior") / index("ext_ior"), ctx)


def _glass(value: Mapping[str, Any], ctx: Context) -> torch.Tensor:
    return tables.glass(_present(value, "name", ctx))


def _color(wavelengths: np.ndarray, samples: np.ndarray, ctx: Context) -> torch.Tensor:
    """The colour of a tabulated spectrum, or in a spectral scene its table, in the range that it may have here."""
    fault = _fault(wavelengths, samples)
    if fault:
        ctx.error(fault)
    if ctx.index:
        return _measured_index(wavelengths, samples, ctx)
    spectral = ctx.color == "spectral"
    if spectral:
        with ctx.located():
            found = tables.irregular(
                torch.from_numpy(wavelengths), torch.from_numpy(samples), integral=ctx.emission
            ).numpy()
    else:
        found = cie.rgb_of_spectrum(wavelengths, samples, ctx.emission)
    clipped = found.clip(0.0, 1.0 if ctx.bounded else math.inf)
    if np.abs(clipped - found).max() > 1e-3 * max(1.0, np.abs(found).max()):
        shown = ", ".join(f"{v:.4g}" for v in found[:: len(found) // 2 if spectral else 1])
        what = f"the spectrum ({shown} at its ends and middle)" if spectral else f"the spectrum's colour ({shown})"
        warnings.warn(f"{ctx.where}: {what} is out of range and was clipped", stacklevel=2)
    made = values.floating(clipped, ctx)
    return made if spectral else values.to_channels(made, ctx)


def _measured_index(wavelengths: np.ndarray, samples: np.ndarray, ctx: Context) -> torch.Tensor:
    """An index of refraction, which goes on beyond what was measured as it ends there."""
    if not (samples > 0).all():
        ctx.error(f"an index of refraction is positive, got {samples.min():g}")
    table = np.interp(_GRID, wavelengths, samples)
    return values.floating(table if ctx.color == "spectral" else _at(torch.from_numpy(table), SODIUM), ctx)


def _fault(wavelengths: np.ndarray, samples: np.ndarray) -> str:
    """What is wrong with a table, empty if nothing is."""
    if len(wavelengths) != len(samples) or len(samples) < 2:
        counts = f"{len(wavelengths)} wavelengths and {len(samples)} values"
        return f"a spectrum needs two wavelengths or more, each with its value; got {counts}"
    if not (np.isfinite(wavelengths).all() and np.isfinite(samples).all()):
        return "the spectrum has values that are not finite"
    if not (np.diff(wavelengths) > 0).all():
        return "the wavelengths of a spectrum must increase"
    if wavelengths[-1] <= cie.FIRST or wavelengths[0] >= cie.LAST:
        span = f"{wavelengths[0]:g} to {wavelengths[-1]:g}"
        return f"the spectrum, of {span} nm, has nothing that is visible, from {cie.FIRST:g} to {cie.LAST:g} nm"
    return ""


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
TYPES: dict[str, tuple[_Reader, tuple[str, ...]]] = {
    "rgb": (_rgb, ("value",)),
    "srgb": (_rgb, ("color", "value")),
    "spectrum": (_spectrum, ("value", "filename")),
    "uniform": (_uniform, ("value", "wavelength_min", "wavelength_max")),
    "rawconstant": (_rawconstant, ("value",)),
    "d65": (_d65, ("color", "scale")),
    "regular": (_regular, ("wavelength_min", "wavelength_max", "values")),
    "irregular": (_irregular, ("wavelengths", "values")),
    "blackbody": (_blackbody, ("temperature", "wavelength_min", "wavelength_max")),
    "metal": (_metal, ("name", "part")),
    "sigmoid": (_sigmoid, ("coefficients", "scale")),
    "cauchy": (_index(_cauchy), ("A", "B")),
    "sellmeier": (_index(_sellmeier), ("B", "C")),
    "abbe": (_index(_abbe), ("n_d", "V_d")),
    "glass": (_index(_glass), ("name",)),
    "relative_index": (_relative_index, ("int_ior", "ext_ior")),
}
