"""Film, reconstruction filter and sampler: the static half of a sensor."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from ..errors import SubstitutionWarning, depth_outside, describe, nearest
from . import values
from .bands import bands as read_bands
from .context import Context
from .registry import ADVICE, DOCUMENTED, PARTS
from .spectra import is_spectrum

FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")
FILTER_PARAMETERS: dict[str, tuple[str, ...]] = {
    "box": (),
    "tent": ("radius",),
    "gaussian": ("stddev",),
    "mitchell": ("B", "C"),
    "catmullrom": (),
    "lanczos": ("lobes",),
}
SAMPLERS = ("independent", "stratified", "sobol")
FILMS = ("hdrfilm", "specfilm")
PARTS.update(dict.fromkeys(FILTERS, ("filter", "film")))
PARTS.update({**dict.fromkeys(SAMPLERS, ("sampler", "sensor")), **dict.fromkeys(FILMS, ("film", "sensor"))})


class Settings:
    """Base of dataclasses that refuse attributes which they do not have."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.__dataclass_fields__:
            raise AttributeError(f"{type(self).__name__} has no {name!r}; {nearest(name, self.__dataclass_fields__)}")
        super().__setattr__(name, value)


@dataclass
class ReconstructionFilter(Settings):
    """How a sample spreads over pixels, a function of the distances along rows and columns.

    ``"mitchell"``, ``"catmullrom"`` and ``"lanczos"`` have negative lobes: a pixel next to an edge may be brighter or
    darker than both of its sides, also negative, and its alpha beyond [0, 1]. Few samples a pixel, whose weights hardly
    add up to anything, are noisy with them. Outputs that are averages over what is hit (depth, normals) are weighted
    with the lobes' magnitude.

    Attributes:
        type: one of FILTERS.
        radius: of ``"tent"``, in pixels.
        stddev: of ``"gaussian"``, in pixels; it is cut off at four times that.
        B, C: of ``"mitchell"``, the cubic of Mitchell and Netravali (1988); 1/3 each unless given, from -8 to 8.
        lobes: of ``"lanczos"``, its radius in pixels, from 1 to 16; 3 unless given.
    """

    type: str = "gaussian"
    radius: float = 1.0
    stddev: float = 0.5
    B: float = 1 / 3
    C: float = 1 / 3
    lobes: int = 3

    def __post_init__(self) -> None:
        ctx = Context(path=("ReconstructionFilter",))
        values.choice(self.type, FILTERS, ctx.at("type"))
        for name in ("radius", "stddev"):
            value = float(values.number(getattr(self, name), ctx.at(name)))
            if not 0 < value <= 16:
                ctx.at(name).error(f"expected a number of pixels in (0, 16], got {value:g}")
            setattr(self, name, value)
        for name in ("B", "C"):
            value = float(values.number(getattr(self, name), ctx.at(name)))
            if not abs(value) <= 8:
                ctx.at(name).error(f"expected a number from -8 to 8, got {value:g}")
            setattr(self, name, value)
        self.lobes = values.integer(self.lobes, ctx.at("lobes"), 1)
        if self.lobes > 16:
            ctx.at("lobes").error(f"expected 1 to 16 lobes, got {self.lobes}")

    @property
    def parameters(self) -> tuple[float, float]:
        """What the core takes."""
        first = {"tent": self.radius, "gaussian": self.stddev, "mitchell": self.B, "lanczos": self.lobes}
        return float(first.get(self.type, 1.0)), float(self.C if self.type == "mitchell" else 0.0)

    @property
    def reach(self) -> float:
        """How far it reaches along rows and columns, in pixels."""
        radius = {"box": 0.5, "tent": self.radius, "gaussian": 4 * self.stddev, "lanczos": float(self.lobes)}
        return radius.get(self.type, 2.0)


