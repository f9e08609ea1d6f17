"""What tutorials have in common as programs: options that count, or replace a size's settings, and how a run ends."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def at_least_one(text: str) -> int:
    """The type of options that count something."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return number


def given(options: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Those of these options that stand in the command line, by name; one that does not is None."""
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


@contextmanager
def reported(parser: argparse.ArgumentParser, what: str, folder: Path) -> Iterator[None]:
    """Around a run: at its end says where `what` it made lies, and the seconds it took. A ValueError, such as that of a
    checkpoint of other settings, ends the program as a wrong option does, with its message and status 2."""
    start = time.perf_counter()
    try:
        yield
    except ValueError as error:
        parser.error(str(error))
    print(f"{what} are in {folder}; {time.perf_counter() - start:.1f} s")
