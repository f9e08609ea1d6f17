"""Mitsuba's half of the benchmark of what moves, for `mitsuba_server.py`, in Mitsuba's environment."""

from __future__ import annotations

import json
import time

from serving import weight_of


class Moved:
    """A scene in which one parameter moves, and its derivative by the integrators that have moving outlines.

    Args:
        mi, dr: the modules.
        scene, params: the scene, and what `mi.traverse` finds in it.
        name: the parameter.
        direction: in which it is moved, a matrix or positions of vertices.
    """

    def __init__(self, mi, dr, scene, params, name: str, direction: list) -> None:
        import numpy as np

        self.mi, self.dr = mi, dr
        self.scene, self.params, self.name = scene, params, name
        self.direction, self.matrix = direction, name.endswith("to_world")
        self.start = dr.detach(params[name])
        self.integrators: dict = {}
        width, height = scene.sensors()[0].film().size()
        weight = weight_of(height, width, np)
        self.weight = mi.TensorXf(weight / weight.size)
        dr.eval(self.start, self.weight)

    def _integrator(self, settings: dict, seeds: int):
        """An integrator, made once: octrees keep a threshold from call to call."""
        key = json.dumps([settings, seeds], sort_keys=True)
        if key not in self.integrators:
            made = self.mi.load_dict(settings)
            made.proj_seed_spp = seeds
            made.sample_border_warning = False  # the box filter has no border
            self.integrators[key] = made
        return self.integrators[key]

    def derivative(self, seed: int, settings: dict, seeds: int) -> dict:
        """The derivative of mean(image * weight) by the motion, and the seconds of an iteration that needs it.

        These are a new value of the parameter, an image of one sample, and the gradient. `settings` has the integrator
        with its numbers of samples `sppc`, `sppp` and `sppi`, which hold where none is given at run time; `seeds` is
        the number of samples a pixel that guiding starts from.
        """
        mi, dr = self.mi, self.dr
        integrator = self._integrator(settings, seeds)
        dr.sync_thread()
        start = time.perf_counter()
        value = type(self.start)(self.start)
        dr.enable_grad(value)
        self.params[self.name] = value
        self.params.update()
        with dr.suspend_grad():
            image = mi.render(self.scene, integrator=integrator, spp=1, seed=2 * seed)
            dr.eval(image)
        integrator.render_backward(self.scene, self.params, self.weight, sensor=0, seed=2 * seed + 1, spp=0)
        amount = mi.Float(0)
        dr.enable_grad(amount)
        moved = self._moved(amount)
        dr.set_grad(moved, dr.grad(self.params[self.name]))
        dr.enqueue(dr.ADMode.Backward, moved)
        dr.traverse(dr.ADMode.Backward)
        found = dr.grad(amount)
        dr.eval(found)
        dr.sync_thread()
        seconds = time.perf_counter() - start
        return {"derivative": float(found[0]), "seconds": seconds}

    def _moved(self, amount):
        """The parameter after a motion."""
        mi, dr = self.mi, self.dr
        if self.matrix:
            return mi.Transform4f().translate(amount * mi.Vector3f(self.direction)) @ self.start
        return self.start + amount * dr.tile(mi.Float(self.direction), dr.width(self.start) // 3)
