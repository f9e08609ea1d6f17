"""Derivatives of spectral images: of everything that a spectrum is made of, reverse mode against differences of images
with the same random numbers, and against forward mode.

The density of wavelengths follows the lights: `frozen` keeps it, so that differences are those of the same wavelengths.
"""

from __future__ import annotations

import sys

import pytest
import torch
from spectral_objects import DOUBLE, camera, colour, diffuse, load, plate, waves

import torchrender as tr
from torchrender.scene.spectral.wavelengths import wavelength_config

sp = tr.spectrum
pytestmark = pytest.mark.core
SPP = 4
BANDS = {f"band{i}": waves(60 + i, 0.0, 1.0) for i in range(4)}


def texels(seed: int, *shape: int) -> torch.Tensor:
    return 0.1 + 0.8 * torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


def room(dtype=DOUBLE, depth: int = 4, **more) -> tr.Scene:
    """Spectra of every form, at nothing that chooses directions by them."""
    lamp = {"type": "blackbody", "temperature": 3000.0}
    objects = {
        "camera": camera(12, fov=55, origin=(0, 0.8, 4)),
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": diffuse({"type": "bitmap", "data": texels(1, 3, 4, 3)}),
        },
        "wall": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 0, -2]).scale(3),
            "bsdf": diffuse(colour(0.7, 0.3, 0.2)),
        },
        "ball": {"type": "sphere", "center": [-1, -0.3, 0], "radius": 0.7, "bsdf": diffuse(waves(3))},
        "metal": {
            "type": "sphere",
            "center": [0.9, -0.3, 0],
            "radius": 0.7,
            "bsdf": {"type": "conductor", "material": "Cu", "specular_reflectance": colour(0.9, 0.8, 0.6)},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 3, 0]).rotate([1, 0, 0], 90),
            "emitter": {"type": "area", "radiance": waves(6, 0.5, 3.0)},
        },
        "bulb": {"type": "point", "position": [1, 2, 2], "intensity": colour(5.0, 3.0, 4.0)},
        "sun": {"type": "directional", "direction": [0.2, -1, -0.4], "irradiance": lamp},
        "sky": {"type": "constant", "radiance": waves(5)},
    }
    return load({**objects, **more}, dtype=dtype, depth=depth)


ROOM = {
    "floor.bsdf.reflectance.data": (3, 4, 3),
    "wall.bsdf.reflectance.value": (3,),
    "ball.bsdf.reflectance.value": (471,),
    "metal.bsdf.eta.value": (471,),
    "metal.bsdf.k.value": (471,),
    "metal.bsdf.specular_reflectance.value": (3,),
    "lamp.emitter.radiance.value": (471,),
    "bulb.intensity.value": (3,),
    "sun.irradiance.value": (471,),
    "sky.radiance.value": (471,),
}


@pytest.fixture
def frozen(monkeypatch):
    """Wavelengths are those of the first image, in every scene that is rendered."""
    kept = {}

    def config(scene, layout, tensors, weights=None):
        key = id(scene), None if weights is None else float(weights.sum())
        if key not in kept:
            kept[key] = wavelength_config(scene, layout, tensors, weights)
        return kept[key]

    monkeypatch.setattr(sys.modules["torchrender.render"], "wavelength_config", config)


def weighted(image: torch.Tensor) -> torch.Tensor:
    return image * torch.linspace(-0.7, 1, image.numel(), dtype=image.dtype).reshape(image.shape)


def check(image, value: torch.Tensor, step: float = 1e-4, rtol: float = 1e-6, seed: int = 0) -> None:
    """Reverse and forward mode of a function that makes an image, against each other and central differences."""
    direction = (torch.rand(value.shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE) + 0.5) * (
        value.abs().max() if value.numel() else 1
    )
    x = value.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(weighted(image(x)).sum(), x)
    reverse = (gradient * direction).sum()
    tangent = torch.func.jvp(image, (value,), (direction,))[1]
    with torch.no_grad():
        high, low = image(value + step * direction), image(value - step * direction)
    difference = (high - low) / (2 * step)
    size = float(difference.abs().max())
    assert size > 0 and gradient.shape == value.shape
    assert float((tangent - difference).abs().max()) <= rtol * size
    assert float(reverse) == pytest.approx(
        float(weighted(tangent).sum()), rel=1e-9, abs=1e-9 * float(weighted(tangent).abs().sum())
    )


