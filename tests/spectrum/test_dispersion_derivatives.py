"""Derivatives by indices of refraction that depend on the wavelength, and by the numbers of their formulas."""

from __future__ import annotations

import functools
import math

import pytest
import torch
from spectral_objects import DOUBLE, SIGNIFICANCE, assert_mean, camera, colour, diffuse, load, waves
from test_dispersion import glass, normal_reflectance, slab, sphere

import torchrender as tr

sp = tr.spectrum
pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
ETA = "ball.bsdf.eta.value"


def double(*values) -> torch.Tensor:
    return torch.tensor(values, dtype=DOUBLE)


# N-BK7's coefficients, of Schott's data sheet
B, C = double(1.03961212, 0.231792344, 1.01046945), double(6.00069867e-3, 2.00179144e-2, 103.560653)
FORMULAS = {
    "cauchy": (lambda x: sp.cauchy(x[0], x[1]), double(1.5, 0.004), double(1.0, 0.004)),
    "sellmeier": (lambda x: sp.sellmeier(x, C), B, double(1.0, 0.5, 0.3)),
    "sellmeier's C": (lambda x: sp.sellmeier(B, x), C, double(4e-3, 6e-3, 20.0)),
    "abbe": (lambda x: sp.abbe(x[0], x[1]), double(1.5168, 64.17), double(1.0, 30.0)),
    "table": (lambda x: x, sp.glass("SF10"), waves(1, 0.3, 1.0)),
}


def tangents(scene: tr.Scene, make, value, direction, spp: int, seeds: range, name: str = ETA) -> torch.Tensor:
    settings = {"spp": spp, "correlated": True, "sampler": "independent"}  # pixels are runs

    def image(x, seed):
        return tr.render(scene, seed=seed, params={name: make(x)}, **settings)

    return torch.stack([torch.func.jvp(functools.partial(image, seed=s), (value,), (direction,))[1] for s in seeds])


# Nothing is moved here: paths go straight.
def test_reflection():
    make, value, direction = FORMULAS["cauchy"]
    window = {"type": "rectangle", "bsdf": glass(make(value), specular_transmittance=0.0)}
    scene = load({"camera": camera(32, fov=0.01), "window": window, "sky": {"type": "constant", "radiance": waves(1)}})
    found = tangents(scene, make, value, direction, 64, range(1), "window.bsdf.eta.value")
    n, dn = torch.func.jvp(make, (value,), (direction,))
    exact = 4 * (n - 1) / (n + 1) ** 3 * dn
    assert_mean(found.flatten(0, 2), sp.to_rgb(exact * waves(1)), systematic=2e-4)
    assert float(normal_reflectance(n).max()) < 0.06


@pytest.mark.parametrize("formula", FORMULAS)
def test_two_refractions(formula):
    """Of 2 n / (n^2 + 1), which comes through a pane."""
    make, value, direction = FORMULAS[formula]
    found = tangents(slab(make(value)), make, value, direction, 64, range(1), "pane.bsdf.eta.value")
    n, dn = torch.func.jvp(make, (value,), (direction,))
    exact = 2 * (1 - n**2) / (n**2 + 1) ** 2 * dn
    assert_mean(found.flatten(0, 2), sp.to_rgb(exact * waves(2)), formula)


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_forward_and_reverse_mode(formula, dtype):
    make, value, direction = (x.to(dtype) if isinstance(x, torch.Tensor) else x for x in FORMULAS[formula])
    scene = sphere(glass(make(value)), dtype=dtype)

    def image(x):
        return tr.render(scene, spp=4, seed=5, params={ETA: make(x)})

    _, tangent = torch.func.jvp(image, (value,), (direction,))
    weight = torch.linspace(-0.7, 1, tangent.numel(), dtype=dtype).reshape(tangent.shape)
    x = value.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((image(x) * weight).sum(), x)
    size = float((tangent * weight).abs().sum())
    assert size > 0 and bool(torch.isfinite(gradient).all())
    error = abs(float((gradient * direction).double().sum() - (tangent * weight).double().sum()))
    assert error <= (1e-10 if dtype == DOUBLE else 1e-4) * size


