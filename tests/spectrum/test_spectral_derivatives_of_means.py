"""Derivatives of spectral images by what samples are chosen by, media and environments: of means over seeds, against
differences of images with common random numbers (`tr.testing.check_gradients`)."""

from __future__ import annotations

import pytest
import torch
from spectral_objects import DOUBLE, assert_mean, camera, colour, diffuse, load, waves

import torchrender as tr

sp = tr.spectrum
pytestmark = pytest.mark.core
SEEDS, SIGNIFICANCE = range(24), 0.01  # of all tests of this module together


def fog(dtype=DOUBLE, **medium) -> tr.Scene:
    """A cube of fog above a floor, in a lamp and a sky; it shines a little."""
    described = {
        "type": "homogeneous",
        "sigma_t": waves(70, 0.5, 2.0),
        "albedo": waves(71, 0.4, 0.95),
        "emission": waves(72, 0.0, 0.5),
        "phase": {"type": "hg", "g": 0.3},
        **medium,
    }
    turn = tr.Transform.rotate([0, 1, 0], 30).scale(0.8)
    objects = {
        "integrator": {"type": "volpath", "max_depth": 6, "rr_depth": 100},
        "camera": camera(8, fov=40, origin=(0, 0.8, 4)),
        "fog": {"type": "cube", "to_world": turn, "bsdf": {"type": "null"}, "interior": described},
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": diffuse(waves(73)),
        },
        "sky": {"type": "constant", "radiance": waves(74)},
        "bulb": {"type": "point", "position": [1, 2, 1], "intensity": colour(5.0, 6.0, 3.0)},
    }
    return load(objects, dtype=dtype)


def grid(*channels: int) -> torch.Tensor:
    shape = (3, 2, 2, *channels)
    return 0.2 + 0.7 * torch.rand(shape, generator=torch.Generator().manual_seed(4), dtype=DOUBLE)


def voxels(values: torch.Tensor) -> dict:
    return {"type": "gridvolume", "data": values}


MEDIA = {
    "tables": {},
    "colours": {"sigma_t": colour(0.5, 1.0, 1.5), "albedo": colour(0.9, 0.6, 0.8), "emission": colour(0.2, 0.1, 0.3)},
    "voxels": {
        "type": "heterogeneous",
        "sigma_t": voxels(grid(1)),
        "albedo": voxels(grid(3)),
        "emission": voxels(grid(3)),
    },
}
CASES = [(medium, part) for medium in MEDIA for part in ("sigma_t", "albedo", "emission")]


def name_of(scene: tr.Scene, part: str) -> str:
    (name,) = [
        n for n, _ in scene.named_parameters() if f"interior_medium.{part}." in n and n.endswith(("value", "data"))
    ]
    return name


def weighted(image: torch.Tensor) -> torch.Tensor:
    return (image * torch.linspace(0.2, 1, image.numel(), dtype=image.dtype).reshape(image.shape)).mean()


def check(scene: tr.Scene, name: str, spp: int, step: float = 1e-2, **settings) -> None:
    value = scene.get_parameter(name).detach().clone()

    def f(x, seed):
        # samples of the derivative's own are those of the image at the same seed
        return weighted(tr.render(scene, spp=spp, seed=seed, correlated=True, params={name: x}, **settings))

    direction = (0.5 + torch.rand(value.shape, generator=torch.Generator().manual_seed(1), dtype=DOUBLE)) * value.max()
    result = tr.testing.check_gradients(
        f,
        value,
        direction=direction,
        step=step,
        seeds=SEEDS,
        significance=SIGNIFICANCE,
        tests=len(CASES) + 2,
        rtol=2e-3,
    )
    assert result, f"{name}: {result.message}"
    error = float((result.standard_error / result.expected).abs().max())
    assert error < 0.1, f"{name}: noise {error:.2f}"


@pytest.mark.parametrize(("medium", "part"), CASES)
def test_media(medium, part):
    scene = fog(**MEDIA[medium])
    check(scene, name_of(scene, part), 64 if (medium, part) == ("voxels", "sigma_t") else 16)


def test_absorption_of_each_wavelength():
    """Of exp(-2 s), what is left of light behind 2 of fog, by the table s."""
    table = waves(70, 0.2, 1.5)
    medium = {"type": "homogeneous", "sigma_t": table, "albedo": 0.0}
    objects = {
        "integrator": {"type": "volpath", "max_depth": -1},
        "camera": camera(16, fov=0.01),
        "fog": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium},
        "sky": {"type": "constant", "radiance": 1.0},
    }
    scene = load(objects)
    name, direction = name_of(scene, "sigma_t"), waves(75)

    def image(x):
        return tr.render(scene, spp=16, seed=2, params={name: x}, sampler="independent")

    tangent = torch.func.jvp(image, (table,), (direction,))[1]
    exact = sp.to_rgb(-2 * direction * torch.exp(-2 * table), sp.d65())
    assert_mean(tangent.flatten(0, 1), exact)
    x = table.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(image(x).mean((0, 1)).sum(), x)
    assert float(gradient @ direction) == pytest.approx(float(tangent.mean((0, 1)).sum()), rel=1e-9)


@pytest.mark.parametrize("medium", MEDIA)
def test_forward_and_reverse_mode_of_media(medium):
    for dtype, rtol in ((DOUBLE, 1e-10), (torch.float32, 2e-4)):
        scene = fog(dtype, **MEDIA[medium])
        names = [name_of(scene, part) for part in ("sigma_t", "albedo", "emission")]
        names += ["floor.bsdf.reflectance.value", "sky.radiance.value", "bulb.intensity.value"]
        values = [scene.get_parameter(n).detach().clone() for n in names]

        def image(*tensors, scene=scene, names=names):
            return tr.render(scene, spp=4, seed=5, params=dict(zip(names, tensors)))

        result = tr.testing.dot_product_test(image, values, rtol=rtol)
        assert result, result.message


@pytest.mark.parametrize("name", ["sky.data", "floor.bsdf.reflectance.value"])
def test_environments(name):
    """Directions are chosen by the map; wavelengths by what else shines: a lamp whose table is 3000 K."""
    generator = torch.Generator().manual_seed(3)
    objects = {
        "camera": camera(8, fov=40, origin=(0, 0.8, 4)),
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": diffuse(waves(73)),
        },
        "ball": {"type": "sphere", "radius": 0.8, "bsdf": diffuse(colour(0.8, 0.5, 0.2))},
        "sky": {"type": "envmap", "data": 0.2 + torch.rand(4, 8, 3, generator=generator, dtype=DOUBLE)},
        "sun": {
            "type": "directional",
            "direction": [0, -1, -0.3],
            "irradiance": sp.blackbody(torch.tensor(3000.0, dtype=DOUBLE)) / 1e4,
        },
    }
    check(load(objects, depth=4), name, 16)


def test_lamps_in_expectation():
    """By a lamp's table, which the density of wavelengths follows: the mean is what it is without."""
    scene = load(
        {
            "camera": camera(16),
            "plate": {"type": "rectangle", "to_world": tr.Transform.scale(10), "bsdf": diffuse(waves(2))},
            "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": waves(1, 0.1, 2.0)},
        }
    )
    direction = waves(8, -1.0, 1.0)

    def image(x):
        return tr.render(scene, spp=64, seed=4, params={"sun.irradiance.value": x}, sampler="independent")

    tangent = torch.func.jvp(image, (waves(1, 0.1, 2.0),), (direction,))[1]
    assert_mean(tangent.flatten(0, 1), sp.to_rgb(direction * waves(2)) / torch.pi)
