"""``python -m torchrender.cuda check --out FILE``: whether images on this machine's card are those of the CPU."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .check import STEPS, check


def main() -> int:
    """What the command returns: 0, or 1 if something differs."""
    parser = argparse.ArgumentParser(prog="python -m torchrender.cuda", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    of = commands.add_parser("check", help="compare a card with the CPU, in some minutes; 1 is returned if they differ")
    of.add_argument("--out", type=Path, required=True, help="a JSON file, which is written after every step")
    of.add_argument("--card", type=int, default=0, help="its number (default: 0)")
    of.add_argument("--scenes", type=Path, default=Path("scenes"), help="the repository's, which are timed if there")
    of.add_argument("--commit", default="", help="of the state that is checked, which the report names")
    of.add_argument("--only", nargs="+", choices=STEPS, default=STEPS, metavar="STEP", help=f"of {', '.join(STEPS)}")
    options = parser.parse_args()
    return 0 if check(f"cuda:{options.card}", options.out, options.scenes, options.commit, options.only) else 1


if __name__ == "__main__":
    sys.exit(main())
