"""Mitsuba's XML scene files as the nested dict that ``load_dict`` takes.

Files of versions 2.x and 3.x are read as they are; older ones (0.x) are brought to today's names first. Which plugins
and parameters exist is not decided here but by ``load_dict``.

A scene file may come from anywhere, so that it decides little: it names files in its own folder and below, declares no
entities, fetches nothing, and its size, its elements and its texts after replacing parameters are limited.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import nearest
from . import xml_values as values
from .xml_tree import Element, read_tree
from .xml_upgrade import upgrade

_OBJECTS = {
    *("scene", "bsdf", "emitter", "film", "integrator", "rfilter", "sampler", "sensor", "shape", "texture"),
    *("spectrum", "volume", "medium", "phase"),
}
_VALUES = {"integer", "float", "boolean", "string", "point", "vector", "rgb", "srgb", "spectrum", "transform"}
_DIRECTIVES = {"ref", "default", "include", "alias", "path"}
_ABSENT = {
    "animation": "transforms that move during the exposure are not supported; a <transform> in its place stands still",
    "import": "a scene file cannot bring Python code; import it, and give the objects to load_dict",
}
_MAX_INCLUDES = 15
_MAX_BYTES = 1 << 26  # of all files
_MAX_ELEMENTS = 1 << 18  # of all files; an include counts as often as it is used
_MAX_TEXT = 1 << 20  # characters of an attribute after its parameters are replaced


def parse(path: str | os.PathLike[str], *, trusted: bool = False, **params: Any) -> dict[str, Any]:
    """Read a scene file.

    Args:
        path: an XML file in Mitsuba's scene format. File names in it are relative to its folder, or to a folder that
            a ``<path>`` element adds; those in a file that it includes also to the folder of that file.
        trusted: its file names may lead anywhere. Otherwise they stay in its folder and below (links are followed
            first), or are, or lie below, absolute paths among `params`.
        **params: values for the file's ``$name`` parameters; they win over its ``<default>`` elements.

    Returns:
        A nested dict as ``load_dict`` takes it. Top-level objects are keyed by their id, else by their tag and a number
        (``shape``, ``shape_1``); nested ones by their name, else likewise. ``<ref>`` becomes
        ``{"type": "ref", "id": ...}``, a transform a 4x4 float64 array, a point or vector a list, and file names are
        absolute.

    Raises:
        FileNotFoundError: if the file, or one that it names, is not there.
        ValueError: naming file, line and tag, for anything that the format does not know, a file elsewhere, or too
            large a scene.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"path: no such scene file: {path}")
    reader = _Reader(params, trusted)
    return reader.read(reader.content(path), str(path), path.resolve().parent)


def parse_string(
    text: str, folder: str | os.PathLike[str] = ".", *, trusted: bool = False, **params: Any
) -> dict[str, Any]:
    """The same for a scene given as text; `folder` is where its relative file names begin."""
    return _Reader(params, trusted).read(text.encode(), "scene text", Path(folder).resolve())


