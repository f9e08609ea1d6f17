"""The same seed gives the same numbers; another one, or none, gives other noise."""

from __future__ import annotations

import itertools
import math

import pytest
import torch

import torchrender as tr

SENSOR = {
    "type": "perspective",
    "fov": 50,
    "to_world": tr.Transform.look_at([0.3, 0.8, 4], [0, 0, 0], [0, 1, 0]),
}
PARAMETERS = ("wall.bsdf.reflectance.data", "sky.data", "lamp.emitter.radiance.value", "ball.bsdf.k.value")


def make_scene(filter_type: str = "box", width: int = 37, height: int = 21, **settings) -> tr.Scene:
    """Every kind of sampling that there is; the film's tiles are not all whole."""
    generator = torch.Generator().manual_seed(2)
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": filter_type}}
    return tr.load_dict(
        {
            "type": "scene",
            "camera": {**SENSOR, "film": film},
            "second": {**SENSOR, "film": film},
            "sky": {"type": "envmap", "data": torch.rand(5, 9, 3, generator=generator)},
            "wall": {
                "type": "rectangle",
                "to_world": tr.Transform.rotate([1, 0, 0], -60).scale(2),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "bitmap", "data": torch.rand(6, 7, 3, generator=generator), "raw": True},
                },
            },
            "ball": {
                "type": "sphere",
                "center": [-0.6, 0.6, 0],
                "radius": 0.5,
                "bsdf": {"type": "conductor", "eta": 1.1, "k": 2.0},
            },
            "glass": {"type": "sphere", "center": [0.6, 0.6, 0], "radius": 0.5, "bsdf": {"type": "dielectric"}},
            "lamp": {
                "type": "rectangle",
                "to_world": tr.Transform.translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(0.4),
                "emitter": {"type": "area", "radiance": 5.0},
            },
            "bulb": {"type": "point", "position": [1, 2, 2], "intensity": 2.0},
        },
        **settings,
    )


@pytest.fixture(autouse=True)
def keep_number_of_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def variants():
    return list(itertools.product(("mono", "rgb"), (torch.float32, torch.float64)))


def gradients(scene: tr.Scene, **settings) -> list[torch.Tensor]:
    chosen = [scene.get_parameter(name) for name in PARAMETERS]
    for parameter in chosen:
        parameter.requires_grad_()
    image = tr.render(scene, spp=4, **settings)
    weight = torch.linspace(-1, 1, image.numel(), dtype=image.dtype).reshape(image.shape)
    return list(torch.autograd.grad((image * weight).sum(), chosen))


@pytest.mark.parametrize("filter_type", ["box", "tent", "gaussian"])
@pytest.mark.parametrize(("variant", "dtype"), variants())
def test_images_are_the_same_bit_for_bit_at_any_number_of_threads(variant, dtype, filter_type):
    scene = make_scene(filter_type, variant=variant, dtype=dtype)
    images = []
    for threads in (1, 2, 8, 1):
        torch.set_num_threads(threads)
        images.append(tr.render(scene, spp=6, seed=11))
    assert images[0].std() > 0
    assert all(torch.equal(images[0], image) for image in images[1:])
    # a scene of its own, and after other work, gives the same
    other = make_scene(filter_type, variant=variant, dtype=dtype)
    tr.render(other, spp=1, seed=5)
    assert torch.equal(images[0], tr.render(other, spp=6, seed=11))


@pytest.mark.parametrize("filter_type", ["box", "gaussian"])
@pytest.mark.parametrize(("variant", "dtype"), variants())
def test_gradients_are_the_same_bit_for_bit_at_a_given_number_of_threads(variant, dtype, filter_type):
    scene = make_scene(filter_type, variant=variant, dtype=dtype)
    for threads in (1, 2, 8):
        torch.set_num_threads(threads)
        first, second = gradients(scene, seed=3), gradients(scene, seed=3)
        for name, a, b in zip(PARAMETERS, first, second, strict=True):
            assert a.abs().max() > 0, name
            assert torch.equal(a, b), (name, threads)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_at_other_numbers_of_threads_differ_in_rounding_only(dtype):
    scene = make_scene(dtype=dtype)
    found = []
    for threads in (1, 2, 8):
        torch.set_num_threads(threads)
        found.append(gradients(scene, seed=3))
    tolerance = 1e3 * torch.finfo(dtype).eps
    for name, reference, *others in zip(PARAMETERS, *found, strict=True):
        for other in others:
            assert (other - reference).abs().max() <= tolerance * reference.abs().max(), name


