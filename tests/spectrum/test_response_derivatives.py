"""Derivatives of images by the bands of a film and by the response of a sensor, in which images are linear."""

from __future__ import annotations

import pytest
import torch
from spectral_objects import DOUBLE, camera, diffuse, load, waves

import torchrender as tr

pytestmark = pytest.mark.core

FILTER = {"rfilter": {"type": "gaussian"}}


def scene_of(bands=None, srf=None, dtype=DOUBLE, floor=None, **film) -> tr.Scene:
    view = camera(4, 40.0, film=film or None)
    objects = {
        "camera": view,
        "plate": {"type": "rectangle", "to_world": tr.Transform.scale(10), "bsdf": floor or diffuse(waves(1))},
        "ball": {"type": "sphere", "center": [0.3, 0.2, 1.0], "radius": 0.7, "bsdf": diffuse(waves(2))},
        "sky": {"type": "constant", "radiance": waves(3, 0.5, 1.0)},
        "sun": {"type": "directional", "direction": [0.3, -1, -1], "irradiance": waves(4)},
    }
    scene = load(objects, dtype=dtype, depth=3)
    sensor = scene.sensors[0]
    if bands is not None:
        film = sensor.film
        sensor.film = tr.Film(film.width, film.height, filter=film.filter, bands=bands)
    if srf is not None:
        sensor.srf = srf
    return scene


def tables(count: int) -> dict[str, torch.Tensor]:
    return {f"b{i}": waves(20 + i, 0.1, 1.0).requires_grad_() for i in range(count)}


def of_samples(scene: tr.Scene, **settings) -> torch.Tensor:
    """With the derivative of the image's own samples."""
    return tr.render(scene, spp=8, seed=3, correlated=True, **settings)


@pytest.mark.parametrize("film", [{}, FILTER], ids=["box", "gaussian"])
@pytest.mark.parametrize("count", [1, 3, 5])
def test_images_are_linear_in_bands(count, film):
    """The derivative along a band itself is its channel, bit for bit but for rounding, and no other one changes."""
    bands = tables(count)
    image = of_samples(scene_of(bands, **film))
    for i, table in enumerate(bands.values()):
        weight = torch.rand(4, 4, count, generator=torch.Generator().manual_seed(i), dtype=DOUBLE)
        (gradient,) = torch.autograd.grad((image * weight).sum(), table, retain_graph=True)
        assert gradient.shape == (471,)
        expected = (image * weight)[..., i].sum()
        torch.testing.assert_close((gradient * table).sum(), expected, rtol=1e-10, atol=0)


