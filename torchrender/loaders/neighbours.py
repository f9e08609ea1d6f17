"""The files that a geometry file names: in its own folder and below, unless it is trusted."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import unquote


def files_of(path: Path, trusted: bool, more: dict[str, bytes] | None = None) -> Any:
    """A resolver for trimesh.

    Its ``get`` takes a name as it is or percent-encoded, as in glTF, with either kind of slash; where that is nowhere,
    a file of that name beside `path`. It raises ValueError for a name that leads elsewhere, and FileNotFoundError.

    Args:
        path: the file that names others.
        trusted: the names may lead anywhere.
        more: contents of further files by name.
    """
    from trimesh.resolvers import FilePathResolver

    folder = path.resolve().parent

    class Files(FilePathResolver):
        def get(self, name: str) -> bytes:
            if more and name in more:
                return more[name]
            plain = name.strip().replace("\\", "/")
            elsewhere = False
            for candidate in dict.fromkeys([name.strip(), plain, unquote(plain), plain.rpartition("/")[2]]):
                file = (folder / candidate).resolve()
                if not trusted and not file.is_relative_to(folder):
                    elsewhere = True
                elif file.is_file():
                    return file.read_bytes()
            if elsewhere:
                raise ValueError(f"the file {name!r} is outside of the folder of {path}; trusted=True allows that")
            raise FileNotFoundError(f"no such file: {folder / plain}")

    return Files(str(path))
