"""Mitsuba's half of the benchmark of caustics, for `mitsuba_server.py`, in Mitsuba's environment.

The plate's front is a mesh of (size, size) vertices, which a bitmap of as many heights moves along their normals in
every iteration, as Mitsuba's own tutorial does it: positions are assigned, and `update()` makes vertex normals, through
which it differentiates, and the acceleration structure anew.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path


class Caustics:
    """The scene with its lens, and what an iteration does.

    Args:
        mi, dr: the modules.
        folder: has `heights.npy`, as many as there are to be vertices, `target.npy`, the picture that is to be thrown,
            (H, W, 3), and `scene.json`, the dict of `scenes/make_caustics.py` without its front, matrices and texels as
            nested lists.
        front: the matrix of the front.
        sampler: of the film.
    """

    def __init__(self, mi, dr, folder: str, front: list, sampler: str = "independent") -> None:
        import numpy as np

        self.mi, self.dr = mi, dr
        given = Path(folder)
        scene = json.loads((given / "scene.json").read_text())
        scene["sensor"]["sampler"]["type"] = sampler
        heights, target = (np.load(given / f"{name}.npy") for name in ("heights", "target"))
        size = len(heights)
        with tempfile.TemporaryDirectory() as written:
            path = Path(written) / "lens.ply"
            self._grid(front, size).write_ply(str(path))
            glass = {"type": "ref", "id": "glass"}
            lens = {"type": "ply", "filename": str(path), "face_normals": False, "bsdf": glass}
            # Without `optimize=False` shapes are merged and lose their names. Objects come before what refers to them.
            described = {"type": "scene", "glass": scene["glass"], "lens": lens}
            described |= {key: self._native(value) for key, value in scene.items() if key not in ("type", "lens")}
            self.scene = mi.load_dict(described, optimize=False)
        self.params = mi.traverse(self.scene)
        data = mi.TensorXf(np.ascontiguousarray(heights[..., None]))
        self.texture = mi.load_dict({"type": "bitmap", "data": data, "raw": True, "wrap_mode": "clamp"})
        self.heights = mi.traverse(self.texture)
        self.positions = dr.unravel(mi.Point3f, self.params["lens.vertex_positions"])
        self.normals = dr.unravel(mi.Normal3f, self.params["lens.vertex_normals"])
        self.places = dr.zeros(mi.SurfaceInteraction3f, size * size)
        self.places.uv = dr.unravel(mi.Point2f, self.params["lens.vertex_texcoords"])
        self.target = mi.TensorXf(target)
        self.target /= dr.mean(self.target, axis=None)
        dr.eval(self.positions, self.normals, self.places, self.target)

    def _native(self, value):
        """Matrices and texels as Mitsuba's own types."""
        mi = self.mi
        if not isinstance(value, dict):
            return value
        made = {key: self._native(entry) for key, entry in value.items()}
        if "to_world" in made:
            made["to_world"] = mi.ScalarTransform4f(made["to_world"])
        if made.get("type") == "bitmap":
            made["data"] = mi.TensorXf(made["data"])
        return made

    def _grid(self, front: list, size: int):
        """A mesh over [-1, 1]^2 at z = 0, in the world."""
        mi, dr = self.mi, self.dr
        index = dr.arange(mi.UInt32, size * size)
        u, v = (mi.Float(part) / (size - 1) for part in (index % size, index // size))
        cell = dr.arange(mi.UInt32, (size - 1) ** 2)
        first = (cell // (size - 1)) * size + cell % (size - 1)
        corners = [first, first + 1, first + size + 1, first, first + size + 1, first + size]
        faces = dr.zeros(mi.UInt32, 6 * (size - 1) ** 2)
        for number, corner in enumerate(corners):
            dr.scatter(faces, corner, 6 * cell + number)
        names = {"has_vertex_normals": True, "has_vertex_texcoords": True}
        mesh = mi.Mesh("lens", size * size, 2 * (size - 1) ** 2, **names)
        params = mi.traverse(mesh)
        to_world = mi.Transform4f(front)
        params["vertex_positions"] = dr.ravel(to_world @ mi.Point3f(2 * u - 1, 2 * v - 1, 0))
        params["vertex_texcoords"] = dr.ravel(mi.Point2f(u, v))
        params["faces"] = faces
        params.update()
        return mesh

    def place(self, heights) -> None:
        """The front with these heights, (n, n, 1)."""
        self.heights["data"] = heights
        self.heights.update()
        moved = self.positions + self.normals * self.texture.eval_1(self.places)
        self.params["lens.vertex_positions"] = self.dr.ravel(moved)
        self.params.update()

    def iteration(self, seed: int, spp: int, spp_grad: int) -> dict:
        """Seconds of the picture, the displacement before it included, and of the derivative by the heights."""
        mi, dr = self.mi, self.dr
        dr.sync_thread()
        start = time.perf_counter()
        heights = mi.TensorXf(dr.detach(self.heights["data"]))
        dr.enable_grad(heights)
        self.place(heights)
        image = mi.render(self.scene, self.params, spp=spp, spp_grad=spp_grad, seed=2 * seed, seed_grad=2 * seed + 1)
        loss = dr.mean(dr.square(image / dr.mean(dr.detach(image), axis=None) - self.target), axis=None)
        dr.eval(image, loss)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.backward(loss)
        gradient = dr.grad(heights)
        dr.eval(gradient)
        dr.sync_thread()
        end = time.perf_counter()
        if not float(dr.sum(dr.abs(gradient), axis=None).array[0]) > 0:
            raise RuntimeError("no gradient reached the heights")
        # So that waves, not a plane, are rendered from here on: a step of a usual size.
        size = dr.max(dr.abs(gradient), axis=None)
        self.heights["data"] = dr.clip(dr.detach(heights) - 3e-5 * gradient / size, -0.01, 0.01)
        dr.eval(self.heights["data"])
        bad = [int(dr.count(~dr.isfinite(values.array))[0]) for values in (image, gradient)]
        return {
            "forward": middle - start,
            "backward": end - middle,
            "loss": float(loss.array[0]),
            "bad image": bad[0] // 3,
            "bad gradient": bad[1],
        }
