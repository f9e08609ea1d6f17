"""OBJ files with materials in a form that trimesh understands.

Format: Wavefront, "Object Files (.obj)" and "MTL material format" (both 1995). trimesh reads the first material library
only, and none of tabs, comments behind data, options of textures, and a grey ``Kd`` of one number.
"""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import Any

from ..errors import SubstitutionWarning
from .neighbours import files_of

_LIBRARY = "torchrender.mtl"
_COMMENT = re.compile(rb"^([ \t]*(?:v|vt|vn|f|l|p|s)[ \t][^#\n]*)#[^\n]*", re.MULTILINE)
_LIBRARIES = re.compile(r"^[ \t]*mtllib[ \t]+(.*)$", re.MULTILINE)
_USED = re.compile(r"^[ \t]*usemtl[ \t]+(.*)$", re.MULTILINE)
# Options of textures and how many words follow them; of o, s and t up to three numbers do.
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-texres": 1, "-clamp": 1, "-bm": 1, "-imfchan": 1}
_OPTIONS |= {"-type": 1, "-cc": 1, "-o": 3, "-s": 3, "-t": 3}
_UNUSED = "map_ka map_ks map_ns map_ke map_d map_bump bump norm disp decal refl map_pr map_pm map_ps".split()


def load_obj(path: Path, trusted: bool = False) -> Any:
    """The file as a ``trimesh.Scene``; what its materials ask for in vain is named in a `SubstitutionWarning`.

    Materials have a colour ``Kd`` or its texture, an emission ``Ke`` and an opacity ``d``. One that is not defined
    anywhere is grey, 0.5.
    """
    import trimesh

    content = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    content = _COMMENT.sub(rb"\1", content).replace(b"\t", b" ")
    text = content.decode("utf-8", "replace")
    libraries: dict[str, bytes] = {}
    files = files_of(path, trusted, libraries)
    defined = [_cleaned(path, source, files) for source in _sources(path, text, files)]
    known = {name.strip() for part in defined for name in re.findall(r"^newmtl (.*)$", part, re.MULTILINE)}

    def named(statement: re.Match[str]) -> str:
        """With a comment taken off that is no part of the name."""
        name = statement[1].strip()
        short = name.partition(" #")[0].strip()
        return f"usemtl {short if name not in known and short in known else name}"

    text = _USED.sub(named, text)
    used = dict.fromkeys(name.strip() for name in _USED.findall(text))
    missing = [name for name in used if name and name not in known]
    if missing:
        _say(path, f"no material is called {', '.join(map(repr, missing))}: grey")
    defined += [f"newmtl {name}\nKd 0.5 0.5 0.5" for name in missing]
    libraries[_LIBRARY] = "\n".join(defined).encode()
    text = f"mtllib {_LIBRARY}\n" + _LIBRARIES.sub("", text)
    return trimesh.load_scene(io.BytesIO(text.encode()), file_type="obj", resolver=files, process=False)


def _sources(path: Path, text: str, files: Any) -> list[str]:
    """The texts of the material libraries."""
    found = []
    for line in _LIBRARIES.findall(text):
        whole = line.strip()
        for name in [whole] if whole.lower().count(".mtl") < 2 else whole.split():
            try:
                found.append(files.get(name).decode("utf-8", "replace"))
            except (OSError, ValueError):
                _say(path, f"the materials {name!r} cannot be read")
    return found


def _cleaned(path: Path, source: str, files: Any) -> str:
    lines, name, lost = [], "", []
    for line in source.splitlines():
        key, _, rest = line.strip().replace("\t", " ").partition(" ")
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            name = rest
        elif key == "map_kd":
            rest, options = _file_of(rest)
            lost += [f"{name}: map_Kd {option}" for option in options]
            if not _is_image(rest, files):
                lost.append(f"{name}: map_Kd {rest} (it cannot be read)")
                continue
        elif key in _UNUSED:
            lost.append(f"{name}: {key}")
            continue
        else:
            words = rest.partition("#")[0].split()
            if key in ("kd", "ke") and (words[:1] in (["xyz"], ["spectral"]) or not words):
                lost.append(f"{name}: {' '.join([key, *words])}")
                continue
            rest = " ".join(words * 3 if key in ("kd", "ke") and len(words) == 1 else words)
        if rest and not key.startswith("#"):
            lines.append(f"{key} {rest}")
    if lost:
        _say(path, f"not used of its materials: {', '.join(dict.fromkeys(lost))}")
    return "\n".join(lines)


def _file_of(statement: str) -> tuple[str, list[str]]:
    """The file's name behind the options of a texture, and what these ask for."""
    words, found = statement, []
    while words.startswith("-"):
        option, _, words = words.partition(" ")
        if option.lower() not in _OPTIONS:
            return statement, found
        found.append(option)
        for _ in range(_OPTIONS[option.lower()]):
            value, _, rest = words.lstrip().partition(" ")
            if _OPTIONS[option.lower()] == 3 and not re.fullmatch(r"[-+.0-9eE]+", value):
                break
            words = rest
        words = words.lstrip()
    return words, found


def _is_image(name: str, files: Any) -> bool:
    from PIL import Image

    try:
        Image.open(io.BytesIO(files.get(name)))
    except (OSError, ValueError):
        return False
    return True


def _say(path: Path, text: str) -> None:
    warnings.warn(f"{path}: {text}", SubstitutionWarning, stacklevel=4)
