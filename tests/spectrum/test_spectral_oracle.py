"""Spectral and polarised images against samples that are traced one by one in PyTorch (tests/oracle/spectral.py), with
the same random numbers and wavelengths: images, and gradients by autograd, are equal to rounding."""

from __future__ import annotations

import pytest
import reference_scenes as r
import torch
from in_torch import differentiable
from oracle.spectral import stokes_image

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
SPP, SEED = 2, 5


def room(ball: dict, **more) -> dict:
    """Seen in 2 x 2 pixels: a ball over a painted floor, under a lamp and a sky."""
    floor = {"type": "bitmap", "data": r._noise(31, 3, 4, 0.1, 0.9)}
    lamp = {"type": "irregular", "wavelengths": [360, 500, 600, 830], "values": [1.0, 4.0, 9.0, 7.0]}
    return r._scene(
        {"type": "path", "max_depth": 6, "rr_depth": 100},
        r._camera(fov=35, film={"width": 2, "height": 2}),
        ball={"type": "sphere", "center": [0.1, 0.0, 0.2], "bsdf": ball},
        floor=r._floor(floor),
        lamp=r._lamp(lamp),
        sky={"type": "constant", "radiance": r._rgb(0.3, 0.5, 0.9)},
        **more,
    )


GLASS = {"type": "dielectric", "int_ior": {"type": "glass", "name": "SF10"}, "ext_ior": 1.0}
SCENES = {
    "paint": lambda: room(r._diffuse(r._rgb(0.7, 0.3, 0.1)), bulb={"type": "point", "position": [2.0, 3, 1]}),
    "gold": lambda: room({"type": "roughconductor", "material": "Au", "alpha": 0.2}),
    "glass": lambda: room(GLASS),
}


@pytest.mark.parametrize("name", SCENES)
def test_images_and_gradients(name):
    scene = tr.load_dict(SCENES[name](), variant="spectral", dtype=torch.float64)
    settings = {"spp": SPP, "seed": SEED}
    with torch.no_grad():
        image = tr.render(scene, outputs=("stokes",), **settings).stokes
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    found = tr.render(scene, outputs=("stokes",), correlated=True, visibility=False, params=values, **settings).stokes
    expected = stokes_image(scene, params=values, derivative=True, **settings)
    assert (image - expected).abs().max() <= 1e-10 * expected.abs().max() and expected.max() > 0.1
    weight = torch.rand(found.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64) - 0.5
    leaves = list(values.values())
    pair = [torch.autograd.grad((x * weight).mean(), leaves, materialize_grads=True) for x in (found, expected)]
    largest = max(float(b.abs().max()) for b in pair[1])
    assert sum(bool(b.any()) for b in pair[1]) > len(leaves) / 2
    for parameter, a, b in zip(values, *pair, strict=True):
        assert (a - b).abs().max() <= 1e-8 * b.abs().max() + 1e-12 * largest, parameter
