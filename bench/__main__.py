"""Command line of the benchmarks: `python -m bench table2 --mitsuba-python PATH`."""

from __future__ import annotations

import argparse

from .rows import ROWS


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    subparsers = parser.add_subparsers(dest="command", required=True)
    for name, text in (
        ("table2", "forward and backward time, warm, beside Mitsuba in alternating rounds"),
        ("startup", "import, loading, first gradient and peak memory, each in a fresh process"),
        ("gradients", "whether both programs find the same gradients, and how noisy one estimate is"),
        ("overhead", "what a call costs besides rendering (torchrender only; resolution and spp are 1)"),
    ):
        command = subparsers.add_parser(name, help=text, description=text)
        command.add_argument("--mitsuba-python", help="interpreter of an environment with mitsuba==3.9.1")
        command.add_argument("--threads", type=int, default=2, help="threads of both programs (default 2)")
        command.add_argument("--resolution", type=int, default=256, help="pixels along a side (default 256)")
        command.add_argument("--spp", type=int, default=16, help="samples a pixel, of both passes (default 16)")
        command.add_argument("--rounds", type=int, default=11, help="measured rounds (default 11)")
        command.add_argument("--warmup", type=int, default=3, help="rounds that do not count (default 3)")
        command.add_argument("--only", default="", help=f"rows whose name contains this; {[row.name for row in ROWS]}")
        command.add_argument("--json", help="also write the result to this file")
    options = parser.parse_args(argv)
    for name in ("threads", "resolution", "spp", "rounds"):
        if getattr(options, name) < 1:
            parser.error(f"--{name}: expected at least 1, got {getattr(options, name)}")
    from . import overhead, table2  # after the arguments are checked: this imports torch

    commands = {
        "table2": table2.run_table2,
        "startup": table2.run_startup,
        "gradients": table2.run_gradients,
        "overhead": overhead.run_overhead,
    }
    run = commands[options.command]
    table2.report(run(options), options.json)


if __name__ == "__main__":
    main()
