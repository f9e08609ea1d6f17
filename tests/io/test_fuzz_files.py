"""Damaged files of every kind end in a ValueError or OSError that names the file, with bounded memory and time.

A short form of ``python -m bench fuzz``, in this process: the first inputs of each kind. What is read nevertheless may
be anything: single bits of pixels do not show. And that the long form notices what it is to notice.
"""

from __future__ import annotations

import re
import resource
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import fresh_python
import numpy as np
import pytest
import torch

from bench import fuzz
from bench.fuzz import hunt
from bench.fuzz_inputs import KINDS
from bench.fuzz_worker import dicts, files, verdict
from bench.report import ROOT
from torchrender import load_dict

INPUTS = 120
MEMORY = 1 << 31  # bytes of address space that reading a damaged file of a few KB may take
SECONDS = 10.0  # of processor time, for one file; each takes milliseconds


@pytest.fixture
def bounded_memory():
    """Allocations beyond the limit fail."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(tmp_path, kind, bounded_memory):
    known = KINDS[kind]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        make = files(kind, tmp_path)  # reads a good one: that is accepted
        refused = 0
        for number in range(INPUTS):
            made, _, names = make(number)
            start = time.process_time()
            try:
                known.read(made)
            except (ValueError, OSError) as error:
                assert verdict(error, names, (ValueError, OSError)) is None, number
                refused += 1
            assert time.process_time() - start < SECONDS, number
    assert refused > (0 if kind == "mtl" else 5)  # of materials nearly everything is accepted, with warnings


def test_damaged_dicts():
    refused = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(INPUTS):
            made, _, names = dicts(number)
            try:
                load_dict(made)
            except (ValueError, TypeError, OSError) as error:
                assert verdict(error, names, (ValueError, TypeError, OSError)) is None, number
                refused += 1
    assert refused > INPUTS / 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"type": np.zeros((2, 2))}, "load_dict: type: expected a word, got a ndarray"),
        ({"ball": {"type": np.zeros((2, 2))}}, "ball.type: expected a word, got a ndarray"),
        (
            {"ball": {"type": "sphere", "bsdf": {"type": torch.zeros(3)}}},
            "ball.bsdf.type: expected a word, got a Tensor",
        ),
        ({"ball": {"type": "sphere", 3: 1.0}}, "ball: expected names, got 3 (int)"),
        (
            {"ball": {"type": "sphere", "bsdf": {"type": "conductor", "material": np.zeros((2, 2))}}},
            "ball.bsdf.material: the conductor",
        ),
        (
            {"camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": torch.zeros(2, 2)}}},
            "camera.film.width: expected an integer, got a Tensor of shape (2, 2)",
        ),
    ],
)
def test_arrays_and_numbers_in_the_place_of_words(change, message):
    """What `python -m bench fuzz --only dict` has found."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        load_dict({"type": "scene", **change})


FAULTY = """
import os, sys
from pathlib import Path
import numpy as np
from bench.fuzz_worker import work
kept = []
def make(number):
    path = Path(sys.argv[5]) / "a.bin"
    path.write_bytes(bytes([number]))
    return path, 1, ["a.bin"]
def read(path):
    number = path.read_bytes()[0]
    if number == 2: os.kill(os.getpid(), 11)
    if number == 3: raise IndexError("list index out of range")
    if number == 4: raise ValueError("wrong")
    if number == 5: kept.append(np.ones(100 << 20, np.uint8)); kept.clear()
    if number == 6:
        while True: pass
    if number == 7: raise ValueError("a.bin: wrong")
    if number == 10: sys.exit("no more")
work(make, read, (ValueError, OSError), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), Path(sys.argv[5]))
"""


@pytest.fixture
def faulty(tmp_path, monkeypatch):
    """The command of a worker that has every fault."""
    monkeypatch.setattr(fuzz, "subprocess", SimpleNamespace(run=fresh_python.interpreter))
    program = tmp_path / "faulty.py"
    program.write_text(f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n{FAULTY}")
    return [sys.executable, str(program)]


def test_what_is_wrong_is_found_and_kept(tmp_path, faulty):
    keep = tmp_path / "keep"
    found = hunt("faulty", 0, 9, None, keep, faulty)
    what = {report["number"]: report["what"] for report in found["found"]}
    assert what[2] == "crash: SIGSEGV"
    assert what[3].startswith("IndexError at") and what[4].startswith("no place in the message")
    assert what[5].endswith(" MiB for 1 bytes")
    assert what[6] == "more than 2 s"
    assert sorted(what) == [2, 3, 4, 5, 6] and found["counts"]["inputs"] == 9
    contents = sorted(file.read_bytes() for file in Path(keep).iterdir())
    assert contents == [bytes([number]) for number in (2, 3, 4, 5, 6)]


def test_what_was_found_outlives_a_worker_that_fails(faulty, capfd):
    found = hunt("faulty", 3, 20, None, None, faulty)
    what = {report["number"]: report["what"] for report in found["found"]}
    assert what[3].startswith("IndexError at") and what[6] == "more than 2 s"
    assert what[10] == "the worker failed, and the rest from 10 was not read"
    assert found["counts"]["inputs"] == 7
    assert "failed at 10:\nno more" in capfd.readouterr().err