@pytest.mark.parametrize("what", ["bands", "srf"])
def test_differences(what, monkeypatch):
    """Along any change, with the wavelengths that the responses have chosen: exact, since images are linear."""
    from torchrender.scene.spectral import wavelengths

    start, change = waves(30, 0.2, 1.0), waves(31, -0.2, 0.2)
    chosen, make = [], wavelengths.positions

    def first_positions(*arguments):
        if not chosen:
            chosen.append(make(*arguments))
        return chosen[0]

    monkeypatch.setattr(wavelengths, "positions", first_positions)

    def image(table):
        return of_samples(scene_of({"one": table, "two": 1.0}) if what == "bands" else scene_of(srf=table))

    table = start.clone().requires_grad_()
    found = image(table)
    weight = torch.rand(found.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    (gradient,) = torch.autograd.grad((found * weight).sum(), table)
    difference = ((image(start + change) - image(start)) * weight).sum()
    torch.testing.assert_close((gradient * change).sum(), difference, rtol=1e-9, atol=0)
    _, tangent = torch.func.jvp(image, (start,), (change,))
    torch.testing.assert_close((tangent * weight).sum(), difference, rtol=1e-9, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_numbers_of_samples_and_passes(dtype):
    """Image and derivative have samples of their own unless told otherwise; both have the same mean."""
    bands = tables(1)
    scene = scene_of(bands, dtype=dtype)
    image = tr.render(scene, spp=1, seed=0, spp_grad=256, passes=2)
    (gradient,) = torch.autograd.grad(image.sum(), bands["b0"])
    assert gradient.dtype == DOUBLE
    expected = float(tr.render(scene, spp=512, seed=9).sum().detach())
    assert float((gradient * bands["b0"]).sum().detach()) == pytest.approx(expected, rel=0.02)


def test_stokes_vectors():
    bands = tables(2)
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.3}
    stokes = of_samples(scene_of(bands, floor=gold), outputs=("stokes",)).stokes
    weight = torch.rand(stokes.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    gradients = torch.autograd.grad((stokes * weight).sum(), list(bands.values()))
    for i, (gradient, table) in enumerate(zip(gradients, bands.values())):
        expected = (stokes * weight)[:, :, i].sum()
        torch.testing.assert_close((gradient * table).sum(), expected, rtol=1e-10, atol=0)
    assert float(stokes[..., 1:].detach().abs().max()) > 1e-3 * float(stokes.detach().max())


def test_with_other_parameters():
    """Both are differentiated at once, and as they are apart; pixels and crops are those of the whole."""
    bands = tables(2)
    scene = scene_of(bands)
    (colour,) = scene.train_only("ball.bsdf.reflectance.value")
    image = of_samples(scene)
    both = torch.autograd.grad(image.square().sum(), [colour, bands["b0"]])
    scene.requires_grad_(False)
    alone = torch.autograd.grad(of_samples(scene).square().sum(), bands["b0"])[0]
    torch.testing.assert_close(both[1], alone, rtol=1e-12, atol=0)
    assert float(both[0].abs().max()) > 0
    pixels = torch.tensor([[1, 2], [3, 0], [1, 2]])
    some = of_samples(scene, pixels=pixels)
    part = torch.autograd.grad(some.sum(), bands["b1"])[0]
    whole = of_samples(scene)[pixels[:, 0], pixels[:, 1]].sum()
    torch.testing.assert_close(part, torch.autograd.grad(whole, bands["b1"])[0], rtol=1e-10, atol=1e-15)


def test_steps_of_an_optimiser_are_seen():
    table = waves(40, 0.1, 1.0).requires_grad_()
    scene = scene_of({"one": table})
    before = of_samples(scene)
    with torch.no_grad():
        table.mul_(2)
    torch.testing.assert_close(of_samples(scene), 2 * before, rtol=1e-9, atol=0)


@pytest.mark.parametrize("outputs", [("rgb",), ("stokes",)])
def test_light_paths(outputs):
    """As above, of what paths from the lights bring: images are linear in bands and in a sensor's response."""
    bands = tables(2)
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.3}
    scene = scene_of(bands, floor=gold, **FILTER)
    scene.integrator = tr.ParticleTracer(max_depth=3)
    found = getattr(of_samples(scene, outputs=outputs), outputs[0])
    channels = found.unsqueeze(-1) if outputs == ("rgb",) else found
    weight = torch.rand(channels.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)
    gradients = torch.autograd.grad((channels * weight).sum(), list(bands.values()))
    for i, (gradient, table) in enumerate(zip(gradients, bands.values())):
        expected = (channels * weight)[:, :, i].sum()
        torch.testing.assert_close((gradient * table).sum(), expected, rtol=1e-10, atol=0)

    def image(table):
        scene = scene_of(srf=table)
        scene.integrator = tr.ParticleTracer(max_depth=3)
        return of_samples(scene)

    table, change = waves(30, 0.2, 1.0), waves(31, -0.2, 0.2)
    _, tangent = torch.func.jvp(image, (table,), (change,))
    leaf = table.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((image(leaf) * tangent).sum(), leaf)
    torch.testing.assert_close((gradient * change).sum(), tangent.square().sum(), rtol=1e-10, atol=0)
