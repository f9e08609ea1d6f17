"""``python -m torchrender.cuda check --out FILE``: whether images on this machine's card are those of the CPU.

``python -m torchrender.cuda compile SCENE --for 90 --into FOLDER``: kernels of scenes for cards, ahead of time.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import torch

from ..loaders.dict import load_file
from .check import STEPS, check
from .compile import compile_kernels


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
    made = commands.add_parser("compile", help="compile the kernels of scenes for cards; neither is needed for it")
    made.add_argument("scenes", type=Path, nargs="+", metavar="SCENE", help="a scene file")
    made.add_argument(
        "--for",
        type=int,
        nargs="+",
        required=True,
        dest="capabilities",
        metavar="CAPABILITY",
        help="compute capabilities without their points: 80 for an A100, 89 for an RTX 40, 90 for an H100",
    )
    made.add_argument(
        "--ptx",
        type=int,
        nargs="+",
        default=[],
        metavar="CAPABILITY",
        help="PTX besides, which drivers compile for cards of these and of later capabilities",
    )
    made.add_argument("--into", type=Path, required=True, help="a folder, which TORCHRENDER_KERNELS is to name")
    made.add_argument("--outputs", action="store_true", help="other outputs than images, such as depth, too")
    made.add_argument("--forward", action="store_true", help="forward-mode derivatives, too")
    made.add_argument("--deterministic", action="store_true", help="deterministic gradients, too")
    made.add_argument("--no-edges", action="store_false", dest="edges", help="without those of edges that move")
    made.add_argument("--double", action="store_true", help="in double precision, in place of single")
    options = parser.parse_args()
    if options.command == "compile":
        return compile_all(options)
    return 0 if check(f"cuda:{options.card}", options.out, options.scenes, options.commit, options.only) else 1


def compile_all(options: argparse.Namespace) -> int:
    """The kernels of all scenes for all cards; 1 after the first that cannot be compiled."""
    for path in options.scenes:
        for ptx, capability in [*((False, c) for c in options.capabilities), *((True, c) for c in options.ptx)]:
            begin, told = time.perf_counter(), f"{path}, {'compute' if ptx else 'sm'}_{capability}"
            settings = {name: getattr(options, name) for name in ("outputs", "forward", "deterministic", "edges")}
            try:
                scene = load_file(path, dtype=torch.float64 if options.double else torch.float32)
                new = compile_kernels(scene, capability, options.into, ptx=ptx, **settings)
            except (OSError, RuntimeError, ValueError) as error:
                print(f"{told}: {error}", file=sys.stderr)
                return 1
            print(f"{told}: {new} new kernels, {time.perf_counter() - begin:.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
