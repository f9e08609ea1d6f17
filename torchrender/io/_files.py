"""What every reader and writer of files needs: checked paths and whole-file reads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def existing_file(path: str | os.PathLike[str]) -> Path:
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


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Whatever goes wrong inside is the file's fault: it ends in a ValueError or OSError that names the file.

    Readers say what they expected; this is for what a damaged file makes them, and the libraries below, stumble over.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, (ValueError, OSError)) and str(path) in str(error):
            raise
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        raise ValueError(f"{path}: the file is damaged, or too large ({kind}{error})") from error


def check_size(path: Path, claimed: int, ratio: int) -> None:
    """ValueError if a file claims to hold far more than its size allows.

    Args:
        claimed: bytes that its content would take.
        ratio: how many of these a byte of the file may stand for.
    """
    size = path.stat().st_size
    if claimed > (1 << 16) + ratio * size:
        raise ValueError(f"{path}: the file is truncated or damaged: {size} bytes cannot hold {claimed} bytes of data")


def writable_file(path: str | os.PathLike[str]) -> Path:
    """The path, if its folder exists and it is not a folder itself."""
    result = as_path(path)
    if not result.parent.is_dir():
        raise FileNotFoundError(f"path: no such folder: {result.parent}")
    if result.is_dir():
        raise IsADirectoryError(f"path: expected a file, got a folder: {result}")
    return result


def as_path(path: str | os.PathLike[str]) -> Path:
    """``Path(path)``, with an error that names the argument."""
    if not isinstance(path, (str, os.PathLike)) or isinstance(path, bytes):
        raise TypeError(f"path: expected a file name, got {type(path).__name__}")
    return Path(path)


def truncated(path: Path, expected: int, got: int) -> ValueError:
    """The error for a file that ends too early, sizes in bytes."""
    return ValueError(f"{path}: the file is truncated: expected {expected} bytes of data, got {got}")
