"""Redner's half of the benchmarks. Runs in Redner's own environment (Python 3.7), where torchrender is not installed.

The protocol is in `serving.py`, the file of a scene in `scene_arrays.py`. Where nothing that moves is differentiated,
Redner's edge sampling, which is for that, is switched off; where something does: `redner_visibility.py`. Samples are
independent ones, which is the default of `RenderFunction`. Redner takes all processors that this process may run on.
"""

from __future__ import annotations

import os
import time

from serving import serve, weight_of  # beside this script


class Server:
    def __init__(self, threads: int) -> None:
        available = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, available[:threads])
        started = time.perf_counter()
        import pkg_resources
        import pyredner
        import torch

        torch.set_num_threads(threads)
        pyredner.set_use_gpu(False)
        pyredner.set_print_timing(False)
        self.import_seconds = time.perf_counter() - started
        self.pyredner, self.torch = pyredner, torch
        self.version = pkg_resources.get_distribution("redner").version

    def load(self, path: str, arguments: dict, parameters: list, resolution: int, spp: int, arrays: str | None) -> dict:
        import numpy as np

        pyredner, torch = self.pyredner, self.torch
        with np.load(arrays) as file:
            stored = dict(file)

        def tensor(value):
            return torch.from_numpy(np.ascontiguousarray(value, dtype=np.float32))

        colours, used, shapes, lights = {}, [], [], []
        count = 1 + max(int(key.split(".")[0]) for key in stored if "." in key)
        for i in range(count):
            prefix = f"{i}."
            shape = {key[len(prefix) :]: value for key, value in stored.items() if key.startswith(prefix)}
            name = str(shape["parameter"])
            if name not in colours:
                colours[name] = tensor(shape["colour"]).requires_grad_(name in parameters)
            material = (name, bool(shape["two_sided"]))
            if material not in used:
                used.append(material)
            optional = {field: tensor(shape[field]) if field in shape else None for field in ("normals", "uv")}
            shapes.append(
                pyredner.Shape(
                    vertices=tensor(shape["vertices"]),
                    indices=torch.from_numpy(np.ascontiguousarray(shape["faces"], dtype=np.int32)),
                    uvs=optional["uv"],
                    normals=optional["normals"],
                    material_id=used.index(material),
                )
            )
            if "radiance" in shape:
                lights.append(pyredner.AreaLight(i, tensor(shape["radiance"])))
        to_world = stored["to_world"].astype(np.float64)
        camera = pyredner.Camera(
            position=tensor(to_world[:3, 3]),
            look_at=tensor(to_world[:3, 3] + to_world[:3, 2]),
            up=tensor(to_world[:3, 1]),
            fov=tensor([stored["fov"]]),
            resolution=(resolution, resolution),
        )
        self.colours, self.materials = colours, used
        self.parts = (camera, shapes, lights)
        self.order, self.spp, self.resolution = parameters, spp, resolution
        return {"loaded": True}

    def _render(self, seed: int, spp: int, spp_grad: int):
        pyredner = self.pyredner
        # Materials make the mipmaps of their textures, as they have to whenever a texture has changed.
        materials = [
            pyredner.Material(diffuse_reflectance=self.colours[name], two_sided=two_sided)
            for name, two_sided in self.materials
        ]
        camera, shapes, lights = self.parts
        # depth 5 of a path tracer that counts the camera's segment is four bounces
        arguments = pyredner.RenderFunction.serialize_scene(
            pyredner.Scene(camera, shapes, materials, lights),
            (spp, spp_grad),
            4,
            use_primary_edge_sampling=False,
            use_secondary_edge_sampling=False,
        )
        return pyredner.RenderFunction.apply((2 * seed, 2 * seed + 1), *arguments)

    def _gradients(self, loss):
        return self.torch.autograd.grad(loss, [self.colours[name] for name in self.order])

    def forward(self, seed: int) -> dict:
        start = time.perf_counter()
        with self.torch.no_grad():
            self._render(seed, self.spp, self.spp)
        return {"forward": time.perf_counter() - start}

    def step(self, seed: int) -> dict:
        start = time.perf_counter()
        image = self._render(seed, self.spp, self.spp)
        middle = time.perf_counter()
        gradients = self._gradients(image.pow(2).mean())
        end = time.perf_counter()
        if not sum(float(gradient.abs().sum()) for gradient in gradients) > 0:
            raise RuntimeError(f"no gradient reached {', '.join(self.order)}")
        return {"forward": middle - start, "backward": end - middle}

    def image(self, seed: int, spp: int, file: str) -> dict:
        import numpy as np

        start = time.perf_counter()
        with self.torch.no_grad():
            image = self._render(seed, spp, spp)
        seconds = time.perf_counter() - start
        np.save(file, image.numpy())
        return {"seconds": seconds}

    def gradient(self, seed: int, spp: int, file: str | None = None) -> dict:
        import numpy as np

        weight = self.torch.from_numpy(weight_of(self.resolution, self.resolution, np))
        start = time.perf_counter()
        image = self._render(seed, 1, spp)
        gradients = self._gradients((image * weight).mean())
        seconds = time.perf_counter() - start
        if file:
            np.savez(file, *[gradient.double().numpy() for gradient in gradients])
        return {"sums": [float(gradient.double().sum()) for gradient in gradients], "seconds": seconds}

    def load_moved(self, arrays: str, name: str, direction: list, max_depth: int, resolution: int, spp: int) -> dict:
        from redner_visibility import Moved

        self.moved = Moved(self.pyredner, self.torch, arrays, name, direction, max_depth, resolution, spp)
        return {"loaded": True}

    def derivative(self, seed: int) -> dict:
        return self.moved.derivative(seed)


if __name__ == "__main__":
    serve(Server)
