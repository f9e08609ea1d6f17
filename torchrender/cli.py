"""The command ``torchrender``: render a scene file, say what is in it, convert it, compare and view images.

Errors are one sentence on standard error and status 1; wrong arguments have status 2, Ctrl-C 130, and ``compare``
ends with 1 where images differ by more than is allowed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import torch

from .typing import VariantName

VARIANTS = get_args(VariantName)

HDR = (".exr", ".hdr", ".pfm")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with these arguments, those of the process if None; returns the exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    warnings.showwarning = _say_warning
    try:
        status = options.run(options)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        print("torchrender: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read has seen enough, as in `torchrender info FILE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
        if os.environ.get("TORCHRENDER_TRACEBACK"):
            raise
        print(f"torchrender: {error}", file=sys.stderr)
        return 1


def _say_warning(message: Any, category: Any, *_: Any, **__: Any) -> None:
    print(f"torchrender: warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    from ._version import __version__

    parser = argparse.ArgumentParser("torchrender", description="Render scene files, and look at scenes and images.")
    parser.add_argument("--version", action="version", version=f"torchrender {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        made.set_defaults(run=run)
        return made

    render = command("render", _render, "render a scene file to an image")
    _scene_arguments(render)
    render.add_argument("-o", "--output", required=True, type=Path, help=".exr, .hdr, .pfm, .png or .jpg")
    render.add_argument("--spp", type=_positive, help="samples a pixel (default: the camera's own)")
    render.add_argument("--size", type=_size, metavar="WxH", help="pixels, such as 640x480 (default: the film's own)")
    render.add_argument("--seed", type=_integer, default=0, help="(default %(default)s)")
    render.add_argument("--integrator", help="path, volpath, ptracer, direct, ... (default: the scene's own)")
    render.add_argument("--sensor", help="index or name of a camera (default: the first)")
    render.add_argument(
        "--exposure", type=_number, default=0.0, help="of .png and .jpg, in stops (default %(default)g)"
    )
    _tonemap_argument(render)
    render.add_argument("--denoise", action="store_true", help="with Open Image Denoise (pip install pyoidn)")
    render.add_argument(
        "--on-interrupt",
        choices=("raise", "return"),
        default="raise",
        help="what Ctrl-C does: end without a picture, or write what is done, with status 130 (default %(default)s)",
    )
    render.add_argument("--quiet", action="store_true", help="no progress bar and no last line")

    info = command("info", _info, "say what is in a scene file")
    _scene_arguments(info)

    convert = command("convert", _convert, "convert glTF, OBJ, PLY or older XML to a Mitsuba 3 XML file")
    _scene_arguments(convert)
    convert.add_argument("-o", "--output", required=True, type=Path, help="an .xml file, beside which files are put")

    compare = command("compare", _compare, "compare two images")
    compare.add_argument("first", type=Path, help="an image")
    compare.add_argument("second", type=Path, help="an image of the same size, which errors are relative to")
    compare.add_argument("-o", "--output", type=Path, help="a picture of the differences in false colours, .png")
    compare.add_argument("--limit", type=_number, help="status 1 if the relative root mean square error is above this")

    view = command("view", _view, "write a PNG of an image with a high dynamic range, and say where it is")
    view.add_argument("image", type=Path, help="an image")
    view.add_argument("-o", "--output", type=Path, help="(default: beside the image, with .png for its ending)")
    view.add_argument("--exposure", type=_number, help="in stops (default: the 99th percentile becomes white)")
    _tonemap_argument(view)
    return parser


def _tonemap_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--tonemap",
        choices=("srgb", "filmic"),
        default="srgb",
        help="curve of .png and .jpg: filmic is Hable's (default %(default)s)",
    )


def _scene_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="Mitsuba XML, glTF, OBJ, PLY or STL")
    parser.add_argument(
        "-D", "--define", action="append", default=[], metavar="NAME=VALUE", help="value of $NAME in an XML file"
    )
    parser.add_argument("--variant", choices=VARIANTS, default="rgb", help="(default %(default)s)")
    parser.add_argument("--double", action="store_true", help="double precision")
    parser.add_argument("--substitute", action="store_true", help="replace what is not supported by something near it")
    parser.add_argument("--trusted", action="store_true", help="the file may name files outside of its folder")


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected an integer, got {text!r}") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, got {text!r}") from None


def _positive(text: str) -> int:
    number = _integer(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, got {text}")
    return number


def _size(text: str) -> tuple[int, int]:
    """WxH as (height, width)."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, such as 640x480, got {text!r}")
    return int(height), int(width)


def _load(options: argparse.Namespace) -> Any:
    import torchrender as tr

    defined = {}
    for text in options.define:
        name, separator, value = text.partition("=")
        if not (name and separator):
            raise ValueError(f"-D: expected NAME=VALUE, got {text!r}")
        defined[name] = value
    return tr.load_file(
        options.file,
        variant=options.variant,
        dtype=torch.float64 if options.double else torch.float32,
        unsupported="substitute" if options.substitute else "error",
        trusted=options.trusted,
        **defined,
    )


