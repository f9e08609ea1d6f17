"""Options of the command line that several benchmarks have."""

from __future__ import annotations

import argparse
import ast
from pathlib import Path
from typing import Any

from .peers import parse

PICTURES = (".png", ".pdf", ".svg")


def positive(text: str) -> int:
    """An integer of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, got {value}")
    return value


def natural(text: str) -> int:
    """An integer of at least 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"expected at least 0, got {value}")
    return value


def _output(text: str) -> str:
    if not Path(text).absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"no such folder: {Path(text).parent}")
    if Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"expected a file, but {text} is a folder")
    return text


def _picture(text: str) -> str:
    if Path(text).suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f"expected a name that ends with {', '.join(PICTURES)}, got {text!r}")
    return _output(text)


class _Increasing(argparse.Action):
    """Several numbers, each once, the smallest first."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, _option: Any = None) -> None:
        setattr(namespace, self.dest, sorted(set(values)))


def _setting(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, got {text!r}")
    if name in ("outputs", "layout", "pixels", "crop"):
        raise argparse.ArgumentTypeError(f"{name}: benchmarks render whole images of radiance")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


def _peer(text: str) -> tuple[str, str]:
    try:
        return parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def common_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the benchmarks that render."""
    parser.add_argument("--threads", type=positive, default=2, help="threads of every program (default %(default)s)")
    parser.add_argument("--resolution", type=positive, default=256, help="pixels along a side (default %(default)s)")
    parser.add_argument(
        "--spp", type=positive, default=16, help="samples a pixel, of both passes (default %(default)s)"
    )
    parser.add_argument("--rounds", type=positive, default=11, help="measured rounds (default %(default)s)")
    parser.add_argument("--warmup", type=natural, default=3, help="rounds that do not count (default %(default)s)")
    parser.add_argument(
        "--set",
        dest="renderer",
        type=_setting,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a setting of torchrender.Renderer, such as correlated=True; several may be given",
    )
    parser.add_argument("--only", default="", help="only scenes whose name contains this")


def output_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that all benchmarks have."""
    parser.add_argument("--json", type=_output, metavar="FILE", help="also write the result to this file")
    parser.add_argument(
        "--plot", type=_picture, metavar="FILE", help="also draw it, as PNG, PDF or SVG (by matplotlib)"
    )


def counts_argument(parser: argparse.ArgumentParser, name: str, default: list[int], text: str) -> None:
    """An option that takes several numbers, which come sorted."""
    text = f"{text} (default {' '.join(map(str, default))})"
    parser.add_argument(name, type=positive, nargs="+", action=_Increasing, default=default, metavar="N", help=text)


def peer_argument(parser: argparse.ArgumentParser) -> None:
    """The option of the benchmarks that run other renderers beside this one."""
    parser.add_argument(
        "--peer",
        type=_peer,
        action="append",
        default=[],
        metavar="NAME=PYTHON",
        help="also measure mitsuba, redner or another state of torchrender, by the interpreter of an environment that "
        "has it; several may be given",
    )
