"""Spectral images are the same bit for bit in parts, in batches, in passes and at any number of threads."""

from __future__ import annotations

import itertools

import pytest
import torch
from spectral_objects import DOUBLE, camera, diffuse, load, waves

import torchrender as tr

pytestmark = pytest.mark.core
HEIGHT, WIDTH = 21, 37  # the film's tiles are not all whole
BANDS = {f"band{i}": waves(20 + i) for i in range(4)}
SETTINGS = {"path": {}, "volpath": {"integrator": {"type": "volpath", "max_depth": 5}}}
CHOICES = list(itertools.product(("box", "gaussian"), (torch.float32, DOUBLE)))
PARAMETERS = ("wall.bsdf.reflectance.data", "lamp.emitter.radiance.value", "ball.bsdf.k.value", "glass.bsdf.eta.value")


def make_scene(filter_type: str = "box", dtype=torch.float32, bands=None, **more) -> tr.Scene:
    """Every form of spectrum: tables, textures, a metal, glass, lamps with lines."""
    generator = torch.Generator().manual_seed(2)
    film = {"width": WIDTH, "height": HEIGHT, "rfilter": {"type": filter_type}}
    seen = camera(fov=50, origin=(0.3, 0.8, 4), film=film)
    texels = {"type": "bitmap", "data": torch.rand(6, 7, 3, generator=generator)}
    line = {"type": "irregular", "wavelengths": [587.0, 588.0, 590.0, 591.0], "values": [0.0, 60.0, 60.0, 0.0]}
    objects = {
        "camera": seen,
        "second": camera(fov=30, origin=(-0.3, 0.8, 4), film=film),
        "sky": {"type": "envmap", "data": torch.rand(5, 9, 3, generator=generator)},
        "wall": {
            "type": "rectangle",
            "to_world": tr.Transform.rotate([1, 0, 0], -60).scale(2),
            "bsdf": diffuse(texels),
        },
        "ball": {
            "type": "sphere",
            "center": [-0.6, 0.6, 0],
            "radius": 0.5,
            "bsdf": {"type": "conductor", "material": "Cu"},
        },
        "glass": {
            "type": "sphere",
            "center": [0.6, 0.6, 0],
            "radius": 0.5,
            "bsdf": {"type": "dielectric", "int_ior": {"type": "glass", "name": "SF10"}},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(0.4),
            "emitter": {"type": "area", "radiance": line},
        },
        "bulb": {"type": "point", "position": [1, 2, 2], "intensity": waves(1)},
    }
    scene = load({**objects, **more}, dtype=dtype, depth=5)
    if bands:
        for sensor in scene.sensors:
            sensor.film.bands = bands
    return scene


@pytest.fixture(autouse=True)
def keep_number_of_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def gradients(scene: tr.Scene, **settings) -> list[torch.Tensor]:
    chosen = [scene.get_parameter(name).requires_grad_() for name in PARAMETERS]
    image = tr.render(scene, spp=4, **settings)
    weight = torch.linspace(-1, 1, image.numel(), dtype=image.dtype).reshape(image.shape)
    return list(torch.autograd.grad((image * weight).sum(), chosen))


@pytest.mark.parametrize(("filter_type", "dtype"), CHOICES)
@pytest.mark.parametrize("bands", [None, BANDS], ids=["observer", "bands"])
def test_images_at_any_number_of_threads(filter_type, dtype, bands):
    scene = make_scene(filter_type, dtype, bands)
    images = []
    for threads in (1, 2, 8, 1):
        torch.set_num_threads(threads)
        images.append(tr.render(scene, spp=6, seed=11))
    assert images[0].std() > 0 and images[0].shape == (HEIGHT, WIDTH, 4 if bands else 3)
    assert all(torch.equal(images[0], image) for image in images[1:])
    # a scene of its own, and after other work, gives the same
    other = make_scene(filter_type, dtype, bands)
    tr.render(other, spp=1, seed=5)
    assert torch.equal(images[0], tr.render(other, spp=6, seed=11))
    assert not torch.equal(images[0], tr.render(other, spp=6, seed=12))


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize(("filter_type", "dtype"), CHOICES)
def test_gradients_at_any_number_of_threads(filter_type, dtype):
    scene = make_scene(filter_type, dtype)
    found = []
    for threads in (1, 2, 8):
        torch.set_num_threads(threads)
        found.append(gradients(scene, seed=3))
        for name, a, b in zip(PARAMETERS, found[-1], gradients(scene, seed=3), strict=True):
            assert a.abs().max() > 0, name
            assert torch.equal(a, b), (name, threads)
    tolerance = 1e3 * torch.finfo(dtype).eps
    for name, reference, *others in zip(PARAMETERS, *found, strict=True):
        for other in others:
            assert (other - reference).abs().max() <= tolerance * reference.abs().max(), name


@pytest.mark.parametrize(("filter_type", "dtype"), CHOICES)
@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("spp", [3, 70])  # 70: more than a chunk of 64, whose sums are merged in order
def test_pixels_and_crops(filter_type, dtype, settings, spp):
    scene = make_scene(filter_type, dtype, **SETTINGS[settings])
    whole = tr.render(scene, spp=spp, seed=2)
    generator = torch.Generator().manual_seed(5)
    pixels = torch.stack([torch.randint(0, n, (40,), generator=generator) for n in (HEIGHT, WIDTH)], 1)
    pixels = torch.cat([pixels, torch.tensor([[0, 0], [HEIGHT - 1, WIDTH - 1], [0, 0]]), pixels[:3]])
    for crop in ((0, 0, 1, 1), (13, 5, 8, 30), (0, 30, 21, 7), (20, 36, 1, 1)):
        y, x, h, w = crop
        assert torch.equal(tr.render(scene, spp=spp, seed=2, crop=crop), whole[y : y + h, x : x + w]), crop
    assert torch.equal(tr.render(scene, spp=spp, seed=2, pixels=pixels), whole[pixels[:, 0], pixels[:, 1]])


@pytest.mark.parametrize("bands", [None, BANDS], ids=["observer", "bands"])
def test_batches(bands):
    scene = make_scene("gaussian", bands=bands)
    batch = tr.render(scene, sensor=[0, 1, "second"], spp=4, seed=2, layout="bchw")
    alone = [tr.render(scene, sensor=i, spp=4, seed=2) for i in (0, 1, 1)]
    assert torch.equal(batch, torch.stack(alone).movedim(-1, 1))
    assert not torch.equal(alone[0], alone[1])


def test_passes():
    """The second pass has other noise than the first, of the same size."""
    scene = make_scene(dtype=DOUBLE)
    one, two = (tr.render(scene, spp=2, seed=4, passes=n) for n in (1, 2))
    second = 2 * two - one
    assert float((second - one).abs().mean()) > 1e-2
    many = tr.render(scene, spp=2, seed=5, passes=64)
    errors = [float((image - many).square().mean()) for image in (one, second, two)]
    assert 0.5 * errors[0] < errors[1] < 2 * errors[0] and errors[2] < 0.8 * min(errors[:2])
    assert torch.equal(two, tr.render(scene, spp=2, seed=4, passes=2))


def test_bands_in_one_film_are_those_of_films_of_their_own():
    """Three at a time are rendered with wavelengths of their own."""
    scene = make_scene(bands=BANDS)
    whole = tr.render(scene, spp=4, seed=3)
    names = list(BANDS)
    for part in (names[:3], names[3:]):
        scene.sensors[0].film.bands = {name: BANDS[name] for name in part}
        found = tr.render(scene, spp=4, seed=3)
        assert torch.equal(found, whole[..., [names.index(n) for n in part]])
