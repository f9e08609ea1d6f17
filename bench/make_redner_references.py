"""Evaluate redner's material with redner 0.4.28 into `tests/data/redner_material.npz`.

Run in redner's own environment (needs pyredner, torch and numpy):

    redner-env/bin/python bench/make_redner_references.py

There is no function that evaluates a material, so a plane is rendered, seen from `wi` and lit by a lamp that is small
and far away in the direction `wo`: the pixel over the irradiance that the lamp would give if it were seen frontally is
the value with the cosine. Stored: `wi`, `wo` (n, 3), `roughness` (n,), `diffuse`, `specular`, `value` (n, 3); the
lamp's size and the samples leave errors of 3e-4.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyredner
import torch

ROOT = Path(__file__).resolve().parent.parent
DISTANCE, SIZE, RADIANCE = 20.0, 0.05, 1e4  # of the lamp: half of its side


def square(centre: torch.Tensor, normal: torch.Tensor, half: float) -> tuple[torch.Tensor, torch.Tensor]:
    up = torch.tensor([0.0, 1, 0]) if abs(normal[1]) < 0.9 else torch.tensor([1.0, 0, 0])
    a = torch.cross(up, normal)
    a = half * a / a.norm()
    b = torch.cross(normal, a)
    corners = torch.stack([centre - a - b, centre + a - b, centre + a + b, centre - a + b])
    return corners, torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)


def value(wi: torch.Tensor, wo: torch.Tensor, material: pyredner.Material) -> np.ndarray:
    camera = pyredner.Camera(
        position=50 * wi,
        look_at=torch.zeros(3),
        up=torch.tensor([0.0, 1, 0]) if abs(wi[1]) < 0.9 else torch.tensor([1.0, 0, 0]),
        fov=torch.tensor([0.05]),
        resolution=(1, 1),
    )
    plane = pyredner.Object(*square(torch.zeros(3), torch.tensor([0.0, 0, 1]), 5.0), material)
    black = pyredner.Material(diffuse_reflectance=torch.zeros(3))
    light = {"light_intensity": torch.full((3,), RADIANCE)}
    lamp = pyredner.Object(*square(DISTANCE * wo, -wo, SIZE), black, **light)
    scene = pyredner.Scene(camera, objects=[plane, lamp])
    image = pyredner.render_pathtracing(scene, max_bounces=1, num_samples=256, seed=1)
    return image[0, 0].numpy() * DISTANCE**2 / (RADIANCE * (2 * SIZE) ** 2)


def main() -> None:
    pyredner.set_use_gpu(False)
    pyredner.set_print_timing(False)
    rng = np.random.default_rng(5)
    rows = []
    for i in range(24):
        wi, wo = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        wi[2], wo[2] = abs(wi[2]), abs(wo[2])
        if i % 2:
            wo = wi * [-1, -1, 1] + 0.3 * wo
            wo /= np.linalg.norm(wo)
        diffuse, specular, roughness = rng.uniform(0, 1, 3), rng.uniform(0, 1, 3), rng.choice([0.05, 0.2, 0.6, 1.0])
        tensors = [torch.tensor(x, dtype=torch.float32) for x in (wi, wo, diffuse, specular, [roughness])]
        material = pyredner.Material(tensors[2], tensors[3], tensors[4])
        rows.append([wi, wo, diffuse, specular, roughness, value(*tensors[:2], material)])
    names = ("wi", "wo", "diffuse", "specular", "roughness", "value")
    columns = {name: np.array([row[k] for row in rows], np.float32) for k, name in enumerate(names)}
    np.savez_compressed(ROOT / "tests" / "data" / "redner_material.npz", **columns)


if __name__ == "__main__":
    main()