def test_gradients_of_large_textures_begin_with_zeros():
    """Their memory comes from the system, in large pages: again and again, for every thread but the first."""
    scene = make_scene()
    shape = (1700, 1700, 3)
    assert 4 * math.prod(shape) > 1 << 25
    scene.get_submodule("wall.bsdf.reflectance").data = torch.full(shape, 0.5)
    found = []
    for threads in (1, 3, 3):
        torch.set_num_threads(threads)
        found.append(gradients(scene, seed=3)[0])
    assert (found[0] != 0).any(dim=-1).sum() > 1000
    assert torch.equal(found[1], found[2])
    assert (found[1] - found[0]).abs().max() <= 1e-4 * found[0].abs().max()


def test_forward_mode_is_the_same_bit_for_bit_at_any_number_of_threads():
    scene = make_scene("tent")
    name = PARAMETERS[0]
    value = scene.get_parameter(name).detach()
    tangents = []
    for threads in (1, 2, 8):
        torch.set_num_threads(threads)

        def image(texture):
            return tr.render(scene, spp=4, seed=8, params={name: texture})

        tangents.append(torch.func.jvp(image, (value,), (torch.ones_like(value),))[1])
    assert tangents[0].abs().max() > 0
    assert torch.equal(tangents[0], tangents[1])
    assert torch.equal(tangents[0], tangents[2])


def test_no_noise_is_used_twice_without_a_seed():
    scene = make_scene()
    torch.manual_seed(0)
    images = [tr.render(scene, spp=1) for _ in range(4)]
    grads = [gradients(scene)[0] for _ in range(4)]
    for found in (images, grads):
        assert not any(torch.equal(a, b) for a, b in itertools.combinations(found, 2))
    torch.manual_seed(0)
    assert torch.equal(images[0], tr.render(scene, spp=1))


def test_noise_of_different_seeds_sensors_and_passes_is_independent():
    # The difference of two independent images of the same distribution has either sign with the same probability, in
    # every pixel. Of n independent pixels, signs of two such differences agree in n / 2 with a standard deviation of
    # sqrt(n) / 2. Of 45 pairs the farthest is beyond 4.9 of them with probability 4.3e-5 (normal approximation).
    scene = make_scene(width=48, height=48)

    def image(spp: int, **settings) -> torch.Tensor:
        return tr.render(scene, spp=spp, sampler="independent", **settings)

    images = [image(1, seed=seed) for seed in (0, 1, 2, 3, 2**32, 2**63, 2**64 - 1)]
    images.append(image(1, seed=0, sensor=1))
    # the second pass, and the second sample, alone: what the first leaves of the mean of two
    images.append(2 * image(1, seed=0, passes=2) - images[0])
    images.append(2 * image(2, seed=0) - images[0])
    assert len(images) == 10
    differences = [found - image(1, seed=1000 + i) for i, found in enumerate(images)]
    signs = [torch.where(d.abs() > 1e-4, d, 0).mean(-1).sign().reshape(-1) for d in differences]
    for (i, a), (j, b) in itertools.combinations(enumerate(signs), 2):
        n = float(((a != 0) & (b != 0)).sum())
        assert n > 1000
        assert abs(float((a * b).sum())) < 4.9 * n**0.5, (i, j)


def test_image_and_derivative_have_samples_of_their_own():
    # The derivative of the image with respect to the scale of all light, with the image's own samples, is the image.
    scene = make_scene()
    light = {name: scene.get_parameter(name).detach() for name in ("sky.data", "lamp.emitter.radiance.value")}
    light["bulb.intensity.value"] = scene.get_parameter("bulb.intensity.value").detach()

    def both(**settings):
        def image(scale):
            return tr.render(scene, spp=1, seed=4, params={n: v * scale for n, v in light.items()}, **settings)

        one = torch.ones(())
        return torch.func.jvp(image, (one,), (one,))

    image, derivative = both(correlated=True)
    torch.testing.assert_close(derivative, image, rtol=1e-4, atol=1e-5)
    image, derivative = both()
    differ = ((derivative - image).abs() > 1e-3).float().mean()
    assert differ > 0.3
    assert torch.equal(derivative, both()[1])


@pytest.mark.parametrize("left", [0, 32760, 65520])
def test_rows_of_very_wide_films_have_noise_of_their_own(left):
    # Light that is sampled from all around: neighbours, which see nearly the same point, differ by their noise alone.
    film = {"type": "hdrfilm", "width": 65536, "height": 8, "rfilter": {"type": "box"}}
    floor = {"type": "rectangle", "to_world": tr.Transform.scale(9)}
    sky = {"type": "envmap", "data": torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0))}
    scene = tr.load_dict({"type": "scene", "camera": {**SENSOR, "film": film}, "sky": sky, "floor": floor})
    part = tr.render(scene, spp=1, seed=0, crop=(0, left, 8, 16)).mean(-1)
    close = [(part[a] - part[b]).abs().max() < 1e-3 for a, b in itertools.combinations(range(8), 2)]
    assert not any(close)