def _render(options: argparse.Namespace) -> int:
    import torchrender as tr

    from .interruption import interruption_of
    from .io.image import writable_image

    writable_image(options.output)  # before minutes of work
    if options.denoise:
        from .denoising import library

        library()
    scene = _load(options)
    sensor: Any = options.sensor or 0
    if isinstance(sensor, str) and sensor.lstrip("-").isdigit():
        sensor = int(sensor)
    interruption: Any = interruption_of(options.on_interrupt)
    began = time.perf_counter()
    names = ("rgb", "albedo", "shading_normal") if options.denoise else None
    with torch.no_grad():
        found: Any = tr.render(
            scene,
            sensor=sensor,
            spp=options.spp,
            size=options.size,
            seed=options.seed,
            integrator=options.integrator,
            outputs=names,
            progress=False if options.quiet else None,
            on_interrupt=interruption,
        )
        image = found if names is None else tr.denoise(found.rgb, albedo=found.albedo, normal=found.shading_normal)
    seconds = time.perf_counter() - began
    interruption.warn()
    _write(options, image, scene, sensor)
    if not options.quiet:
        print(f"{options.output}: {image.shape[1]} x {image.shape[0]} pixels, {seconds:.1f} s")
    return 130 if interruption.happened else 0


def _write(options: argparse.Namespace, image: torch.Tensor, scene: Any, sensor: Any) -> None:
    from . import io
    from .integrators import Stack
    from .render_sensors import chosen_sensors

    path: Path = options.output
    stokes = image.ndim == 4
    if path.suffix.lower() == ".exr":
        ((_, camera),), _ = chosen_sensors(scene.layout(), sensor)
        channels = camera.film.channels  # names of bands
        stacked = isinstance(scene.integrator, Stack) and image.shape[-1] not in (1, 3, 4)
        if channels is None and stacked and not stokes:  # further channels of aov and moment
            channels = scene.integrator.channel_names(scene.channels)
        io.write_image(path, image, channels=channels)
        return
    image = image[..., 0] if stokes else image  # the intensity
    if path.suffix.lower() in HDR:
        io.write_image(path, image)
        return
    io.write_image(path, image[..., :3] * 2.0**options.exposure, tonemap=options.tonemap)


def _info(options: argparse.Namespace) -> int:
    print(_load(options))
    return 0


def _convert(options: argparse.Namespace) -> int:
    scene = _load(options)
    scene.save(options.output)
    print(options.output)
    return 0


def _compare(options: argparse.Namespace) -> int:
    from . import io
    from .image import false_colors

    first, second = io.read_image(options.first), io.read_image(options.second)
    if first.shape != second.shape:
        raise ValueError(f"{options.first} is {tuple(first.shape)}, but {options.second} is {tuple(second.shape)}")
    difference = first.double() - second.double()
    rmse = float(difference.square().mean().sqrt())
    scale = float(second.double().square().mean().sqrt())
    relative = rmse / scale if scale > 0 else (0.0 if rmse == 0 else float("inf"))
    black = 0.01 * abs(float(second.double().mean()))  # keeps black pixels from counting without limit
    per_pixel = difference.square() / (second.double().square() + black**2 + 1e-12)
    peak = max(float(second.abs().max()), 1e-12)
    rows = {
        "largest difference": float(difference.abs().max()),
        "mean difference": float(difference.mean()),
        "root mean square error": rmse,
        "relative to the second": relative,
        "mean of relative squares": float(per_pixel.mean()),
        "PSNR dB": float("inf") if rmse == 0 else float(20 * torch.log10(torch.tensor(peak / rmse))),
    }
    size = difference.abs().amax(-1)
    if options.output is not None:
        io.write_image(options.output, false_colors((size / max(float(size.max()), 1e-30)).float()), raw=True)
    for name, value in rows.items():
        print(f"{name:26}{value:.6g}")
    if options.output is not None:
        print(f"{options.output}: black is 0, white {float(size.max()):.4g}")
    if options.limit is None or relative <= options.limit:
        return 0
    print(f"relative to the second {relative:.6g}: above the limit {options.limit:g}", file=sys.stderr)
    return 1


def _view(options: argparse.Namespace) -> int:
    from . import io

    image = io.read_image(options.image)[..., :3]
    exposure = options.exposure
    if exposure is None:
        finite = image[torch.isfinite(image)].double()
        white = float(torch.quantile(finite[:: max(1, finite.numel() // 1_000_000)], 0.99)) if finite.numel() else 1.0
        exposure = -float(torch.log2(torch.tensor(white))) if white > 0 else 0.0
    path = options.output or options.image.with_suffix(".png")
    if path == options.image:
        path = options.image.with_name(f"{options.image.stem}_view.png")
    io.write_image(path, torch.nan_to_num(image * 2.0**exposure), tonemap=options.tonemap)
    print(f"{path} (exposure {exposure:+.2f} stops)")
    return 0
