"""Run the programs for Mitsuba of docs/verification.md, and compare what they print with what the page says.

    python -m bench verification --peer mitsuba=PATH

They are the blocks that begin with an import of Mitsuba: the first is the beginning of all others, and each of these
is followed by its output. Numbers may differ by 2 %, and by 0.005, since pictures have noise; words may not.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from pathlib import Path

from .report import ROOT

PAGE = ROOT / "docs" / "verification.md"
BLOCK = re.compile(
    r"^```python\n((?:import \w+(?: as \w+)?\n)*import mitsuba.*?)^```\n(?:\n```text\n(.*?)^```$)?", re.M | re.S
)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
RELATIVE, ABSOLUTE = 0.02, 0.005


def programs(page: Path = PAGE) -> list[tuple[str, str]]:
    """The programs of the page, each with its beginning, and the output that the page has of it."""
    (beginning, _), *others = ((match[1], match[2]) for match in BLOCK.finditer(page.read_text()))
    return [(f"{beginning}\n{program}", output) for program, output in others]


def alike(printed: str, written: str) -> bool:
    """Whether two outputs have the same words, and numbers that are equal but for noise."""
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", written).split():
        return False
    pairs = zip(NUMBER.findall(printed), NUMBER.findall(written), strict=True)
    return all(abs(float(a) - float(b)) <= ABSOLUTE + RELATIVE * abs(float(b)) for a, b in pairs)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench verification", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peer", required=True, metavar="mitsuba=PATH", help="the interpreter that has Mitsuba")
    python = parser.parse_args(arguments).peer.removeprefix("mitsuba=")
    different = 0
    for program, written in programs():
        done = subprocess.run([python, "-c", program], capture_output=True, text=True)
        printed = done.stdout if done.returncode == 0 else done.stderr
        same = done.returncode == 0 and alike(printed, written)
        different += not same
        print(printed.rstrip() + ("" if same else f"\n    the page has:\n{written.rstrip()}"), end="\n\n", flush=True)
    return int(different > 0)
