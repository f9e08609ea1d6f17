"""Reads damaged inputs of one kind, in a process that may crash: see `bench.fuzz`.

python -m bench.fuzz_worker KIND FIRST LAST SECONDS FOLDER
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

from .fuzz import DICT_KIND, MEMORY, SECONDS
from .fuzz_inputs import DICT, KINDS, damaged, damaged_dict

ADDRESS_SPACE = 4 << 30  # what reading may ask for at most, so that the machine lives on


class Memory:
    """Of this process, from files that stay open: most damaged files are read in less time than those are opened in."""

    def __init__(self) -> None:
        self._statm = os.open("/proc/self/statm", os.O_RDONLY)
        self._status = os.open("/proc/self/status", os.O_RDONLY)
        self._clear = os.open("/proc/self/clear_refs", os.O_WRONLY)

    def sizes(self) -> list[int]:
        """Bytes that have addresses, that are in memory, and others."""
        return [int(pages) * resource.getpagesize() for pages in os.pread(self._statm, 256, 0).split()]

    def forget_peak(self) -> None:
        """Begin to measure `peak` anew."""
        os.pwrite(self._clear, b"5", 0)

    def peak(self) -> int:
        """The most bytes that were in memory."""
        return int(os.pread(self._status, 4096, 0).partition(b"VmHWM:")[2].split(None, 1)[0]) * 1024


def origin(error: BaseException) -> str:
    """The line of this project that an exception came through last, for grouping."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "torchrender" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "elsewhere"


def verdict(error: Exception, names: list[str], kinds: tuple[type[Exception], ...]) -> str | None:
    """What is wrong with an exception; None for a clear one."""
    if not isinstance(error, kinds):
        return f"{type(error).__name__} at {origin(error)}: {str(error)[:80]}"
    if not any(name in str(error) for name in names):
        return f"no place in the message at {origin(error)}: {type(error).__name__}: {str(error)[:80]}"
    return None


def work(
    make: Callable[[int], tuple[Any, int, list[str]]],
    read: Callable[[Any], object],
    kinds: tuple[type[Exception], ...],
    first: int,
    last: int,
    seconds: float,
    folder: Path,
) -> None:
    """Read inputs `first` to before `last`, until `seconds` are over; what is found is printed as JSON, line by line.

    Args:
        make: an input by its number: what `read` is given, its size in bytes, and names of which an error has one.
        kinds: exceptions that are answers.
        folder: has ``progress``, the number of the input that is read, and at the end ``summary``.
    """
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    memory = Memory()
    resource.setrlimit(resource.RLIMIT_AS, (memory.sizes()[0] + ADDRESS_SPACE, hard))
    progress = os.open(folder / "progress", os.O_WRONLY)
    counts = {"inputs": 0, "refused": 0}
    most = {"MB": 0.0, "ms": 0.0}
    end = time.monotonic() + seconds
    for number in range(first, last):
        if time.monotonic() > end:
            break
        made, size, names = make(number)
        os.pwrite(progress, b"%d" % number, 0)  # numbers grow, and so their digits
        memory.forget_peak()
        before, start = memory.sizes()[1], time.process_time()
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        what = None
        try:
            read(made)
        except Exception as error:
            counts["refused"] += 1
            what = verdict(error, names, kinds)
        signal.setitimer(signal.ITIMER_PROF, 0)
        counts["inputs"] += 1
        grown, elapsed = memory.peak() - before, time.process_time() - start
        most = {"MB": max(most["MB"], grown / 1e6), "ms": max(most["ms"], 1e3 * elapsed)}
        if grown > MEMORY[0] * size + MEMORY[1]:
            what = f"{grown >> 20} MiB for {size} bytes"
        if what is not None:
            print(json.dumps({"number": number, "what": what}), flush=True)
            if isinstance(made, Path):
                (folder / f"kept_{number}_{made.name}").write_bytes(made.read_bytes())
    (folder / "summary").write_text(json.dumps({"counts": counts, "most": most}))


def files(kind: str, folder: Path) -> Callable[[int], tuple[Path, int, list[str]]]:
    """Damaged files of a kind, by their numbers. The good one is read first, which imports what that takes."""
    known = KINDS[kind]
    path = folder / known.name
    known.write(path)
    good = path.read_bytes()
    if known.packed:
        path.write_bytes(known.packed(good))
    known.read(path)

    def make(number: int) -> tuple[Path, int, list[str]]:
        changed = damaged(good, np.random.default_rng([zlib.crc32(kind.encode()), number]), known.text)
        content = known.packed(changed) if known.packed else changed
        path.write_bytes(content)
        return path, len(content), [path.name, path.stem]

    return make


def dicts(number: int) -> tuple[dict[Any, Any], int, list[str]]:
    """Damaged scenes, by their numbers. An error names one of their objects, or the function."""
    made = damaged_dict(np.random.default_rng([zlib.crc32(DICT_KIND.encode()), number]))
    return made, 1 << 16, ["load_dict", "scene", *(str(key) for key in made)]


def main() -> None:
    kind, first, last, seconds, name = sys.argv[1:]
    folder = Path(name)
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    span = int(first), int(last), float(seconds), folder
    if kind == DICT_KIND:
        tr.load_dict(DICT)
        work(dicts, tr.load_dict, (ValueError, TypeError, OSError), *span)
    else:
        work(files(kind, folder), KINDS[kind].read, (ValueError, OSError), *span)


if __name__ == "__main__":
    main()
