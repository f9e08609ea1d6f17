"""The Mitsuba half of the benchmarks. Runs in Mitsuba's own environment, where torchrender is not installed.

Reads one JSON request a line from standard input and answers each with one JSON line:

    {"do": "load", "path": str, "arguments": {...}, "parameters": [...], "resolution": int, "spp": int}
    {"do": "step", "seed": int}      -> {"forward": seconds, "backward": seconds}
    {"do": "gradient", "seed": int}  -> {"sums": [...], "seconds": float}   gradient of mean(image * weight), see below
    {"do": "memory"}                 -> {"peak": MiB, "start": MiB}
    {"do": "quit"}

The first answer, before any request, is {"version": ...}.
"""

from __future__ import annotations

import json
import sys
import time


def peak_memory() -> float:
    """Peak resident memory of this process in MiB."""
    with open("/proc/self/status") as status:
        for line in status:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    raise RuntimeError("/proc/self/status has no VmHWM line")


def weight_of(height: int, width: int, np):
    """The weight of the scalar whose gradient is compared, (H, W, 3) float32; `np` is the numpy module."""
    x, y = 2 * np.pi * np.arange(width) / width, 2 * np.pi * np.arange(height) / height
    pattern = 1 + 0.5 * np.sin(x)[None, :] * np.cos(y)[:, None]
    return (pattern[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


class Server:
    def __init__(self, threads: int) -> None:
        self.start_memory = peak_memory()
        started = time.perf_counter()
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        dr.set_thread_count(threads)
        self.import_seconds = time.perf_counter() - started
        self.mi, self.dr = mi, dr

    def load(self, path: str, arguments: dict, parameters: list, resolution: int, spp: int) -> dict:
        mi, dr = self.mi, self.dr
        # Without `optimize=False` surfaces of equal values are merged into one and lose their parameter names.
        self.scene = mi.load_file(path, optimize=False, resolution=resolution, spp=spp, **arguments)
        self.integrator = mi.load_dict({"type": "prb", "max_depth": 5, "rr_depth": 100})
        self.params = mi.traverse(self.scene)
        self.names, self.spp = parameters, spp
        for name in parameters:
            value = type(self.params[name])(self.params[name])
            dr.enable_grad(value)
            self.params[name] = value
        self.params.update()
        return {"loaded": True}

    def step(self, seed: int) -> dict:
        mi, dr = self.mi, self.dr
        for name in self.names:
            dr.set_grad(self.params[name], 0)
        dr.sync_thread()
        start = time.perf_counter()
        image = mi.render(
            self.scene, self.params, integrator=self.integrator, spp=self.spp, seed=2 * seed, seed_grad=2 * seed + 1
        )
        dr.eval(image)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.backward(dr.mean(dr.square(image), axis=None))
        gradients = [dr.grad(self.params[name]) for name in self.names]
        dr.eval(gradients)
        dr.sync_thread()
        end = time.perf_counter()
        size = sum(float(dr.sum(dr.abs(gradient), axis=None).array[0]) for gradient in map(self._tensor, gradients))
        if not size > 0:
            raise RuntimeError(f"no gradient reached {', '.join(self.names)}")
        return {"forward": middle - start, "backward": end - middle}

    def _tensor(self, value):
        """A colour or tensor as one flat tensor."""
        mi, dr = self.mi, self.dr
        return mi.TensorXf(value.array if isinstance(value, mi.TensorXf) else dr.ravel(value))

    def gradient(self, seed: int) -> dict:
        """Sums over the entries of each parameter's gradient of mean(image * weight), a smooth weight."""
        import numpy as np

        mi, dr = self.mi, self.dr
        for name in self.names:
            dr.set_grad(self.params[name], 0)
        width, height = self.scene.sensors()[0].film().size()
        weight = mi.TensorXf(weight_of(height, width, np))
        start = time.perf_counter()
        seeds = {"seed": 2 * seed, "seed_grad": 2 * seed + 1}
        image = mi.render(self.scene, self.params, integrator=self.integrator, spp=1, spp_grad=self.spp, **seeds)
        dr.backward(dr.mean(image * weight, axis=None))
        gradients = [dr.grad(self.params[name]) for name in self.names]
        dr.eval(gradients)
        dr.sync_thread()
        seconds = time.perf_counter() - start
        return {"sums": [float(np.array(g, dtype=np.float64).sum()) for g in gradients], "seconds": seconds}

    def memory(self) -> dict:
        return {"peak": peak_memory(), "start": self.start_memory}


def main() -> None:
    # Mitsuba logs to standard output: keep a private copy of it for the answers and send the rest to standard error.
    import os

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    server = Server(int(sys.argv[1]))
    print(json.dumps({"version": server.mi.__version__, "import_seconds": server.import_seconds}), file=answers)
    for line in sys.stdin:
        request = json.loads(line)
        action = request.pop("do")
        if action == "quit":
            break
        try:
            actions = {"load": server.load, "step": server.step, "gradient": server.gradient, "memory": server.memory}
            answer = actions[action](**request)
        except Exception as error:  # the caller reports it in the table
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers)


if __name__ == "__main__":
    main()
