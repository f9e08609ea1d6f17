"""Another torchrender's half of the benchmarks: the state before a change, measured beside the one after it.

This file and what it imports of `bench/` and `scenes/` belong to the newer state and run in the environment of the
older one: they use the public interface of torchrender alone. The protocol is in `serving.py`. A second argument is
a dict of settings of `torchrender.Renderer`, those that this state gets, too.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from serving import serve  # beside this script

ROOT = Path(__file__).resolve().parent.parent


class Server:
    def __init__(self, threads: int) -> None:
        import torch

        torch.set_num_threads(threads)
        # A first backward pass starts torch's own machinery, as where the newer state is measured.
        torch.ones(3, requires_grad=True).square().sum().backward()
        started = time.perf_counter()
        import torchrender

        self.import_seconds = time.perf_counter() - started
        # From here on, so that torchrender is the environment's and all else this checkout's.
        sys.path[0] = str(ROOT)
        from bench.report import version_of

        self.tr, self.version = torchrender, version_of(torchrender)
        self.settings = json.loads(sys.argv[2]) if len(sys.argv) > 2 else {}

    def load(
        self,
        path: str,
        arguments: dict,
        parameters: list,
        resolution: int | None,
        spp: int,
        arrays: str | None,
        integrator: dict | None = None,
    ) -> dict:
        from bench.ours import Ours

        tr = self.tr
        if resolution is not None:
            arguments = {"resolution": resolution, "spp": spp, **arguments}
        settings = dict(self.settings)
        if integrator is not None:
            # Peers have an integrator of their own for derivatives in media; here it is the file's.
            depth = {name: integrator[name] for name in ("max_depth", "rr_depth")}
            settings = {"integrator": tr.PathTracer(**depth) if integrator["type"] == "prb" else None, **settings}
        self.ours = Ours(tr.load_file(path, **arguments), tuple(parameters), spp, **settings)
        self.names = parameters
        return {"loaded": True}

    def forward(self, seed: int) -> dict:
        return self.ours.forward(seed)

    def step(self, seed: int) -> dict:
        return self.ours.step(seed)

    def image(self, seed: int, spp: int, file: str) -> dict:
        import numpy as np

        image, seconds = self.ours.image(seed, spp)
        np.save(file, image)
        return {"seconds": seconds}

    def gradient(self, seed: int, spp: int, file: str | None = None) -> dict:
        import numpy as np

        gradients, seconds = self.ours.gradient(seed, spp)
        if file:
            np.savez(file, *gradients)
        return {"sums": [float(gradient.sum()) for gradient in gradients], "seconds": seconds}

    def iteration(self, seed: int, views: list, spp: int, spp_grad: int, passes: int) -> dict:
        from bench.media import iteration

        sensor = views if len(views) > 1 else views[0]
        return iteration(self.ours, seed, sensor=sensor, spp=spp, spp_grad=spp_grad, passes=passes)

    def loss_gradient(self, seed: int, values: str, target: str, view: int, spp: int, spp_grad: int, file: str) -> dict:
        import numpy as np
        import torch

        from bench.reconstruction import Recipe, gradient_of_ours

        recipe = Recipe(size=0, seconds=0, views=0, spp=spp, spp_grad=spp_grad)
        targets = {view: torch.from_numpy(np.load(target))}
        gradient = gradient_of_ours(self.ours, self.names[0], targets, recipe)
        found, seconds = gradient(torch.from_numpy(np.load(values)), view, seed)
        np.save(file, found.numpy())
        return {"seconds": seconds}

    def load_caustics(self, folder: str, front: list) -> dict:
        import numpy as np

        from bench.caustics import Plate

        size, resolution = (len(np.load(Path(folder) / f"{name}.npy")) for name in ("heights", "target"))
        self.plate = Plate(size, resolution, 1, **self.settings)
        return {"loaded": True}

    def caustics(self, seed: int, spp: int, spp_grad: int, passes: int = 1) -> dict:
        return self.plate.iteration(seed, spp=spp, spp_grad=spp_grad, passes=passes)

    def load_inverse(self, folder: str) -> dict:
        from bench.inverse_ours_kinds import loop_of

        self.inverse = loop_of(folder)
        return {"difference": 0.0}

    def begin_inverse(self, setting: dict, seed: int) -> dict:
        return self.inverse.begin(setting, seed)

    def advance_inverse(self, steps: list[int], file: str) -> dict:
        return self.inverse.advance(steps, file)

    def load_moved(self, name: str, resolution: int, spp: int) -> dict:
        import tempfile

        from bench.visibility_ours import Moved
        from bench.visibility_scenes import MOVING

        (moving,) = [moving for moving in MOVING if moving.name == name]
        with tempfile.TemporaryDirectory(prefix="bench-") as folder:
            self.moved = Moved(moving, Path(folder), resolution, spp, **self.settings)
        return {"loaded": True}

    def derivative(self, seed: int) -> dict:
        derivative, seconds = self.moved.derivative(seed)
        return {"derivative": derivative, "seconds": seconds}


if __name__ == "__main__":
    serve(Server)
