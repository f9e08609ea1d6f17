"""Plastics: what the coat reflects is polarised as by glass, what comes from the base by the coat that it passes."""

from __future__ import annotations

import cmath
import math

import pytest
import torch
from optical_bench import under_sky
from polarized_derivatives import modes, room, two_means
from torch.autograd import forward_ad

import torchrender as tr

pytestmark = [pytest.mark.core, pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")]
T = tr.Transform
INDEX = {"int_ior": 1.5, "ext_ior": 1.0}
COATS = {
    "plastic": {"type": "plastic", "nonlinear": True, **INDEX},
    "roughplastic": {"type": "roughplastic", "alpha": 0.2, **INDEX},
    "pplastic": {"type": "pplastic", "alpha": 0.2, **INDEX},
}


def shares(angle: float, index: float = 1.5) -> tuple[float, float]:
    """(s - p) / (s + p) of what an interface reflects and of what it lets through."""
    c = math.cos(math.radians(angle))
    q = cmath.sqrt(index**2 - (1 - c * c)).real
    s, p = ((c - q) / (c + q)) ** 2, ((index**2 * c - q) / (index**2 * c + q)) ** 2
    return (s - p) / (s + p), ((1 - s) - (1 - p)) / ((1 - s) + (1 - p))


@pytest.mark.parametrize("angle", [30, 60, 80])
@pytest.mark.parametrize("coat", COATS)
def test_a_base_is_polarised_by_what_it_leaves_through(coat, angle):
    scene = under_sky(angle, {**COATS[coat], "specular_reflectance": 0.0})
    i, q, u, v = tr.render(scene, spp=256, seed=1, outputs=("stokes",)).stokes[0, 0, 0].tolist()
    assert i > 0.05 and q < 0
    # light comes from everywhere, unpolarised: what it gains on its way in is lost in the base
    assert abs(q / i - shares(angle)[1]) < 1e-5
    assert abs(u / i) < 1e-5 and v == 0


@pytest.mark.parametrize("angle", [30, 60, 80])
def test_a_smooth_coat_reflects_as_glass(angle):
    scene = under_sky(angle, {**COATS["plastic"], "diffuse_reflectance": 0.0})
    i, q, u, v = tr.render(scene, spp=16, seed=1, outputs=("stokes",)).stokes[0, 0, 0].tolist()
    assert abs(q / i - shares(angle)[0]) < 1e-5 and abs(u / i) < 1e-5 and v == 0


@pytest.mark.parametrize("coat", ["roughplastic", "pplastic"])
def test_a_rough_coat_reflects_as_rough_glass(coat):
    """The mirrored part alone, before a sky that is black below: the same directions, the same facets."""
    scenes = [
        under_sky(50, {"type": "roughdielectric", "alpha": 0.2, "specular_transmittance": 0.0, **INDEX}),
        under_sky(50, {**COATS[coat], "diffuse_reflectance": 0.0}),
    ]
    runs = [
        torch.stack([tr.render(s, spp=4096, seed=seed, outputs=("stokes",)).stokes[0, 0, 0] for seed in range(8)])
        for s in scenes
    ]
    error = (sum(r.var(0) for r in runs) / 8).sqrt() + 1e-9
    # Student, 7 degrees of freedom at least: 6 by chance in less than 6e-4 of the cases
    assert float(((runs[0].mean(0) - runs[1].mean(0)) / error).abs().max()) < 6
    assert abs(float(runs[1].mean(0)[1])) > 0.01


@pytest.mark.parametrize("coat", COATS)
def test_intensities_are_those_of_unpolarised_light(coat):
    """Behind one scattering of unpolarised light; the lobes' sum is the BSDF."""
    scene = under_sky(50, COATS[coat])
    polarised = tr.render(scene, spp=64, seed=3, outputs=("stokes",)).stokes[..., 0]
    torch.testing.assert_close(polarised, tr.render(scene, spp=64, seed=3), rtol=1e-12, atol=1e-14)


METAL = {"type": "conductor", "eta": 1.37, "k": 7.62}


@pytest.mark.parametrize("coat", COATS)
@pytest.mark.parametrize("name", ["ball.bsdf.eta", "ball.bsdf.diffuse_reflectance.value", "ball.center"])
def test_reverse_is_forward(coat, name):
    scene = room({**COATS[coat], "diffuse_reflectance": 0.4}, METAL)
    value = dict(scene.named_parameters())[name]
    modes(scene, name, torch.randn(value.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64))


@pytest.mark.parametrize("coat", COATS)
def test_means_of_derivatives(coat):
    """By the index, on which sampling depends, and by the place of a ball that mirrors polarised light.

    A small step would meet the few samples that change lobes too seldom.

    Means over 24 seeds against those of differences, of I, Q and U: 4.5 by chance in less than 2e-4 of the cases.
    """
    names = {
        "plastic": ("ball.bsdf.eta", "ball.center"),
        "roughplastic": ("ball.bsdf.alpha",),
        "pplastic": ("ball.center",),
    }
    for name in names[coat]:
        scene = room({**COATS[coat], "diffuse_reflectance": 0.4}, METAL)
        z, size = two_means(scene.to(torch.float32), name, step=2e-2)
        assert float(z.abs().max()) < 4.5 and size > 1e-4, (name, z, size)


def test_normals_turn_the_axes_of_the_base():
    """A plane that is tilted under a constant sky: only the angle at which its base is seen changes, and its axis."""
    scene = under_sky(55, {**COATS["pplastic"], "specular_reflectance": 0.0})
    matrix = scene.plane.to_world.detach().clone()
    turn = torch.zeros_like(matrix)
    turn[:3, :3] = torch.tensor([[0.0, 0.3, 0.8], [-0.3, 0.0, 0.5], [-0.8, -0.5, 0.0]]).double() @ matrix[:3, :3]

    def image(value: torch.Tensor) -> torch.Tensor:
        settings = {"spp": 4096, "seed": 1, "correlated": True, "visibility": False}
        return tr.render(scene, params={"plane.to_world": value}, outputs=("stokes",), **settings).stokes[0, 0, 0]

    with forward_ad.dual_level():
        value, tangent = forward_ad.unpack_dual(image(forward_ad.make_dual(matrix, turn)))
    ratio = (tangent[1:3] * value[0] - value[1:3] * tangent[0]) / value[0] ** 2
    # n' = turn n, of the unit normal z: the derivative of (Q, U) / I = b(cos) (cos 2t, sin 2t)
    a = math.radians(55)
    towards = torch.tensor([0, -math.sin(a), math.cos(a)], dtype=torch.float64)

    def closed(step: float) -> torch.Tensor:
        n = torch.tensor([0.8 * step, 0.5 * step, 1.0], dtype=torch.float64)
        n = n / n.norm()
        angle = math.degrees(math.acos(float(n @ towards)))
        right, up = torch.tensor([1.0, 0, 0], dtype=torch.float64), torch.tensor([0, math.cos(a), math.sin(a)])
        axis = torch.linalg.cross(n, towards)
        t = math.atan2(float(axis @ up.double()), float(axis @ right))
        return shares(angle)[1] * torch.tensor([math.cos(2 * t), math.sin(2 * t)], dtype=torch.float64)

    expected = (closed(1e-5) - closed(-1e-5)) / 2e-5
    assert float(expected.abs().min()) > 0.01
    torch.testing.assert_close(ratio, expected, rtol=2e-3, atol=2e-4)
