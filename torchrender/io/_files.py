"""What every reader and writer of files needs: checked paths and whole-file reads."""

from __future__ import annotations

import os
from pathlib import Path


def existing_file(path: str | os.PathLike) -> Path:
    """The path, if a non-empty regular file is there.

    Raises:
        TypeError: if ``path`` is not a path.
        FileNotFoundError: if nothing is there.
        IsADirectoryError: if it is a folder.
        ValueError: if the file is empty.
    """
    result = as_path(path)
    if not result.exists():
        raise FileNotFoundError(f"path: no such file: {result}")
    if result.is_dir():
        raise IsADirectoryError(f"path: expected a file, got a folder: {result}")
    if result.stat().st_size == 0:
        raise ValueError(f"{result}: the file is empty")
    return result


def writable_file(path: str | os.PathLike) -> Path:
    """The path, if its folder exists and it is not a folder itself."""
    result = as_path(path)
    if not result.parent.is_dir():
        raise FileNotFoundError(f"path: no such folder: {result.parent}")
    if result.is_dir():
        raise IsADirectoryError(f"path: expected a file, got a folder: {result}")
    return result


def as_path(path: str | os.PathLike) -> Path:
    """``Path(path)``, with an error that names the argument."""
    if not isinstance(path, (str, os.PathLike)) or isinstance(path, bytes):
        raise TypeError(f"path: expected a file name, got {type(path).__name__}")
    return Path(path)


def truncated(path: Path, expected: int, got: int) -> ValueError:
    """The error for a file that ends too early, sizes in bytes."""
    return ValueError(f"{path}: the file is truncated: expected {expected} bytes of data, got {got}")
