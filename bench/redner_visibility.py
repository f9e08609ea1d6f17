"""Redner's half of the benchmark of what moves, for `redner_server.py`, in Redner's environment (Python 3.7)."""

from __future__ import annotations

import time

from serving import weight_of


class Moved:
    """A scene in which one shape or the camera moves, and its derivative with all of Redner's edge sampling.

    Args:
        pyredner, torch: the modules.
        arrays: file of the scene, see `scene_arrays.py`.
        name: what moves: a shape's name, or "camera".
        direction: in which it is moved.
        max_depth: segments of a path.
    """

    def __init__(self, pyredner, torch, arrays: str, name: str, direction: list, max_depth, resolution, spp) -> None:
        import numpy as np

        self.pyredner, self.torch = pyredner, torch
        self.name, self.direction = name, torch.tensor(direction)
        self.bounces, self.spp = max_depth - 1, spp
        self.size = (resolution, resolution)
        self.weight = torch.from_numpy(weight_of(resolution, resolution, np))

        def tensor(value):
            return torch.from_numpy(np.ascontiguousarray(value, dtype=np.float32))

        with np.load(arrays) as file:
            stored = dict(file)
        self.shapes = []
        for i in range(1 + max(int(key.split(".")[0]) for key in stored if "." in key)):
            prefix = f"{i}."
            shape = {key[len(prefix) :]: value for key, value in stored.items() if key.startswith(prefix)}
            found = {key: tensor(shape[key]) for key in ("vertices", "normals", "colour", "radiance") if key in shape}
            found["faces"] = torch.from_numpy(np.ascontiguousarray(shape["faces"], dtype=np.int32))
            self.shapes.append({**found, "name": str(shape["name"]), "two_sided": bool(shape["two_sided"])})
        if name != "camera" and name not in [shape["name"] for shape in self.shapes]:
            raise ValueError(f"no shape is named {name!r}")
        self.sky = tensor(stored["sky"]).expand(4, 8, 3).contiguous() if "sky" in stored else None
        self.to_world, self.fov = tensor(stored["to_world"]), tensor([stored["fov"]])

    def _scene(self, amount):
        """The scene after a motion by `amount`."""
        pyredner = self.pyredner
        move = amount * self.direction
        still = self.torch.zeros(3)
        shapes, materials, lights = [], [], []
        for i, shape in enumerate(self.shapes):
            vertices = shape["vertices"] + (move if shape["name"] == self.name else still)
            normals = shape.get("normals")
            shapes.append(pyredner.Shape(vertices=vertices, indices=shape["faces"], normals=normals, material_id=i))
            materials.append(pyredner.Material(diffuse_reflectance=shape["colour"], two_sided=shape["two_sided"]))
            if "radiance" in shape:
                lights.append(pyredner.AreaLight(i, shape["radiance"]))
        place = self.to_world[:3, 3] + (move if self.name == "camera" else still)
        target, up = place + self.to_world[:3, 2], self.to_world[:3, 1].contiguous()
        camera = pyredner.Camera(position=place, look_at=target, up=up, fov=self.fov, resolution=self.size)
        sky = None if self.sky is None else pyredner.EnvironmentMap(self.sky)
        return pyredner.Scene(camera, shapes, materials, lights, envmap=sky)

    def derivative(self, seed: int) -> dict:
        """The derivative of mean(image * weight) by the motion, and the seconds of an iteration that needs it."""
        pyredner = self.pyredner
        start = time.perf_counter()
        amount = self.torch.zeros((), requires_grad=True)
        arguments = pyredner.RenderFunction.serialize_scene(self._scene(amount), (1, self.spp), self.bounces)
        image = pyredner.RenderFunction.apply((2 * seed, 2 * seed + 1), *arguments)
        (gradient,) = self.torch.autograd.grad((image * self.weight).mean(), amount)
        return {"derivative": float(gradient), "seconds": time.perf_counter() - start}