@dataclass
class Film(Settings):
    """Size of the image in pixels, the part of it that is rendered, and the reconstruction filter.

    Attributes:
        width, height: of the whole film.
        crop: rows and columns that are rendered as (y0, x0, height, width); None is everything.
        sample_border: draw samples also outside of the crop window, so that its edge pixels see whole filters.
        filter: the reconstruction filter.
        formats: what the dict said about file formats; kept, but rendering does not depend on it.
        bands: responses by name, in a spectral scene: the image is (H, W, J) with the integrals of the radiance times
            each, over wavelengths in nm. Each is a table (471,) of numbers from 360 to 830 nm, a spectrum's dict, or a
            number. None is the standard observer's red, green and blue. Three bands at a time are rendered. Gradients
            of images reach a table that requires one.
    """

    width: int = 768
    height: int = 576
    crop: tuple[int, int, int, int] | None = None
    sample_border: bool = False
    filter: ReconstructionFilter = field(default_factory=ReconstructionFilter)
    formats: dict[str, str] = field(default_factory=dict)
    bands: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        self.check(Context(path=("Film",)))

    def check(self, ctx: Context) -> None:
        """ValueError unless the sizes make sense."""
        self.width = values.integer(self.width, ctx.at("width"), 1)
        self.height = values.integer(self.height, ctx.at("height"), 1)
        if self.width > 1 << 16 or self.height > 1 << 16:
            ctx.error(f"a film has at most 65536 rows and columns, got {self.height} x {self.width}")
        if self.crop is not None:
            check_crop(self.crop, (self.height, self.width), ctx)

        self.bands = read_bands(self.bands, ctx.at("bands"))

    @property
    def channels(self) -> tuple[str, ...] | None:
        """Names of the bands, in the order of the image's channels; None for those of the scene's colours."""
        return None if self.bands is None else tuple(self.bands)

    @property
    def window(self) -> tuple[int, int, int, int]:
        """What is rendered, as (y0, x0, height, width)."""
        return self.crop if self.crop is not None else (0, 0, self.height, self.width)


def check_crop(crop: Any, size: tuple[int, int], ctx: Context) -> tuple[int, int, int, int]:
    """`crop` as (y0, x0, h, w) inside a film of `size` (H, W)."""
    try:
        y0, x0, h, w = (values.integer(v, ctx.at("crop")) for v in crop)
    except (TypeError, ValueError) as error:
        if isinstance(error, ValueError) and "crop" in str(error):
            raise
        ctx.error(f"crop: expected (y0, x0, height, width), got {describe(crop)}")
    if y0 < 0 or x0 < 0 or h < 1 or w < 1 or y0 + h > size[0] or x0 + w > size[1]:
        ctx.error(f"crop: {(y0, x0, h, w)} is not inside a film of {size[0]} rows and {size[1]} columns")
    return y0, x0, h, w


@dataclass
class Sampler(Settings):
    """How the samples of a pixel are spread, and how many there are unless a rendering asks for another number.

    Attributes:
        sample_count: samples a pixel, from 1 to 2^32; a dict or file that does not say it means 4.
        type: one of ``tr.SAMPLERS``, for image and derivative alike. ``"independent"`` numbers; ``"stratified"`` ones,
            which are jittered in as many strata as there are samples in every dimension of a path, and in a grid of
            cells where two of them belong together; points of a Sobol sequence, Owen-scrambled for every pixel and pair
            of dimensions, ``"sobol"``, best with powers of two. All of them are unbiased with any number of samples.
    """

    sample_count: int = 16
    type: str = "independent"

    def __post_init__(self) -> None:
        self.check(Context(path=("Sampler",)))

    def check(self, ctx: Context) -> None:
        """ValueError unless number and type make sense."""
        self.sample_count = values.integer(self.sample_count, ctx.at("sample_count"), 1)
        if self.sample_count > 1 << 32:
            ctx.at("sample_count").error(f"expected at most {1 << 32}, got {self.sample_count}")
        check_sampler(self.type, ctx.at("type"))


def _checked(value: Mapping[str, Any], category: str, known: tuple[str, ...], ctx: Context) -> str:
    kind = value.get("type")
    if kind not in known:
        if kind in DOCUMENTED[category]:
            ctx.error(
                f"the {category} {kind!r} is not supported by this version of torchrender"
                f"{': ' + ADVICE[kind] if kind in ADVICE else ''}; supported are: {', '.join(known)}"
            )
        ctx.error(f"unknown {category} type {kind!r}; {nearest(str(kind), known)}")
    return str(kind)


# Samplers that others have, and the nearest one here.
_RELATED = {"multijitter": "stratified", "orthogonal": "stratified", "ldsampler": "sobol"}


def check_sampler(name: Any, ctx: Context) -> str:
    """`name`, if it is one of SAMPLERS."""
    if isinstance(name, str) and name in _RELATED:
        ctx.error(
            f"the sampler {name!r} is not supported by this version of torchrender, the nearest to it is "
            f"{_RELATED[name]!r}; supported are: {', '.join(SAMPLERS)}"
        )
    if not isinstance(name, str) or name not in SAMPLERS:
        ctx.error(f"unknown sampler {describe(name)}; {nearest(str(name), SAMPLERS)}")
    return name


