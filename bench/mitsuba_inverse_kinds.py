"""Mitsuba's half of the inverse problems whose unknowns are not parameters of the scene.

They do what its tutorials on poses, on shapes and on caustics do.
"""

from __future__ import annotations

import math

from inverse_loop import Grids, Loop, kind_of
from mitsuba_caustics import Caustics
from mitsuba_inverse import MitsubaLoop


class Projective(MitsubaLoop):
    """Of a mesh that moves. A setting's integrator has besides its own entries "seeds", from which guiding starts."""

    def __init__(self, mi, dr, folder: str) -> None:
        super().__init__(mi, dr, folder)
        self.name = f"{self.task['moved']}.vertex_positions"

    def _integrator(self):
        setting = self.setting
        entries = {**self.task["integrator"], **setting.get("integrator", {})}
        seeds = entries.pop("seeds", None)
        counts = {"sppc": setting["spp_grad"], "sppp": setting["spp_seen"], "sppi": setting["spp_shadows"]}
        made = self.mi.load_dict({**entries, **counts})
        # `render` hands its own number of samples on, which would take the place of these three.
        made.override_spp = lambda own, *_: own
        made.sample_border_warning = False  # the box filter has no border
        if seeds:
            made.proj_seed_spp = seeds
        return made

    def _set_rates(self, rate: float) -> None:
        self.optimiser.set_learning_rate(rate)

    def _constrain(self) -> None:
        pass

    def _place(self) -> None:
        self.params[self.name] = self.dr.ravel(self._moved())
        self.params.update()

    def _moved(self):
        """Positions, which depend on the optimiser's variables."""
        raise NotImplementedError


class MitsubaPose(Projective):
    """Six numbers, which move a mesh."""

    def _register(self) -> None:
        mi, dr = self.mi, self.dr
        if not hasattr(self, "still"):
            self.still = dr.detach(dr.unravel(mi.Point3f, mi.Float(self.params[self.name])))
            dr.eval(self.still)
        for name, values in {"turn": self.start["pose"][:3], "shift": self.start["pose"][3:]}.items():
            self.optimiser[name] = mi.Vector3f(*values.tolist())

    def _moved(self):
        turn, shift = self.optimiser["turn"], self.optimiser["shift"]
        motion = self.mi.Transform4f().translate(shift)
        for axis, angle in zip(([1, 0, 0], [0, 1, 0], [0, 0, 1]), (turn.x, turn.y, turn.z)):
            motion = motion.rotate(axis, angle * (180 / math.pi))
        return motion @ self.still

    def _values(self) -> dict:
        import numpy as np

        return {"pose": np.concatenate([np.array(self.optimiser[name]).ravel() for name in ("turn", "shift")])}


class MitsubaMesh(Projective):
    """Vertices in large steps (`mi.ad.LargeSteps`)."""

    uniform = True

    def _register(self) -> None:
        mi = self.mi
        vertices = mi.Float(self.start[self.name].ravel())
        faces = self.params[self.name.replace("vertex_positions", "faces")]
        self.large_steps = mi.ad.LargeSteps(vertices, faces, self.setting["smoothness"])
        self.optimiser["u"] = self.large_steps.to_differential(vertices)

    def _place(self) -> None:
        self.params[self.name] = self.large_steps.from_differential(self.optimiser["u"])
        self.params.update()

    def _loss(self, view: int, seed: int):
        views = self._views()
        seeds = [seed * len(self.targets) + i for i in range(len(views))]
        return sum(super(MitsubaMesh, self)._loss(*each) for each in zip(views, seeds)) / len(views)

    def _values(self) -> dict:
        import numpy as np

        return {self.name: np.array(self.params[self.name]).reshape(-1, 3)}