@pytest.mark.parametrize("formula", ["cauchy", "sellmeier"])
def test_bent_light(formula):
    """A ball before a smooth sky: means over seeds against differences with common random numbers, in blocks.

    Where a path chooses to reflect instead of to refract, a difference jumps: many samples, and a wide step.
    """
    make, value, direction = FORMULAS[formula]
    scene = sphere(glass(make(value)), depth=4)
    seeds, spp, step = range(32), 32, 1e-2
    found = tangents(scene, make, value, direction, spp, seeds)

    def image(x, seed):
        with torch.no_grad():
            return tr.render(scene, spp=spp, seed=seed, params={ETA: make(x)})

    above, below = value + step * direction, value - step * direction
    difference = found - torch.stack([(image(above, s) - image(below, s)) / (2 * step) for s in seeds])
    difference = difference.reshape(len(seeds), 4, 4, 4, 4, 3).mean((2, 4))[:, 1:3, 1:3].flatten(1)
    t = difference.mean(0) / (difference.std(0) / math.sqrt(len(seeds)))
    level = tr.testing.sidak(SIGNIFICANCE, len(t))
    assert bool((tr.testing.student_p_value(t, len(seeds) - 1) >= level).all()), t
    # it is a test: the derivative is far from zero, and the noise small beside it
    means = found.mean((0, 3))[4:12, 4:12]
    assert float(difference.std(0).max()) / math.sqrt(len(seeds)) < 0.3 * float(means.abs().max())


@pytest.mark.parametrize("variant", ["rgb", "mono"])
def test_one_index_in_other_variants(variant):
    """That at 589.3 nm: a leaf that was given keeps its gradient."""
    table = sp.glass("F2").requires_grad_()
    scene = sphere({"type": "dielectric", "int_ior": table, "ext_ior": 1.0}, variant)
    tr.render(scene, spp=4, seed=1).sum().backward()
    assert torch.equal(table.grad.nonzero().flatten(), torch.tensor([229, 230]))
    share = table.grad[230] / table.grad.sum()
    assert float(share) == pytest.approx(0.3, abs=1e-9)
    plain = sphere({"type": "dielectric", "eta": float(torch.lerp(*table.detach()[229:231], 0.3))}, variant)
    eta = plain.get_parameter("ball.bsdf.eta").requires_grad_()
    (expected,) = torch.autograd.grad(tr.render(plain, spp=4, seed=1).sum(), eta)
    assert float(table.grad.sum()) == pytest.approx(float(expected), rel=1e-8)


def test_what_lies_behind_glass():
    """By a table and a texture that are seen through two refractions and by reflection."""
    floor = {
        "type": "rectangle",
        "to_world": tr.Transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
        "bsdf": diffuse({"type": "bitmap", "data": torch.rand(3, 3, 3, dtype=DOUBLE, generator=torch.Generator())}),
    }
    coloured = glass({"type": "glass", "name": "SF10"}, specular_transmittance=colour(0.9, 0.8, 0.7))
    back = tr.Transform.translate([0, 0, -2]).scale(3)
    objects = {
        "camera": camera(12, fov=40, origin=(0, 0.5, 4)),
        "ball": {"type": "sphere", "bsdf": coloured},
        "floor": floor,
        "wall": {"type": "rectangle", "to_world": back, "bsdf": diffuse(waves(3))},
        "sky": {"type": "constant", "radiance": waves(4)},
    }
    scene = load(objects, depth=5)  # roulette, whose chances change, begins later
    names = ("floor.bsdf.reflectance.data", "wall.bsdf.reflectance.value", "ball.bsdf.specular_transmittance.value")
    for name in names:
        value = scene.get_parameter(name).detach().clone()

        def image(x, name=name):
            return tr.render(scene, spp=4, seed=3, correlated=True, params={name: x})

        direction, step = torch.rand(value.shape, dtype=DOUBLE, generator=torch.Generator()) * 0.5, 1e-4
        tangent = torch.func.jvp(image, (value,), (direction,))[1]
        with torch.no_grad():
            difference = (image(value + step * direction) - image(value - step * direction)) / (2 * step)
        assert float((tangent - difference).abs().max()) <= 1e-6 * float(difference.abs().max()), name
        x = value.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(image(x).sum(), x)
        assert float((gradient * direction).sum()) == pytest.approx(float(tangent.sum()), rel=1e-9), name