def filter_from(value: Any, ctx: Context) -> ReconstructionFilter:
    """A reconstruction filter from its dict or an object."""
    if isinstance(value, ReconstructionFilter):
        return value
    if not isinstance(value, Mapping):
        ctx.error(f"expected a reconstruction filter, got {describe(value)}")
    kind = _checked(value, "rfilter", FILTERS, ctx)
    accepted = FILTER_PARAMETERS[kind]
    given = {k: v for k, v in value.items() if k not in ("type", "id")}
    for name in given:
        if name not in accepted:
            ctx.error(f"{kind} has no parameter {name!r}; {nearest(str(name), accepted)}")
    with ctx.located():
        return ReconstructionFilter(kind, **given)


_FILM_NAMES = (
    "width height file_format pixel_format component_format crop_offset_x crop_offset_y crop_width crop_height "
    "sample_border compensate banner rfilter"
).split()
_FORMATS = {
    "file_format": ("openexr", "exr", "rgbe", "pfm"),
    "pixel_format": ("rgb", "rgba", "luminance", "luminance_alpha", "xyz", "xyza"),
    "component_format": ("float16", "float32", "uint32"),
}


def film_from(value: Any, ctx: Context) -> Film:
    """A film from its dict (`hdrfilm`, or with bands `specfilm`) or an object."""
    if isinstance(value, Film):
        return value
    if not isinstance(value, Mapping):
        ctx.error(f"expected a film, got {describe(value)}")
    kind = _checked(value, "film", FILMS, ctx)
    film = Film()
    bands: dict[str, Any] = {}
    crop: dict[str, int] = {}
    for name, content in value.items():
        if name in ("type", "id"):
            continue
        at = ctx.at(str(name))
        if name in ("width", "height"):
            setattr(film, name, values.integer(content, at, 1))
        elif name.startswith("crop_") and name in _FILM_NAMES:
            crop[name] = values.integer(content, at, 0)
        elif name == "sample_border":
            film.sample_border = values.boolean(content, at)
        elif name in ("compensate", "banner"):
            values.boolean(content, at)  # how sums are rounded, which is exact enough here; a mark in Mitsuba's files
        elif name in _FORMATS:
            values.choice(content, _FORMATS[name], at)
            film.formats[name] = content
        elif kind == "specfilm" and is_spectrum(content):
            bands[str(name)] = content
        elif isinstance(content, (Mapping, ReconstructionFilter)):
            film.filter = filter_from(content, at)
        else:
            ctx.error(f"{kind} has no parameter {name!r}; {nearest(str(name), _FILM_NAMES)}")
    if crop:
        x, y = crop.get("crop_offset_x", 0), crop.get("crop_offset_y", 0)
        film.crop = (y, x, crop.get("crop_height", film.height), crop.get("crop_width", film.width))
    if kind == "specfilm":
        if ctx.color not in (None, "spectral"):
            ctx.error(f"specfilm: bands need wavelengths: a scene of the variant 'spectral', not {ctx.color!r}")
        if not bands:
            ctx.error("specfilm: expected bands: spectra by name, such as 'red': {'type': 'regular', ...}")
        film.bands = read_bands(bands, ctx)
    film.check(ctx)
    if film.crop == (0, 0, film.height, film.width):
        film.crop = None
    return film


def sampler_from(value: Any, ctx: Context) -> Sampler:
    """A sampler from its dict (of a type in SAMPLERS, or one of Mitsuba's related to these) or an object."""
    if isinstance(value, Sampler):
        return value
    if not isinstance(value, Mapping):
        ctx.error(f"expected a sampler, got {describe(value)}")
    kind = value.get("type")
    if isinstance(kind, str) and kind in _RELATED:
        warnings.warn(
            f"{ctx.where}: the sampler {kind!r} is not there; {_RELATED[kind]!r}, the nearest to it, takes its place",
            SubstitutionWarning,
            stacklevel=depth_outside(),
        )
        value = {k: v for k, v in value.items() if k not in ("jitter", "strength")}
        kind = _RELATED[kind]
    kind = check_sampler(kind, ctx)
    accepted = ("sample_count", "seed", "jitter") if kind == "stratified" else ("sample_count", "seed")
    for name in value:
        if name not in (*accepted, "type", "id"):
            ctx.error(f"{kind} has no parameter {name!r}; {nearest(str(name), accepted)}")
    said = []
    if "jitter" in value and not values.boolean(value["jitter"], ctx.at("jitter")):
        said.append(
            "jitter=False is not there: samples are jittered in their strata, as those in the middle are biased"
        )
    if "seed" in value and values.integer(value["seed"], ctx.at("seed")) != 0:
        said.append(f"seed={value['seed']} is left out: the seed is an argument of render()")
    for text in said:
        warnings.warn(f"{ctx.where}: {text}", SubstitutionWarning, stacklevel=depth_outside())
    count = values.integer(value.get("sample_count", 4), ctx.at("sample_count"), 1)
    with ctx.located():
        return Sampler(count, kind)