class MitsubaHeights(Grids, MitsubaLoop):
    """Heights coarse to fine, which move the vertices of a mesh; with a smoothness through large steps of the grid."""

    def _load(self, sampler: str) -> tuple:
        if sampler not in self.kept:
            plate = Caustics(self.mi, self.dr, str(self.folder), self.task["front"], sampler)
            self.kept[sampler] = (plate, plate.params)
        plate, params = self.kept[sampler]
        self.plate = plate
        return plate.scene, params

    def _integrator(self):
        return self.scene.integrator()

    def _first_picture(self, spp: int):
        scene, _ = self._load("independent")
        self.plate.place(self.plate.heights["data"])
        image = self.mi.render(scene, spp=4 * spp)
        return image / self.dr.mean(image, axis=None)

    def _register(self) -> None:
        import numpy as np

        start = self.start[self.task["unknowns"][0]["name"]]
        if np.any(start != start[0, 0]):
            raise ValueError("heights: expected flat ones, which are flat on the coarsest grid too")
        size = self.sizes[0]
        self._begin(self.mi.TensorXf(np.full((size, size, 1), start[0, 0])))

    def _begin(self, heights) -> None:
        """These heights, (n, n, 1), as what is optimised; momenta begin anew, as Mitsuba's optimisers do then."""
        self.smoothing = GridSteps(self.mi, self.dr, len(heights), self._lambda(len(heights)))
        self.optimiser["u"] = self.smoothing.to_differential(heights)

    def _heights(self):
        return self.smoothing.from_differential(self.optimiser["u"])

    def _set_rates(self, rate: float) -> None:
        self.optimiser.set_learning_rate(rate)

    def _step(self, view: int, seed: int, rate: float) -> None:
        size, now = self._size(), self.smoothing.size
        if size > now:
            factor = size // now
            self._begin(self.dr.upsample(self.dr.detach(self._heights()), scale_factor=(factor, factor, 1)))
            self._place()
        super()._step(view, seed, rate)

    def _place(self) -> None:
        self.plate.place(self._heights())

    def _loss(self, view: int, seed: int):
        dr, image = self.dr, self._picture(view, seed)
        return dr.mean(dr.square(image / dr.mean(dr.detach(image), axis=None) - self.plate.target), axis=None)

    def _constrain(self) -> None:
        dr = self.dr
        (low, high) = next(iter(self.bounds.values()))
        heights = dr.detach(self._heights())
        middle = (dr.max(heights, axis=None) + dr.min(heights, axis=None)) / 2
        self.optimiser["u"] = self.smoothing.to_differential(dr.clip(heights - middle, low, high))

    def _values(self) -> dict:
        import numpy as np

        name = self.task["unknowns"][0]["name"]
        heights, size = self.dr.detach(self._heights()), self.task["size"]
        factor = size // self.smoothing.size
        if factor > 1:
            heights = self.dr.upsample(heights, scale_factor=(factor, factor, 1))
        return {name: np.array(heights, dtype=np.float32).reshape(size, size)}


class GridSteps:
    """Large steps of a grid of (size, size, 1) numbers, by `mi.ad.LargeSteps` of a mesh of as many vertices.

    That takes three numbers a vertex; two of them are 0. With a lambda of 0 it changes nothing.
    """

    def __init__(self, mi, dr, size: int, smoothness: float) -> None:
        import numpy as np

        self.mi, self.dr, self.size, self.large_steps = mi, dr, size, None
        if not smoothness:
            return
        y, x = np.divmod(np.arange(size * size), size)
        vertices = np.stack([x, y, np.zeros_like(x)], 1).astype(np.float32)
        first = (size * np.arange(size - 1)[:, None] + np.arange(size - 1)).ravel()
        corners = [first, first + 1, first + size + 1, first, first + size + 1, first + size]
        faces = np.stack(corners, 1).astype(np.uint32)
        self.large_steps = mi.ad.LargeSteps(mi.Float(vertices.ravel()), mi.UInt32(faces.ravel()), smoothness)

    def to_differential(self, heights):
        if self.large_steps is None:
            return heights
        return self._tensor(self.large_steps.to_differential(self._points(heights)))

    def from_differential(self, u):
        if self.large_steps is None:
            return u
        return self._tensor(self.large_steps.from_differential(self._points(u)))

    def _points(self, values):
        return self.dr.ravel(self.mi.Point3f(values.array, 0, 0))

    def _tensor(self, flat):
        return self.mi.TensorXf(self.dr.unravel(self.mi.Point3f, flat).x, (self.size, self.size, 1))


def loop_of(mi, dr, folder: str) -> Loop:
    """The loop of a task's kind."""
    kinds = {"parameters": MitsubaLoop, "pose": MitsubaPose, "mesh": MitsubaMesh, "heights": MitsubaHeights}
    return kinds[kind_of(folder)](mi, dr, folder)
