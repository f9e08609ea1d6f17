"""Mitsuba's half of the benchmarks. Runs in Mitsuba's own environment, where torchrender is not installed.

The protocol is in `serving.py`. The environment variable MITSUBA_VARIANT names another variant than llvm_ad_rgb.
"""

from __future__ import annotations

import os
import time

from serving import serve, weight_of  # beside this script


class Server:
    def __init__(self, threads: int) -> None:
        started = time.perf_counter()
        import drjit as dr
        import mitsuba as mi

        self.variant = os.environ.get("MITSUBA_VARIANT", "llvm_ad_rgb")
        mi.set_variant(self.variant)
        dr.set_thread_count(threads)
        self.import_seconds = time.perf_counter() - started
        self.mi, self.dr, self.version = mi, dr, mi.__version__

    def load(
        self,
        path: str,
        arguments: dict,
        parameters: list,
        resolution: int | None,
        spp: int,
        arrays: str | None,
        integrator: dict | None = None,
        variant: str | None = None,
    ) -> dict:
        mi, dr = self.mi, self.dr
        mi.set_variant(variant or self.variant)
        # Without `optimize=False` surfaces of equal values are merged into one and lose their parameter names.
        if resolution is not None:
            arguments = {"resolution": resolution, "spp": spp, **arguments}
        self.scene = mi.load_file(path, optimize=False, **arguments)
        self.integrator = mi.load_dict(integrator or {"type": "prb", "max_depth": 5, "rr_depth": 100})
        self.params = mi.traverse(self.scene)
        self.names, self.spp = parameters, spp
        for name in parameters:
            value = type(self.params[name])(self.params[name])
            dr.enable_grad(value)
            self.params[name] = value
        self.params.update()
        return {"loaded": True}

    def _image_alone(self, seed: int, spp: int):
        """An image without derivatives, and the seconds it took."""
        mi, dr = self.mi, self.dr
        dr.sync_thread()
        start = time.perf_counter()
        with dr.suspend_grad():
            image = mi.render(self.scene, integrator=self.integrator, spp=spp, seed=2 * seed)
            dr.eval(image)
        dr.sync_thread()
        return image, time.perf_counter() - start

    def forward(self, seed: int) -> dict:
        return {"forward": self._image_alone(seed, self.spp)[1]}

    def _clear(self) -> None:
        for name in self.names:
            self.dr.set_grad(self.params[name], 0)

    def _both_passes(self, **settings) -> tuple:
        """Image, gradients (added to what is there) and the seconds of both passes, of the mean square of the image."""
        mi, dr = self.mi, self.dr
        dr.sync_thread()
        start = time.perf_counter()
        image = mi.render(self.scene, self.params, integrator=self.integrator, **settings)
        dr.eval(image)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.backward(dr.mean(dr.square(image), axis=None))
        gradients = [dr.grad(self.params[name]) for name in self.names]
        dr.eval(gradients)
        dr.sync_thread()
        return image, gradients, middle - start, time.perf_counter() - middle

    def step(self, seed: int) -> dict:
        dr = self.dr
        self._clear()
        _, gradients, forward, backward = self._both_passes(spp=self.spp, seed=2 * seed, seed_grad=2 * seed + 1)
        size = sum(float(dr.sum(dr.abs(gradient), axis=None).array[0]) for gradient in map(self._tensor, gradients))
        if not size > 0:
            raise RuntimeError(f"no gradient reached {', '.join(self.names)}")
        return {"forward": forward, "backward": backward}

    def _tensor(self, value):
        """A colour or tensor as one flat tensor."""
        mi, dr = self.mi, self.dr
        return mi.TensorXf(value.array if isinstance(value, mi.TensorXf) else dr.ravel(value))

    def image(self, seed: int, spp: int, file: str) -> dict:
        import numpy as np

        image, seconds = self._image_alone(seed, spp)
        np.save(file, np.array(image))
        return {"seconds": seconds}

    def gradient(self, seed: int, spp: int, file: str | None = None) -> dict:
        import numpy as np

        mi, dr = self.mi, self.dr
        self._clear()
        width, height = self.scene.sensors()[0].film().size()
        weight = mi.TensorXf(weight_of(height, width, np))
        start = time.perf_counter()
        seeds = {"seed": 2 * seed, "seed_grad": 2 * seed + 1}
        image = mi.render(self.scene, self.params, integrator=self.integrator, spp=1, spp_grad=spp, **seeds)
        dr.backward(dr.mean(image * weight, axis=None))
        gradients = [dr.grad(self.params[name]) for name in self.names]
        dr.eval(gradients)
        dr.sync_thread()
        seconds = time.perf_counter() - start
        arrays = [np.array(g, dtype=np.float64) for g in gradients]
        if file:
            np.savez(file, *[a if a.ndim >= 3 else a.ravel() for a in arrays])
        return {"sums": [float(a.sum()) for a in arrays], "seconds": seconds}

    def iteration(self, seed: int, views: list, spp: int, spp_grad: int, passes: int) -> dict:
        """Pictures of several sensors and their derivatives, in passes whose gradients add up."""
        self._clear()
        answer = {"forward": 0.0, "backward": 0.0, "bad image": 0, "bad gradient": 0}
        for number, view in enumerate(views * passes):
            n = seed * len(views) * passes + number
            image, gradients, forward, backward = self._both_passes(
                sensor=view, spp=spp, spp_grad=spp_grad, seed=2 * n, seed_grad=2 * n + 1
            )
            answer["forward"] += forward
            answer["backward"] += backward
            answer["bad image"] += self._not_finite(image) // 3
        answer["bad gradient"] = sum(self._not_finite(self._tensor(gradient)) for gradient in gradients)
        return answer

    def load_caustics(self, folder: str, front: list) -> dict:
        from mitsuba_caustics import Caustics

        self.plate = Caustics(self.mi, self.dr, folder, front)
        return {"loaded": True}

    def caustics(self, seed: int, spp: int, spp_grad: int) -> dict:
        return self.plate.iteration(seed, spp, spp_grad)

    def load_inverse(self, folder: str) -> dict:
        from mitsuba_inverse_kinds import loop_of

        self.inverse = loop_of(self.mi, self.dr, folder)
        return self.inverse.difference(spp=64)

    def begin_inverse(self, setting: dict, seed: int) -> dict:
        return self.inverse.begin(setting, seed)

    def advance_inverse(self, steps: list[int], file: str) -> dict:
        return self.inverse.advance(steps, file)

    def load_moved(self, direction: list) -> dict:
        from mitsuba_visibility import Moved

        (name,) = self.names
        self.moved = Moved(self.mi, self.dr, self.scene, self.params, name, direction)
        return {"loaded": True}

    def derivative(self, seed: int, **settings) -> dict:
        return self.moved.derivative(seed, **settings)

    def _not_finite(self, tensor) -> int:
        return int(self.dr.count(~self.dr.isfinite(tensor.array))[0])

    def loss_gradient(self, seed: int, values: str, target: str, view: int, spp: int, spp_grad: int, file: str) -> dict:
        """The gradient of the mean squared difference of one picture by new values of the one parameter."""
        import numpy as np

        mi, dr = self.mi, self.dr
        (name,) = self.names
        value, wanted = mi.TensorXf(np.load(values)), mi.TensorXf(np.load(target))
        dr.eval(value, wanted)
        dr.sync_thread()
        start = time.perf_counter()
        dr.enable_grad(value)
        self.params[name] = value
        self.params.update()
        seeds = {"seed": 2 * seed, "seed_grad": 2 * seed + 1}
        image = mi.render(
            self.scene, self.params, sensor=view, integrator=self.integrator, spp=spp, spp_grad=spp_grad, **seeds
        )
        dr.backward(dr.mean(dr.square(image - wanted), axis=None))
        gradient = dr.grad(self.params[name])
        dr.eval(gradient)
        dr.sync_thread()
        seconds = time.perf_counter() - start
        np.save(file, np.array(gradient))
        return {"seconds": seconds}


if __name__ == "__main__":
    serve(Server)
