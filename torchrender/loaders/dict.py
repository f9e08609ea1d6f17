"""Scenes from nested dicts, and from files by way of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import torch
from torch import nn

from .. import backends
from ..errors import describe, nearest
from ..integrators import TYPES, from_dict
from ..scene import registry
from ..scene.container import check_names
from ..scene.context import LONGEST, SHORTEST, Context
from ..scene.film import FILMS, film_from
from ..scene.scene import POLARIZED, VARIANTS, Scene, operation
from ..typing import SceneDict, Unsupported, VariantName
from . import mesh_files  # noqa: F401  (registers its types of shapes)
from .compounds import expand_compounds
from .instances import expand_instances

if TYPE_CHECKING:
    import trimesh

DTYPES = (torch.float32, torch.float64)


def variants() -> list[str]:
    """The colour variants that this build has, for ``load_dict(..., variant=...)``."""
    found = {str(v["color"]) for v in backends.core().variants()}
    return [v for v in VARIANTS if v.removesuffix(POLARIZED) in found]


def _settings(function: str, variant: Any, dtype: Any, device: Any, wavelength: Any) -> torch.device:
    if variant not in VARIANTS:
        raise ValueError(f"{function}: unknown variant {variant!r}; {nearest(str(variant), VARIANTS)}")
    if dtype not in DTYPES:
        raise ValueError(f"{function}: dtype: expected torch.float32 or torch.float64, got {dtype!r}")
    try:
        made = torch.device(device)
    except (RuntimeError, TypeError):
        raise ValueError(f"{function}: device: expected 'cpu' or another device, got {describe(device)}") from None
    try:
        torch.empty(0, device=made)
    except (AssertionError, NotImplementedError, RuntimeError) as error:  # torch without CUDA asserts
        sentence = str(error).strip().splitlines()[0]
        raise ValueError(f"{function}: device: PyTorch has no {str(made)!r} here: {sentence}") from None
    if wavelength is not None:
        if variant.removesuffix(POLARIZED) != "mono":
            raise ValueError(f"{function}: wavelength: it is for variant='mono', not {variant!r}")
        number = isinstance(wavelength, (int, float)) and not isinstance(wavelength, bool)
        if not number or not SHORTEST <= wavelength <= LONGEST:
            visible = f"{SHORTEST:g} to {LONGEST:g} nm"
            raise ValueError(f"{function}: wavelength: expected a number from {visible}, got {describe(wavelength)}")
    return made


def _substituting(function: str, unsupported: Any) -> bool:
    if unsupported not in ("error", "substitute"):
        raise ValueError(f"{function}: unsupported: expected 'error' or 'substitute', got {unsupported!r}")
    return unsupported == "substitute"


@overload
def load_dict(
    description: SceneDict,
    *,
    variant: VariantName = "rgb",
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
    wavelength: float | None = None,
    unsupported: Unsupported = "error",
) -> Scene: ...


@overload
def load_dict(
    description: Mapping[str, Any],
    *,
    variant: VariantName = "rgb",
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
    wavelength: float | None = None,
    unsupported: Unsupported = "error",
    _folder: Path | None = None,
) -> Scene | Any: ...


def load_dict(
    description: Mapping[str, Any],
    *,
    variant: VariantName = "rgb",
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
    wavelength: float | None = None,
    unsupported: Unsupported = "error",
    _folder: Path | None = None,
) -> Scene | Any:
    """A scene, or a single object, from a nested dict in the format that Mitsuba 3 documents.

    Args:
        description: ``{"type": "scene", "id": {"type": ..., ...}, ...}``. Values may be numbers, lists, arrays,
            tensors, dicts, references ``{"type": "ref", "id": NAME}`` and built objects such as `tr.Mesh`.
        variant: colour mode, one of `variants()`.
        dtype: `torch.float32` or `torch.float64`, of all parameters and of the rendering.
        device: where its tensors lie, as by ``.to(device)``: ``"cpu"``, a card, which then renders it, or another.
        wavelength: for ``variant="mono"``: in nm, from 360 to 830, where spectra, metals and glasses are taken. Numbers
            stay what they are; of colours and images it is the luminance, as it is of everything without `wavelength`.
        unsupported: ``"error"``, or ``"substitute"``: what this version does not have is replaced by the nearest thing
            that it has or, where there is none, left out; one `SubstitutionWarning` each says what and where.

    Raises:
        ValueError: naming the place in the scene, the word that is wrong, and the nearest known ones.
    """
    place = _settings("load_dict", variant, dtype, device, wavelength)
    if place.type != "cpu":
        settings = {"variant": variant, "dtype": dtype, "wavelength": wavelength, "unsupported": unsupported}
        built = load_dict(description, **settings, _folder=_folder)
        return built.to(place) if isinstance(built, nn.Module) else built
    if not isinstance(description, Mapping):
        hint = "; tr.load_file reads files" if isinstance(description, (str, os.PathLike)) else ""
        raise TypeError(f"load_dict: expected a nested dict, got {describe(description)}{hint}")
    if description.get("type") is None:
        raise ValueError("load_dict: the dict has no 'type'; a scene's is 'scene'")
    if not isinstance(description["type"], str):
        raise ValueError(f"load_dict: type: expected a word, got {describe(description['type'])}")
    ctx = Context(variant.removesuffix(POLARIZED), dtype, folder=_folder, wavelength=wavelength)
    check_names(description, ctx)
    if description["type"] == "scene":
        description = expand_compounds(description, ctx)
    if _substituting("load_dict", unsupported):
        from .fallbacks import with_fallbacks

        description = with_fallbacks(description, variant)
    kind = description["type"]
    if kind == "scene":
        objects = {k: v for k, v in description.items() if k not in ("type", "id")}
        objects = expand_instances(objects, ctx)
        return Scene(objects, variant, dtype, _folder, wavelength)
    ctx = ctx.at(str(kind))
    if kind in TYPES:
        return from_dict(dict(description), str(kind))
    if kind in FILMS:
        return film_from(description, ctx)
    if kind in registry.PARTS:
        what, owner = registry.PARTS[kind]
        raise ValueError(f"load_dict: type: expected a scene or an object of one, got {kind!r}, a {what} of a {owner}")
    return registry.build(description, ctx)


def load_file(
    path: str | os.PathLike[str],
    *,
    variant: VariantName = "rgb",
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
    wavelength: float | None = None,
    unsupported: Unsupported = "error",
    trusted: bool = False,
    **parameters: str | float | os.PathLike[str],
) -> Scene:
    """A scene from a file: Mitsuba XML, or geometry that trimesh reads (glTF/GLB, OBJ, PLY, STL).

    Args:
        path: the file.
        variant, dtype, device, wavelength, unsupported: as for `load_dict`.
        trusted: the file may use files outside of its own folder, such as textures in ``../textures``. By default that
            is refused: a scene from elsewhere should not choose which files are read.
        parameters: values for the ``$parameters`` of an XML file.

    Raises:
        FileNotFoundError: if there is no such file, or one that it names is missing.
        TypeError, ValueError: naming the file, the line or the place in the scene, and what was expected.
    """
    _settings("load_file", variant, dtype, device, wavelength)
    _substituting("load_file", unsupported)
    if not isinstance(path, (str, os.PathLike)):
        hint = "; tr.load_dict takes dicts" if isinstance(path, Mapping) else ""
        raise TypeError(f"load_file: path: expected a file name, got {describe(path)}{hint}")
    file = Path(path)
    if not file.exists():
        raise FileNotFoundError(f"load_file: no such file: {file}")
    if file.is_dir():
        raise ValueError(f"load_file: {file} is a folder")
    if file.suffix.lower() == ".xml":
        from . import xml

        description = xml.parse(file, trusted=trusted, **parameters)
    else:
        if parameters:
            raise TypeError(f"load_file: {file.name} takes no parameters, got {', '.join(parameters)}")
        from . import geometry

        description = geometry.load_scene(file, trusted)
    settings = {
        "variant": variant,
        "dtype": dtype,
        "device": device,
        "wavelength": wavelength,
        "unsupported": unsupported,
    }
    try:
        return load_dict(description, **settings, _folder=file.resolve().parent)
    except (ValueError, TypeError) as error:
        if type(error) not in (ValueError, TypeError) or str(file) in str(error):
            raise
        raise type(error)(f"{file}: {error}") from error


def from_trimesh(
    geometry: trimesh.Trimesh | trimesh.Scene,
    *,
    variant: VariantName = "rgb",
    dtype: torch.dtype = torch.float32,
    device: str | torch.device = "cpu",
    wavelength: float | None = None,
) -> Scene:
    """A scene from a `trimesh.Trimesh` or `trimesh.Scene`: meshes with their materials, a camera and a light.

    Args:
        geometry: what to load. A camera that sees all of it, and a constant light, are added where it has none.
        variant, dtype, device, wavelength: as for `load_dict`.

    Raises:
        TypeError: if it is neither.
        ValueError: if it holds no triangles.
    """
    from . import geometry as loader

    _settings("from_trimesh", variant, dtype, device, wavelength)
    return load_dict(loader.from_trimesh(geometry), variant=variant, dtype=dtype, device=device, wavelength=wavelength)


@operation("save")
def _save(scene: Scene, path: str | os.PathLike[str]) -> None:
    from . import save

    save.save(scene, path)