@pytest.mark.parametrize("bands", [None, BANDS], ids=["observer", "bands"])
@pytest.mark.parametrize("name", ROOM)
def test_parameters(name, bands, frozen):
    scene = room()
    scene.sensors[0].film.bands = bands
    value = scene.get_parameter(name).detach().clone()
    assert value.shape == ROOM[name]
    check(lambda x: tr.render(scene, spp=SPP, seed=3, correlated=True, params={name: x}), value)


def test_temperatures(frozen):
    scene = room()

    def image(kelvin):
        light = sp.blackbody(kelvin)
        return tr.render(scene, spp=SPP, seed=3, correlated=True, params={"sun.irradiance.value": light})

    check(image, torch.tensor(3100.0, dtype=DOUBLE))


def test_of_few_numbers(frozen):
    """A reflectance of seven samples, a lamp of two lines and their energies."""
    scene = room()

    def image(x):
        paint = sp.regular(x[:7], 380, 720)
        lamp = sp.irregular(
            [435, 436, 437, 545, 546, 547], 40 * x[7:9].repeat_interleave(3) * x.new_tensor([0, 1, 0] * 2)
        )
        named = {"ball.bsdf.reflectance.value": paint, "lamp.emitter.radiance.value": lamp}
        return tr.render(scene, spp=SPP, seed=3, correlated=True, params=named)

    check(image, texels(8, 9))


def test_all_at_once_in_both_modes():
    """<J v, w> = <v, J' w>, also of samples of the derivative's own."""
    for dtype, rtol in ((DOUBLE, 1e-10), (torch.float32, 1e-4)):
        scene = room(dtype)
        values = [scene.get_parameter(n).detach().clone() for n in ROOM]

        def image(*tensors, scene=scene):
            return tr.render(scene, spp=1, spp_grad=SPP, seed=5, params=dict(zip(ROOM, tensors)))

        result = tr.testing.dot_product_test(image, values, rtol=rtol)
        assert result, result.message


def test_the_image_is_linear_in_a_reflectance():
    """At one bounce: its derivative times the table is the image, but for what is seen without it."""
    seen = plate(waves(2), waves(1, 0.0, 2.0))
    name, table = "plate.bsdf.reflectance.value", waves(2)

    def image(x):
        return tr.render(seen, spp=SPP, seed=3, correlated=True, params={name: x})

    value, tangent = torch.func.jvp(image, (table,), (table,))
    assert torch.allclose(value, tangent, rtol=1e-12, atol=1e-15)
    other = waves(9)
    assert torch.allclose(
        0.3 * image(table) + 0.7 * image(other), image(0.3 * table + 0.7 * other), rtol=1e-12, atol=1e-15
    )
    # what each nanometre gives to the mean of the image, on average
    x = table.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(tr.render(seen, spp=1024, seed=1, params={name: x}).mean((0, 1)).sum(), x)
    expected = (sp.responses() * waves(1, 0.0, 2.0)[:, None]).sum(1) / torch.pi
    coarse = [t[:470].reshape(47, 10).sum(1) for t in (gradient, expected)]
    assert float((coarse[0] - coarse[1]).abs().max()) < 3e-3 * float(expected.abs().sum())


def test_albedo_that_is_seen():
    scene = room()
    for name in ("floor.bsdf.reflectance.data", "wall.bsdf.reflectance.value", "ball.bsdf.reflectance.value"):
        value = scene.get_parameter(name).detach().clone()

        def image(x, name=name):
            seen = tr.render(scene, spp=SPP, seed=3, correlated=True, params={name: x}, outputs=("albedo",))
            return seen.albedo

        check(image, value)


def test_optimisation_finds_a_spectrum_s_colour():
    """Some steps down the gradient of one sample a pixel: a table that has the colour that is wanted."""
    scene = plate(0.5 * torch.ones(471, dtype=DOUBLE), torch.pi * sp.d65())
    wanted = torch.tensor([0.6, 0.3, 0.2], dtype=DOUBLE)
    logits = torch.zeros(471, dtype=DOUBLE, requires_grad=True)
    optimiser = torch.optim.Adam([logits], lr=0.1)
    for step in range(80):
        optimiser.zero_grad()
        params = {"plate.bsdf.reflectance.value": torch.sigmoid(logits)}
        image = tr.render(scene, spp=1, seed=step, params=params).mean((0, 1))
        (image - wanted).square().sum().backward()
        optimiser.step()
    found = sp.to_rgb(torch.sigmoid(logits.detach()), sp.d65())
    assert torch.allclose(found, wanted, rtol=0, atol=0.01)
