"""What both halves of the inverse problems share: this module is also imported by the servers, in peers' environments.

A task is a folder:

    scene.xml       the scene that was photographed, with its cameras; its `$sampler` is free
    task.json       `unknowns`: list of {"name", "low", "high", "scale", "linear"}; `views`: list of {"sensor", "set"},
                    the places of lamps among others; `integrator`: the peers'; `kind`, see below
    start.npz       where each unknown begins
    targets.npy     the pictures, (views, H, W, 3), and weights.npy, by which differences are multiplied
    reference.npy   the first view's picture of the scene as it is in its file

Kinds say what the unknowns are, and what else is in `task.json`:

    parameters      of the scene
    pose            six numbers: turns about x, y and z, that about z first, in radians, and then a shift, of the mesh
                    `moved`
    mesh            vertices of the mesh `moved`, in large steps; Adam's steps have one length for all of them. In a
                    setting "views" is the number of pictures of a step, "smoothness" the lambda
    heights         `size` along a side, of a plate that throws a picture, see `Grids`. In place of the scene's file
                    there is what `mitsuba_caustics.py` reads, with the matrix `front`

A setting is a dict: "spp" and "spp_grad", samples a pixel of picture and derivative; "rate", Adam's, times the
unknown's `scale`; "halving", the iterations in which rates become half; "sampler"; of parameters of the scene "block",
for steps that look at one pixel of each square of so many pixels along a side, chosen by chance; where shapes move
"spp_seen" and "spp_shadows", samples a pixel of the outlines that the camera sees, and of others; others are the
programs' own.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

BETAS = (0.9, 0.99)  # of Adam: all programs'
EPSILON = 1e-15  # gradients of a mean by texels are tiny; its square must not be zero, which Mitsuba adds
WARMUP = 3  # steps at least that are made and forgotten: what is compiled, is compiled then


def kind_of(folder: str) -> str:
    """The kind of a task."""
    return json.loads((Path(folder) / "task.json").read_text())["kind"]


class Loop:
    """One program's optimisation: `_prepare`, `_step`, `_values` are the program's."""

    def __init__(self, folder: str) -> None:
        import numpy as np

        self.folder = Path(folder)
        self.task = json.loads((self.folder / "task.json").read_text())
        with np.load(self.folder / "start.npz") as start:
            self.start = {name: start[name] for name in start.files}
        self.targets, self.weights = (np.load(self.folder / f"{name}.npy") for name in ("targets", "weights"))
        self.corners: dict = {}  # of the squares of a setting's "block"
        self.iteration = 0

    @property
    def warmup(self) -> int:
        """Steps that are made and forgotten."""
        return WARMUP

    def begin(self, setting: dict, seed: int) -> dict:
        """Start values and a new optimiser; {"first": seconds that the steps before, which are forgotten, took}."""
        self.setting, self.seed = setting, seed
        start = time.perf_counter()
        self._prepare()
        self._steps(self.warmup)
        first = time.perf_counter() - start
        self._prepare()
        self.iteration = 0
        return {"first": first}

    def advance(self, steps: list[int], file: str) -> dict:
        """Makes so many steps, and then so many, ..., and saves the unknowns after each (numpy.savez, file + "0.npz").

        {"seconds": [of the steps alone, each time], "cpu": [the same of all threads on the processor]}.
        """
        import numpy as np

        spent: dict = {"seconds": [], "cpu": []}
        for number, count in enumerate(steps):
            start, cpu = time.perf_counter(), time.process_time()
            self._steps(count)
            spent["seconds"].append(time.perf_counter() - start)
            spent["cpu"].append(time.process_time() - cpu)
            np.savez(f"{file}{number}.npz", **self._values())
        return spent

    def _steps(self, count: int) -> None:
        for _ in range(count):
            rate = self.setting["rate"] * 0.5 ** (self.iteration / self.setting["halving"])
            self._step(self._view(), self.seed * 1_000_003 + self.iteration, rate)
            self.iteration += 1
        self._finish()

    def _view(self) -> int:
        """Which picture an iteration looks at: each once before any comes again."""
        return (self.iteration * self.task["stride"]) % len(self.targets)

    def _views(self) -> list[int]:
        """The same for as many pictures as a setting's "views"."""
        count = self.setting["views"]
        if count > len(self.targets):
            raise ValueError(f"views: expected at most {len(self.targets)}, got {count}")
        return [(self.iteration * count + i) * self.task["stride"] % len(self.targets) for i in range(count)]

    def _pixels(self, seed: int):
        """Of a picture, (N, 2), rows and columns, by a setting's "block"; None: all of them."""
        import numpy as np

        block = self.setting.get("block", 1)
        if block == 1:
            return None
        if block not in self.corners:
            sides = self.targets.shape[1:3]
            if any(n % block for n in sides):
                raise ValueError(f"block: expected a divisor of height and width, got {block}")
            rows, columns = np.meshgrid(*(np.arange(0, n, block) for n in sides), indexing="ij")
            self.corners[block] = np.stack([rows.ravel(), columns.ravel()], axis=-1)
        corners = self.corners[block]
        return corners + np.random.default_rng(seed).integers(block, size=corners.shape)

    def _prepare(self) -> None:
        raise NotImplementedError

    def _step(self, view: int, seed: int, rate: float) -> None:
        raise NotImplementedError

    def _finish(self) -> None:
        """Waits until all that was begun is done."""

    def _values(self) -> dict:
        raise NotImplementedError


class Grids(Loop):
    """Of the kind "heights": grids of `coarsest` numbers along a side at first, each then twice as fine as before.

    A setting's "grown" is the iteration with which the finest one begins; grid number k of n begins at the part
    (k / (n - 1))^2 of that. Its "smoothness" is the lambda of large steps for each height along the side of a pixel.
    """

    @property
    def sizes(self) -> list[int]:
        sizes = [self.task["size"]]
        while sizes[0] % 2 == 0 and sizes[0] // 2 >= self.task["coarsest"]:
            sizes.insert(0, sizes[0] // 2)
        return sizes

    def _size(self) -> int:
        """The grid of this iteration."""
        last = len(self.sizes) - 1
        begun = [self.iteration >= self.setting["grown"] * (k / last) ** 2 for k in range(1, last + 1)]
        return self.sizes[sum(begun)]

    def _lambda(self, size: int) -> float:
        return self.setting["smoothness"] * size / self.targets.shape[1]