class _Reader:
    """The state of reading one scene: parameters, search folders, ids and aliases."""

    def __init__(self, params: dict[str, Any], trusted: bool) -> None:
        self.trusted = trusted
        self.roots: list[Path] = []
        self.bytes = self.elements = self.characters = 0
        self.given = {name: _as_text(value) for name, value in params.items()}
        self.params = dict(self.given)
        self.used: set[str] = set()
        self.folders: list[Path] = []
        self.homes: dict[str, Path] = {}  # the folder of every file that is read
        self.tags: dict[str, str] = {}
        self.places: dict[str, Element] = {}
        self.aliases: dict[str, str] = {}

    def content(self, path: Path) -> bytes:
        """The bytes of a file, within the limit for all of them."""
        self.bytes += path.stat().st_size
        if self.bytes > _MAX_BYTES:
            raise ValueError(f"{path}: the scene's files are larger than {_MAX_BYTES >> 20} MiB")
        return path.read_bytes()

    def read(self, content: bytes, name: str, folder: Path) -> dict[str, Any]:
        self.folders = [folder]
        given = [Path(text) for text in self.given.values() if len(text) < 4096 and os.path.isabs(text)]
        self.roots = [folder, *(path.resolve() for path in given)]
        root = self.tree(content, name)
        self.homes[name] = folder
        self.expand(root, [name])
        unused = sorted(set(self.given) - self.used)
        if unused:
            raise ValueError(f"{name}: the scene has no parameter ${unused[0]}; {nearest(unused[0], self.used)}")
        self.collect_ids(root)
        return self.scene(root) if root.tag == "scene" else self.object(root)

    def tree(self, content: bytes, name: str) -> Element:
        """Read one file, check its root and version, and upgrade it if it is old."""
        root = read_tree(content, name, _MAX_ELEMENTS - self.elements)
        self.elements += _count(root)
        if root.tag not in _OBJECTS:
            raise root.error(f"expected a scene or an object of one; {nearest(root.tag, _OBJECTS)}")
        if "version" not in root.attributes:
            raise root.error("the attribute 'version' is missing")
        version = root.attributes.pop("version")
        match = re.fullmatch(r"(\d+)(\.\d+){0,2}", version.strip())
        if match is None or int(match[1]) > 3:
            raise root.error(f"version: expected a version up to 3, such as '3.0.0', got {version!r}")
        if int(match[1]) < 2:
            upgrade(root)
        return root

    # Parameters, <include>, <path> and <default> are dealt with in document order, before anything is built.

    def expand(self, element: Element, files: list[str]) -> None:
        for name, text in element.attributes.items():
            element.attributes[name] = self.substitute(element, text)
        kept = []
        for child in element.children:
            if child.tag not in _OBJECTS | _VALUES | _DIRECTIVES and element.tag in _OBJECTS:
                if child.tag in _ABSENT:
                    raise child.error(_ABSENT[child.tag])
                raise child.error(f"unknown tag; {nearest(child.tag, _OBJECTS | _VALUES | _DIRECTIVES)}")
            if child.tag == "default":
                self.default(child)
            elif child.tag == "path":
                self.path(child)
            elif child.tag == "include":
                kept += self.include(child, files)
            else:
                self.expand(child, files)
                kept.append(child)
        element.children = kept

    def substitute(self, element: Element, text: str) -> str:
        def replace(match: re.Match[str]) -> str:
            word = match[1]
            # As in "$resolutionx2", a name may be followed by letters: the longest known one counts.
            for end in range(len(word), 0, -1):
                if word[:end] in self.params:
                    self.used.add(word[:end])
                    return self.params[word[:end]] + word[end:]
            raise element.error(f"undefined parameter ${word}; {nearest(word, self.params)}")

        if "$" not in text:
            return text
        # Replaced one by one: a chain of parameters made of parameters may be longer than memory.
        parts, length, position = [], 0, 0
        for match in re.finditer(r"\$([A-Za-z_]\w*)", text):
            parts += [text[position : match.start()], replace(match)]
            position = match.end()
            length += len(parts[-2]) + len(parts[-1])
            if length > _MAX_TEXT:
                raise element.error(f"an attribute is longer than {_MAX_TEXT} characters with its parameters replaced")
        self.characters += length
        if self.characters > _MAX_BYTES:
            raise element.error(f"the parameters of the scene are replaced by more than {_MAX_BYTES >> 20} MiB of text")
        return "".join([*parts, text[position:]])

    def default(self, element: Element) -> None:
        values.check_attributes(element, ("name", "value"))
        values.no_children(element)
        name = element.attributes["name"]
        self.used.add(name)
        self.params.setdefault(name, self.substitute(element, element.attributes["value"]))

    def path(self, element: Element) -> None:
        values.check_attributes(element, ("value",))
        name = self.substitute(element, element.attributes["value"])
        self.folders.insert(0, self.find(element, name, self.beside_first(element), "folder"))

    def include(self, element: Element, files: list[str]) -> list[Element]:
        values.check_attributes(element, ("filename",))
        values.no_children(element)
        name = self.substitute(element, element.attributes["filename"])
        path = self.find(element, name, self.beside_first(element))
        if len(files) >= _MAX_INCLUDES or str(path) in files:
            raise element.error(f"{name!r} includes itself, or files include each other too deeply")
        root = self.tree(self.content(path), str(path))
        self.homes[str(path)] = path.parent
        self.expand(root, [*files, str(path)])
        return root.children if root.tag == "scene" else [root]

    def beside_first(self, element: Element) -> list[Path]:
        """Where what directs reading is looked for: beside the file that it stands in, then where all files are."""
        return [self.homes[element.file], *self.folders]

    def find_beside_last(self, element: Element, name: str) -> Path:
        """A file that an object names: in added folders, beside the scene's file, beside the file that it stands in."""
        return self.find(element, name, [*self.folders, self.homes[element.file]])

    def find(self, element: Element, name: str, folders: list[Path], kind: str = "file") -> Path:
        """A file or folder by its name, seen from the first of `folders` that has it."""
        if "\0" in name or len(name) > 4096:
            raise element.error("expected a file name, got something that is none")
        for candidate in folders:
            try:
                found = (candidate / name).is_dir() if kind == "folder" else (candidate / name).is_file()
            except OSError:  # a part of the name is too long, a loop of links
                found = False
            if found:
                return self.confine(element, candidate / name)
        searched = ", ".join(dict.fromkeys(str(candidate) for candidate in folders))
        raise element.error(f"no such {kind}: {name!r}; searched in {searched}", FileNotFoundError)

    def confine(self, element: Element, path: Path) -> Path:
        """`path`, absolute and without links, if the scene may use the file there."""
        resolved = path.resolve()
        if not self.trusted and not any(resolved.is_relative_to(root) for root in self.roots):
            raise element.error(
                f"{str(resolved)!r} is outside of the scene's folder {str(self.roots[0])!r}; "
                "trusted=True allows a file to lead there"
            )
        return resolved

    # Ids.

    def collect_ids(self, element: Element) -> None:
        for child in element.children:
            name = child.attributes.get("id")
            if child.tag == "alias":
                values.check_attributes(child, ("id", "as"))
                self.aliases[child.attributes["as"]] = child.attributes["id"]
            elif name is not None and child.tag != "ref":
                if name in self.places:
                    raise child.error(f"the id {name!r} was given before, in line {self.places[name].line}")
                self.tags[name], self.places[name] = child.tag, child
            self.collect_ids(child)

    def reference(self, element: Element) -> tuple[str, dict[str, str]]:
        """The tag of the object referred to, and the dict for it."""
        values.check_attributes(element, ("id",), ("name",))
        values.no_children(element)
        name, seen = element.attributes["id"], set()
        while name in self.aliases and name not in seen:
            seen.add(name)
            name = self.aliases[name]
        if name not in self.tags:
            raise element.error(f"nothing has the id {name!r}; {nearest(name, [*self.tags, *self.aliases])}")
        return self.tags[name], {"type": "ref", "id": name}

    # Objects.

    def scene(self, element: Element) -> dict[str, Any]:
        values.check_attributes(element, (), ("id", "name", "type"))
        result: dict[str, Any] = {"type": "scene"}
        objects = [child for child in element.children if child.tag != "alias"]
        taken = {child.attributes["id"] for child in objects if "id" in child.attributes and child.tag != "ref"}
        for child in objects:
            if child.tag == "ref" or not _is_object(child):
                raise child.error("unexpected directly inside <scene>, which holds objects")
            built = self.object(child)
            key = built.pop("id", None) or child.attributes.get("name") or _free(child.tag, taken)
            if key in result:
                raise child.error(f"the name {key!r} was given before")
            taken.add(key)
            result[key] = built
        return result

    def object(self, element: Element) -> dict[str, Any]:
        values.check_attributes(element, ("type",), ("id", "name"))
        result: dict[str, Any] = {"type": element.attributes["type"]}
        if "id" in element.attributes:
            result["id"] = element.attributes["id"]
        named = {child.attributes["name"] for child in element.children if "name" in child.attributes}
        for child in element.children:
            tag, value = self.reference(child) if child.tag == "ref" else (child.tag, self.value(child))
            key = child.attributes.get("name") or _free(tag, named | set(result))
            if key in result:
                raise child.error(f"the name {key!r} was given before in this <{element.tag}>")
            result[key] = value
        return result

    def value(self, element: Element) -> Any:
        """What one child of an object stands for."""
        tag = element.tag
        if tag == "scene":
            raise element.error("unexpected inside another object")
        if _is_object(element):
            return self.object(element)
        if tag not in _VALUES:
            raise element.error(f"unexpected here; {nearest(tag, _OBJECTS | _VALUES)}")
        if tag == "transform":
            values.check_attributes(element, ("name",))
            return values.transform(element)
        values.no_children(element)
        if tag in ("point", "vector"):
            values.check_attributes(element, ("name",), ("value", "x", "y", "z"))
            return values.vector(element)
        if tag == "spectrum" and "filename" in element.attributes:
            values.check_attributes(element, ("name", "filename"))
            return {"type": "spectrum", "filename": str(self.find_beside_last(element, element.attributes["filename"]))}
        values.check_attributes(element, ("name", "value"))
        if tag == "string":
            text = element.attributes["value"]
            return str(self.find_beside_last(element, text)) if element.attributes["name"] == "filename" else text
        return _SIMPLE[tag](element)


_SIMPLE = {
    "integer": values.integer,
    "float": lambda element: values.number(element, "value"),
    "boolean": values.boolean,
    "rgb": values.colour,
    "srgb": values.srgb_colour,
    "spectrum": values.spectrum,
}


def _is_object(element: Element) -> bool:
    return element.tag in _OBJECTS and (element.tag != "spectrum" or "type" in element.attributes)


def _count(element: Element) -> int:
    return 1 + sum(_count(child) for child in element.children)


def _free(tag: str, taken: set[str]) -> str:
    """``tag``, or the first of ``tag_1``, ``tag_2`` ... that is not taken."""
    return next(name for name in _candidates(tag) if name not in taken)


def _candidates(tag: str) -> Iterator[str]:
    yield tag
    number = 1
    while True:
        yield f"{tag}_{number}"
        number += 1


def _as_text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return ", ".join(_as_text(item) for item in value)
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)
