"""One of the two programs of `python -m bench same`: renders every scene and writes what it finds, one file a scene.

    PYTHON bench/same_program.py '{"folder": ..., "tests": ..., "dtypes": [...], "only": ..., "quick": ...}'

Run by either state's interpreter; prints a line of JSON about itself, then one for each scene that is done. A file has
arrays by names like ``float64/rgb/own/reverse all/ball.radius``, and under ``said`` what was refused, in words.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

# From here on, so that torchrender is the environment's and all else this checkout's.
sys.path[0] = str(Path(__file__).resolve().parent.parent)

from bench.from_tests import use  # noqa: E402
from bench.report import version_of  # noqa: E402
from bench.same_rendering import Found, Rendering  # noqa: E402

SPP, SEED = 4, 5
AOVS = ("depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "duv_dx", "duv_dy", "albedo")


def refusals(scene: tr.Scene) -> dict[str, str]:
    """Why parameters have no derivative, by the scene's own integrator."""
    found = {}
    for name, _ in scene.named_parameters():
        try:
            scene.train_only(name)
        except tr.NotDifferentiableError as error:
            found[name] = f"{type(error).__name__}: {error}"
    scene.train_only()
    return found


def integrators(case: Any, quick: bool) -> Iterator[tuple[str, Callable[[], Any]]]:
    """The ways to render a scene, by name: what makes an integrator, or None for the scene's own."""
    yield "own", case.integrator or (lambda: None)
    if not case.others or quick:
        return
    if case.integrator:
        yield "path", lambda: tr.PathTracer(max_depth=4, rr_depth=2)
    else:
        yield "wavefront", lambda: tr.WavefrontPathTracer(max_depth=3, rr_depth=2)
    yield "direct", lambda: tr.DirectIllumination(emitter_samples=2, bsdf_samples=1)
    yield "volpath", lambda: tr.VolumetricPathTracer(max_depth=4, rr_depth=2)
    yield "ptracer", lambda: tr.ParticleTracer(max_depth=4, rr_depth=2)
    yield "aov", lambda: tr.AOV(",".join(f"{name}:{name}" for name in AOVS), tr.PathTracer(max_depth=2))


def examine(case: Any, dtypes: list[str], quick: bool) -> Found:
    """All that is found of a scene."""
    found, refused = Found(), None
    for variant in case.variants[:1] if quick else case.variants:
        for dtype in dtypes:
            prefix = f"{dtype}/{variant}"
            kind = {"variant": variant, "dtype": getattr(torch, dtype)}
            torch.manual_seed(0)  # some scenes of the tests draw numbers
            scene = found.attempt("scene", lambda kind=kind: tr.load_dict(case.make(), **kind))
            if scene is None:
                return found
            refused = refusals(scene) if refused is None else refused
            sensor = {"sensor": list(range(case.sensors))} if case.sensors > 1 else {}
            settings = {name: torch.tensor(v) if name == "pixels" else v for name, v in case.settings.items()}
            # by name: states differ in the sampler that is taken when nothing is said
            settings = {"spp": SPP, "seed": SEED, "sampler": "independent", **sensor, **settings}
            for name, make in integrators(case, quick):
                settings["integrator"] = found.attempt(f"{prefix}/{name}/image", make)
                if f"{prefix}/{name}/image" in found.said:
                    continue
                rendering = Rendering(found, f"{prefix}/{name}", scene, refused, settings)
                if rendering.image():
                    rendering.derivatives(parts=name == "own")
                    if name == "own":
                        more(case, rendering, prefix, numbers=dtype == "float32" and not quick)
    return found


def more(case: Any, own: Rendering, prefix: str, numbers: bool) -> None:
    """What is found by the scene's own integrator only: first hits, rays from around, and numbers besides packets."""
    if case.integrator is None and not case.settings:
        own.first_hits()
    if case.others:
        own.like(f"{prefix}/queries").queries()
    backends, render = tr.backends, sys.modules["torchrender.render"]
    module = backends if hasattr(backends, "PACKETS") else render  # where older states have it
    if numbers and hasattr(module, "PACKETS"):
        module.PACKETS = False
        single = own.like(f"{prefix}/numbers")
        if single.image():
            single.reverse("all", list(single.values))
            single.forward()
        module.PACKETS = True


def main() -> None:
    options = json.loads(sys.argv[1])
    torch.set_num_threads(1)
    use(Path(options["tests"]))
    from bench.same_scenes import cases

    warnings.simplefilter("ignore")  # of missing terms and samples that are not finite: both programs have them
    chosen, lost = cases(options["only"])
    print(json.dumps({"version": version_of(tr), "scenes": [c.name for c in chosen], "lost": lost}), flush=True)
    for number, case in enumerate(chosen):
        found = examine(case, options["dtypes"], options["quick"])
        file = Path(options["folder"]) / f"{number}.npz"
        np.savez(file, said=np.array(json.dumps(found.said)), **found.arrays)
        print(json.dumps({"scene": case.name, "file": str(file)}), flush=True)


if __name__ == "__main__":
    main()
