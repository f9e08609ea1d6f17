"""Entries of a scene's dict that stand for other objects: `merge`, `batch` and `resources`.

`merge` gives its shapes one by one; what Mitsuba gains by making one mesh of them, an acceleration structure of fewer
parts, has no counterpart. `batch` gives its cameras, whose images are rendered together by ``render(sensor=[...])``;
Mitsuba puts them side by side into one film. `resources` is a folder in which file names begin.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import describe
from ..scene import registry, values
from ..scene.construction import substituted
from ..scene.context import Context
from ..scene.film import SAMPLERS, Film, Sampler

_MAX_DEPTH = 20


def expand_compounds(objects: Mapping[str, Any], ctx: Context) -> dict[str, Any]:
    """The objects of a scene with shapes in place of `merge`, cameras in place of `batch`, and without `resources`.

    Args:
        objects: by id, as the dict of a scene has them.
        ctx: colour mode, precision and folder of the scene.

    Raises:
        ValueError: naming the entry, for what cannot be in it, a folder that is not there, and ids that come twice.
    """
    kinds = {_type(value) for value in objects.values()}
    if not kinds & {"merge", "batch", "resources", "shapegroup"}:
        return dict(objects)
    folders = [_folder(value, ctx.at(str(name))) for name, value in objects.items() if _type(value) == "resources"]
    result: dict[str, Any] = {}
    for name, value in objects.items():
        made = {name: value}
        if _type(value) == "merge":
            made = _merged(str(name), value, ctx.at(str(name)))
        elif _type(value) == "batch":
            made = _cameras(str(name), value, ctx.at(str(name)))
        elif _type(value) == "shapegroup":
            made = {name: _without_merges(value, ctx.at(str(name)))}
        elif _type(value) == "resources":
            continue
        for key, one in made.items():
            if key in result:
                ctx.at(str(name)).error(f"two objects have the id {key!r}")
            result[key] = _found(one, folders) if folders else one
    return result


def _type(value: Any) -> Any:
    return value.get("type") if isinstance(value, Mapping) else None


def _key(name: str, key: str, value: Any, alone: bool) -> str:
    """The id of a part: its own, that of the whole if there is one part, else both."""
    own = value.get("id") if isinstance(value, Mapping) else None
    return own if isinstance(own, str) else name if alone else f"{name}_{key}"


def _merged(name: str, value: Mapping[str, Any], ctx: Context, depth: int = 0) -> dict[str, Any]:
    """The shapes of a `merge` by their ids."""
    if depth > _MAX_DEPTH:
        ctx.error("merges are nested too deeply")
    name = str(value.get("id", name))
    parts = {str(k): v for k, v in value.items() if k not in ("type", "id")}
    made: dict[str, Any] = {}
    for key, part in parts.items():
        at = ctx.at(key)
        category = registry.scene_types().get(str(_type(part))) or getattr(part, "category", None)
        if category not in ("shape", None) or not (registry.is_plugin(part) or isinstance(part, Mapping)):
            at.error(f"a merge holds shapes, got {describe(part)}")
        if _type(part) == "ref":
            at.error("a merge holds its shapes itself, and no reference to one")
        whole = _key(name, key, part, len(parts) == 1)
        found = {whole: part}
        if isinstance(part, Mapping) and part.get("type") == "merge":
            found = _merged(whole, part, at, depth + 1)
        for identifier, one in found.items():
            if identifier in made:
                at.error(f"two objects have the id {identifier!r}")
            made[identifier] = one
    if not made:
        ctx.error("the merge is empty")
    return made


def _without_merges(group: Mapping[str, Any], ctx: Context) -> dict[str, Any]:
    """A `shapegroup` whose merges have given their shapes to it."""
    made: dict[str, Any] = {}
    for key, part in group.items():
        made.update(_merged(str(key), part, ctx.at(str(key))) if _type(part) == "merge" else {key: part})
    return made


def _cameras(name: str, value: Mapping[str, Any], ctx: Context) -> dict[str, Any]:
    """The cameras of a `batch` by their ids, each with its share of the film's columns."""
    name = str(value.get("id", name))
    settings: dict[str, Any] = {}
    cameras: dict[str, Mapping[str, Any]] = {}
    for key, part in value.items():
        if key in ("type", "id", "shutter_open", "shutter_close"):
            continue
        if isinstance(part, (Film, Sampler)) or _type(part) in (*SAMPLERS, *_settings()):
            is_film = isinstance(part, Film) or _type(part) in registry.DOCUMENTED["film"]
            settings["film" if is_film else "sampler"] = part
        elif isinstance(part, Mapping) and registry.scene_types().get(str(_type(part))) == "sensor":
            cameras[str(key)] = part
        else:
            ctx.at(str(key)).error(f"a batch holds cameras as dicts, a film and a sampler, got {describe(part)}")
    if not cameras:
        ctx.error("the batch holds no camera")
    share = _share(settings.get("film", {"type": "hdrfilm"}), len(cameras), ctx.at("film"))
    made = {}
    for key, camera in cameras.items():
        own = {k: v for k, v in camera.items() if _type(v) not in (*SAMPLERS, *_settings())}
        made[_key(name, key, camera, len(cameras) == 1)] = {**own, **settings, "film": share}
    listed = ", ".join(repr(key) for key in made)
    images = f"render(scene, sensor=range({len(made)})) makes their images"
    substituted(ctx, f"'batch' becomes the cameras {listed} of the scene; {images}")
    return made


def _share(film: Any, count: int, ctx: Context) -> Any:
    """The film of one of `count` cameras that stand side by side in `film`."""
    whole: Any = film.width if isinstance(film, Film) else film.get("width", Film().width)
    width = values.integer(whole, ctx.at("width"), 1)
    cropped = film.crop is not None if isinstance(film, Film) else any(str(key).startswith("crop_") for key in film)
    if width % count or cropped:
        ctx.error(f"a batch has columns for all {count} cameras and no crop, got {width} columns")
    return replace(film, width=width // count) if isinstance(film, Film) else {**film, "width": width // count}


def _settings() -> tuple[str, ...]:
    return (*registry.DOCUMENTED["film"], *registry.DOCUMENTED["sampler"])


def _folder(value: Mapping[str, Any], ctx: Context) -> Path:
    """The folder that a `resources` entry names."""
    for key in value:
        if key not in ("type", "id", "path"):
            ctx.error(f"resources has no parameter {key!r}; known here: path")
    given = value.get("path")
    if not isinstance(given, (str, os.PathLike)):
        ctx.at("path").error(f"expected a folder, got {describe(given)}")
    path = Path(given)
    path = path if path.is_absolute() or ctx.folder is None else ctx.folder / path
    if not path.is_dir():
        ctx.at("path").error(f"no such folder: {path}")
    return path.resolve()


def _found(value: Any, folders: list[Path], depth: int = 0) -> Any:
    """`value` with the names of files that are in one of `folders` as absolute paths; the last folder comes first."""
    if not isinstance(value, Mapping) or depth > 100:
        return value
    made = {}
    for key, content in value.items():
        if key == "filename" and isinstance(content, (str, os.PathLike)) and not os.path.isabs(content):
            content = next((str(f / content) for f in reversed(folders) if (f / content).is_file()), content)
        made[key] = _found(content, folders, depth + 1)
    return made
