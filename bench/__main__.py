"""Benchmarks of torchrender: ``python -m bench`` lists them, ``python -m bench NAME --help`` says more."""

from __future__ import annotations

import argparse
import importlib
import sys

from .arguments import common_arguments, output_arguments
from .peers import PeerError

# Each is a module of this folder with `add_arguments(parser)` and `run(options) -> Result`.
BENCHMARKS = {
    "table2": "forward and backward time of five scenes, warm, beside Embree alone and beside peers",
    "images": "time of images, and with gradients, beside peers; on a card, too",
    "gradients": "whether all programs find the same gradients, and how noisy one estimate is",
    "overhead": "what a call costs besides rendering",
    "coldstart": "from a fresh process to the first gradient",
    "memory": "peak memory beyond gradients and gradient buffers, at several sample counts",
    "scaling": "time over samples, pixels, threads, triangles and texture sizes",
    "polarized": "time of polarised images and gradients, beside intensity and beside Mitsuba's images",
    "spectral": "time and noise of the spectral variant, beside rgb and beside Mitsuba's",
    "variance": "error of image and gradient at equal time, by sampler, against a reference",
    "materials": "forward and backward time of every BSDF, and whether all programs agree about it",
    "smoke": "one full-size iteration of the smoke, and what a reconstruction finds in a given time",
    "slab": "one full-size iteration of the translucent slab",
    "volume_gradients": "time, variance, bias and memory of gradients of a cloud's densities",
    "visibility": "derivatives by what moves: efficiency and bias of silhouettes, shadows and indirect light",
    "caustics": "one iteration of a refractive height field that throws a picture",
    "inverse": "inverse problems from start to result: seconds until pictures that were not fitted are right",
    "gradient_index": "rays through a medium whose index varies: time, memory, and PyTorch alone beside it",
    "distributed": "image and gradient by several processes: speed, bytes, a model of many machines",
    "endurance": "resident memory over a million steps with changing textures, vertices and scene edits",
    "fuzz": "damaged files of every kind: crashes, hangs, memory, and what errors say",
    "rays": "rays a second of Embree alone: camera, bounce and shadow rays, single and in packets",
    "build": "seconds of the compilers by file and module, wall time of the last build, sizes of the modules",
}
# Others, which have a result of their own: `main(arguments) -> status`.
COMMANDS = {
    "compare": "which figures became slower by more than their spread (compare A.json B.json)",
    "verification": "whether Mitsuba still differs as docs/verification.md says (--peer mitsuba=PATH)",
    "kills": "whether tutorials with checkpoints that are killed at random moments end with the same bits",
    "same": "whether another state of torchrender renders and differentiates everything alike",
}


def listing() -> str:
    """The list of benchmarks."""
    lines = [f"  {name:<18}{text}" for name, text in {**BENCHMARKS, **COMMANDS}.items()]
    return "\n".join(["python -m bench NAME [options], where NAME is one of", *lines])


def main(argv: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help", "list"):
        print(f"{__doc__}\n\n{listing()}")
        return 0
    name = argv[0]
    if name in COMMANDS:
        return importlib.import_module(f".{name}", __package__).main(argv[1:])
    if name not in BENCHMARKS:
        print(f"error: there is no benchmark {name!r}\n{listing()}", file=sys.stderr)
        return 2
    module = importlib.import_module(f".{name}", __package__)
    parser = argparse.ArgumentParser(
        prog=f"python -m bench {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if getattr(module, "RENDERS", True):
        common_arguments(parser)
    output_arguments(parser)
    module.add_arguments(parser)
    options = parser.parse_args(argv[1:])
    if options.plot:
        from .plots import draw, require_matplotlib

        try:
            require_matplotlib()
        except ImportError as error:
            parser.error(str(error))
    from . import report

    where = report.machine()
    try:
        result = module.run(options)
    except PeerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    settings = {key: value for key, value in vars(options).items() if key not in ("json", "plot", "peer", "directory")}
    document = report.to_json(name, result, settings, where)
    if options.json:
        report.save(options.json, document)
    report.show(document, result)
    if options.plot:
        draw(document, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
