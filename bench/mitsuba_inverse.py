"""Mitsuba's half of the inverse problems, for `mitsuba_server.py`, in Mitsuba's environment: `mi.ad.Adam`."""

from __future__ import annotations

import mitsuba_pixels
from inverse_loop import BETAS, EPSILON, WARMUP, Loop


class MitsubaLoop(Loop):
    """See `Loop`. A setting's "integrator" has entries of the integrator that differ from the task's.

    With "frozen" kernels of a step are recorded by `dr.freeze`, and what is done in Python for them is not done again.

    Of other kinds are its subclasses in `mitsuba_inverse_kinds.py`, which have other variables than the scene's.
    """

    uniform = False  # one length of Adam's steps for all entries

    def __init__(self, mi, dr, folder: str) -> None:
        super().__init__(folder)
        self.mi, self.dr = mi, dr
        self.images = [mi.TensorXf(target) for target in self.targets]
        self.weight = [mi.TensorXf(weight) for weight in self.weights]
        self.bounds = {u["name"]: (self._bound(u["low"]), self._bound(u["high"])) for u in self.task["unknowns"]}
        self.kept: dict = {}
        self.columns: dict = {}  # where the padded texels of an environment map come from

    def _bound(self, value):
        """A number, or numbers of channels as a tensor."""
        return self.mi.TensorXf(value, (1, 1, len(value))) if isinstance(value, list) else value

    def _load(self, sampler: str) -> tuple:
        """The scene with a sampler and its parameters, loaded once."""
        mi = self.mi
        if sampler not in self.kept:
            # Without `optimize=False` surfaces of equal values are merged into one and lose their parameter names.
            scene = mi.load_file(str(self.folder / "scene.xml"), sampler=sampler, optimize=False)
            self.kept[sampler] = (scene, mi.traverse(scene))
        return self.kept[sampler]

    def difference(self, spp: int, block: int = 8) -> dict:
        """How far a picture is from that of the same scene here: root mean square over blocks, relative."""
        import numpy as np

        image = np.array(self._first_picture(spp))[..., :3]
        rows, columns = (n // block for n in image.shape[:2])

        def blocks(picture):
            cut = picture[: rows * block, : columns * block].reshape(rows, block, columns, block, 3)
            return cut.mean((1, 3), dtype=np.float64)

        reference = blocks(np.load(self.folder / "reference.npy"))
        return {"difference": float(np.sqrt(((blocks(image) - reference) ** 2).mean() / (reference**2).mean()))}

    def _first_picture(self, spp: int):
        """The first view's, of the scene as it is in its file."""
        scene, params = self._load("independent")
        first = self.task["views"][0]
        self._set(params, first["set"])
        integrator = self.mi.load_dict(self.task["integrator"])
        return self.mi.render(scene, integrator=integrator, sensor=first["sensor"], spp=spp)

    def _prepare(self) -> None:
        self.scene, self.params = self._load(self.setting["sampler"])
        self.integrator = self._integrator()
        rates = {"beta_1": BETAS[0], "beta_2": BETAS[1], "epsilon": EPSILON}
        self.optimiser = self.mi.ad.Adam(lr=1.0, uniform=self.uniform, **rates)
        self._register()
        self._place()
        if self.setting.get("frozen"):
            self._freeze()

    @property
    def warmup(self) -> int:
        """A function is recorded for every camera."""
        return WARMUP + (len(self.task["views"]) if self.setting.get("frozen") else 0)

    def _integrator(self):
        entries = {**self.task["integrator"], **self.setting.get("integrator", {})}
        if self.setting.get("block", 1) > 1:
            if entries["type"] != "prb":
                raise ValueError(f"block: expected prb as the integrator, got {entries['type']}")
            mitsuba_pixels.register(self.mi, self.dr)
            entries["type"] = mitsuba_pixels.NAME
        return self.mi.load_dict(entries)

    def _register(self) -> None:
        """The start values as variables of the optimiser."""
        import numpy as np

        for unknown in self.task["unknowns"]:
            name = unknown["name"]
            start = self.start[name]
            self.optimiser[name] = self._native(self.params[name], start)
            if start.ndim == 3 and self.params[name].shape[1] == start.shape[1] + 2:
                index = np.arange(start.size, dtype=np.uint32).reshape(start.shape)
                self.columns[name] = self.mi.UInt32(np.concatenate([index[:, -1:], index, index[:, :1]], 1).ravel())

    def _place(self) -> None:
        """The optimiser's values in the scene. Environment maps have a column more on both sides there."""
        mi, dr = self.mi, self.dr
        for unknown in self.task["unknowns"]:
            name = unknown["name"]
            value = self.optimiser[name]
            if name in self.columns:
                height, width, channels = value.shape
                value = mi.TensorXf(dr.gather(mi.Float, value.array, self.columns[name]), (height, width + 2, channels))
            self.params[name] = value
        self.params.update()

    def _native(self, like, value):
        """An array as the type that a parameter has."""
        mi = self.mi
        if isinstance(like, mi.TensorXf):
            return mi.TensorXf(value)
        return type(like)(value.tolist())

    def _set(self, params, values: dict) -> None:
        for name, value in values.items():
            params[name] = type(params[name])(value)
        if values:
            params.update()

    def _step(self, view: int, seed: int, rate: float) -> None:
        self._set_rates(rate)
        if self.setting.get("frozen"):
            self._differentiate_frozen(view, seed)
        else:
            self.dr.backward(self._loss(view, seed))
        self.optimiser.step()
        self._constrain()
        if not self.setting.get("frozen"):
            self._place()

    def _differentiate_frozen(self, view: int, seed: int) -> None:
        """Gradients of the loss, by kernels that are recorded once and launched again: what is traced costs nothing."""
        mi, dr = self.mi, self.dr
        place, chosen = self.task["views"][view], self._chosen(seed)
        values = {unknown["name"]: dr.detach(self.optimiser[unknown["name"]]) for unknown in self.task["unknowns"]}
        self._set(self.params, place["set"])
        given = (values, self.images[view], self.weight[view], chosen, mi.UInt32(2 * seed))
        dr.make_opaque(given)
        for name, gradient in self.frozen(self.scene, self.few, place["sensor"], *given).items():
            dr.set_grad(self.optimiser[name], gradient)

    def _freeze(self) -> None:
        """Makes `frozen`, a function of scene, its `few` parameters, camera and what a step is given."""
        dr = self.dr
        if self.columns:
            raise ValueError("frozen: tables of an environment map, which choose directions, cannot be recorded")
        names = [unknown["name"] for unknown in self.task["unknowns"]]
        self.few = self.mi.traverse(self.scene)
        for name in names:
            self.few[name] = dr.detach(self.few[name])
        self.few.update()
        self.few.keep(names)

        def gradients(scene, params, sensor, values, target, weight, chosen, seed):
            dr.enable_grad(values)
            for name, value in values.items():
                params[name] = value
            params.update()
            self.integrator.chosen = chosen
            # the seed of the derivative follows from this one
            image = self._render(scene, params, sensor, seed=seed)
            dr.backward(self._difference(image, target, weight, chosen))
            self.integrator.chosen = None  # what a recording has made must not be freed in the next one
            return {name: dr.grad(value) for name, value in values.items()}

        self.frozen = dr.freeze(gradients)

    def _set_rates(self, rate: float) -> None:
        self.optimiser.set_learning_rate({u["name"]: rate * u["scale"] for u in self.task["unknowns"]})

    def _picture(self, view: int, seed: int):
        place = self.task["views"][view]
        self._set(self.params, place["set"])
        return self._render(self.scene, self.params, place["sensor"], seed=2 * seed, seed_grad=2 * seed + 1)

    def _render(self, scene, params, sensor, **seeds):
        counts = {name: self.setting[name] for name in ("spp", "spp_grad")}
        return self.mi.render(scene, params, integrator=self.integrator, sensor=sensor, **counts, **seeds)

    def _loss(self, view: int, seed: int):
        """What falls, of the picture of a view."""
        chosen = self._chosen(seed)
        if chosen is not None:
            self.integrator.chosen = chosen
        return self._difference(self._picture(view, seed), self.images[view], self.weight[view], chosen)

    def _chosen(self, seed: int):
        """Rows and columns of the pixels of a step; None: all of them."""
        pixels = self._pixels(seed)
        return None if pixels is None else tuple(self.mi.UInt32(numbers) for numbers in pixels.T)

    def _difference(self, image, target, weight, chosen):
        """The mean square of weighted differences, of all pixels or of the chosen rows and columns."""
        mi, dr = self.mi, self.dr
        if chosen is None:
            return dr.mean(dr.square((image - target) * weight), axis=None)
        row, column = chosen
        at = row * self.targets.shape[2] + column
        image, target, weight = (dr.gather(mi.Color3f, whole.array, at) for whole in (image, target, weight))
        return dr.mean(dr.mean(dr.square((image - target) * weight)))

    def _constrain(self) -> None:
        for unknown in self.task["unknowns"]:
            name = unknown["name"]
            self.optimiser[name] = self.dr.clip(self.optimiser[name], *self.bounds[name])

    def _finish(self) -> None:
        self.dr.eval(list(self.optimiser.values()))
        self.dr.sync_thread()

    def _values(self) -> dict:
        import numpy as np

        found = {}
        for unknown in self.task["unknowns"]:
            name = unknown["name"]
            found[name] = np.array(self.optimiser[name], dtype=np.float32).reshape(self.start[name].shape)
        return found
