"""Derivatives of images of participating media, also where the density is zero.

Against derivatives of deterministic results (quadratures along lines, plane layers), against finite differences, and
forward against reverse mode. Tests of means are Student's over independent seeds, which a right renderer fails with
probability `media_truth.SIGNIFICANCE` each, or as stated.
"""

from __future__ import annotations

import math

import media_scenes as ms
import media_truth as truth
import numpy as np
import pytest
import reference_scenes
import torch
from media_objects import DOUBLE, LIGHTS, STACKS, ball, colour, layers, random_grid, sky
from media_truth import assert_mean, cameras, lines, scene
from slab_truth import one_thread, vertical_radiance

import torchrender as tr
from torchrender.scene.derivatives import moves_rays

SEEDS = range(12)


def gradients_of(view: tr.Scene, names: list[str], weights: torch.Tensor, spp: int, **more) -> dict[str, torch.Tensor]:
    """Derivatives of the sum of weights (cameras, C) times what cameras see, for every seed: (seeds, ...) by name."""
    parameters = view.train_only(*names)
    found: dict[str, list[torch.Tensor]] = {name: [] for name in names}
    for seed in SEEDS:
        image = tr.render(view, sensor=list(range(len(view.sensors))), spp=1, spp_grad=spp, seed=seed, **more)
        value = (image.mean((1, 2)) * weights.to(image.dtype)).sum()
        for name, gradient in zip(names, torch.autograd.grad(value, parameters), strict=True):
            found[name].append(gradient.double())
    view.train_only()
    return {name: torch.stack(some) for name, some in found.items()}


def leaves(view: tr.Scene, names: list[str]) -> dict[str, torch.Tensor]:
    return {n: view.get_parameter(n).detach().clone().requires_grad_() for n in names}


def compare(view: tr.Scene, exact: dict[str, torch.Tensor], value: torch.Tensor, weights, spp: int, **tolerances):
    """Native derivatives by `exact` against those of `value`, the same weighted sum."""
    expected = torch.autograd.grad(value, list(exact.values()))
    for (name, found), wanted in zip(gradients_of(view, list(exact), weights, spp).items(), expected, strict=True):
        assert bool((wanted != 0).any()), name
        assert_mean(found, wanted, name, **tolerances)


def weights_of(cameras: int, channels: int = 3) -> torch.Tensor:
    """Of several signs, so that nothing is summed that should cancel."""
    return torch.linspace(1.0, -0.6, cameras, dtype=DOUBLE)[:, None] * torch.tensor([1.0, 0.7, 1.4])[:channels]


# ---------------------------------------------------------------------------------------------- quadratures along lines
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize(("filter_type", "channels"), [("trilinear", 1), ("trilinear", 3), ("nearest", 1)])
def test_absorption(filter_type, channels, dtype):
    """Of exp(-depth) by every voxel, a third of which are empty, by `scale` and by the sky."""
    origins, targets = lines(5, 21)
    medium = {"sigma_t": random_grid(22, (3, 4, 5, channels), filter_type=filter_type), "scale": 0.8, "albedo": 0.0}
    objects = {**cameras(origins, targets, 8), "ball": ball(medium, "heterogeneous"), "sky": sky([0.5, 1.0, 1.5])}
    view = scene(objects, dtype=DOUBLE)
    exact = leaves(view, ["ball.interior_medium.sigma_t.data", "ball.interior_medium.scale", "sky.radiance.value"])
    value = (truth.transmittance(view, origins, targets, exact) * exact["sky.radiance.value"] * weights_of(5)).sum()
    compare(scene(objects, dtype=dtype), exact, value, weights_of(5), 32, systematic=1e-3)


def test_absorption_of_a_constant():
    """Of exp(-s l) by s, a colour: -l exp(-s l)."""
    sigma = torch.tensor([0.2, 0.6, 1.2], dtype=DOUBLE)
    objects = {**cameras(np.array([[0.0, 0.0, 4.0]]), np.zeros((1, 3))), "sky": sky()}
    view = scene({**objects, "ball": ball({"sigma_t": colour(sigma.tolist()), "albedo": 0.0})})
    for channel in range(3):
        weights = torch.eye(3, dtype=DOUBLE)[channel : channel + 1]
        name = "ball.interior_medium.sigma_t.value.value"
        found = gradients_of(view, [name], weights, 16)[name]
        assert_mean(found, -2 * torch.exp(-2 * sigma) * weights[0], systematic=1e-3)


def test_emission_and_what_absorbs_it():
    """Of the integral of exp(-depth) emission, by both grids, neither of which is a multiple of the other."""
    origins, targets = lines(4, 23)
    medium = {"sigma_t": random_grid(24), "albedo": 0.0, "emission": random_grid(25, (2, 3, 3, 3), wrap_mode="mirror")}
    objects = {**cameras(origins, targets, 8), "ball": ball(medium, "heterogeneous")}
    view = scene(objects, dtype=DOUBLE)
    exact = leaves(view, [f"ball.interior_medium.{n}" for n in ("sigma_t.data", "emission.data", "scale")])
    value = (truth.along(view, origins, targets, params=exact, nodes=24) * weights_of(4)).sum()
    compare(scene(objects), exact, value, weights_of(4), 64, systematic=1e-2)


@pytest.mark.parametrize("extinction", ["grid", "coloured grid", "constant"])
def test_single_scattering(extinction):
    """By all that light and medium are made of, on the way to a collision and from there to a point light."""
    origins, targets = lines(3, 26)
    sigma = {
        "grid": random_grid(27, high=2.0),
        "coloured grid": random_grid(28, (2, 3, 3, 3), high=2.0, filter_type="nearest"),
        "constant": colour([0.4, 0.8, 1.6]),
    }[extinction]
    medium = {
        "sigma_t": sigma,
        "albedo": random_grid(29, (2, 3, 2, 3), high=0.9),
        "phase": {"type": "hg", "g": 0.4},
        "scale": 1.2,
    }
    light, arriving = LIGHTS["point"]
    objects = {**cameras(origins, targets, 8), "ball": ball(medium, "heterogeneous"), "light": light}
    view = scene(objects, 2, dtype=DOUBLE)
    density = "sigma_t.value.value" if extinction == "constant" else "sigma_t.data"
    names = [f"ball.interior_medium.{n}" for n in (density, "albedo.data", "phase_function.g", "scale")]
    exact = leaves(view, [*names, "light.intensity.value"])
    nodes = 16 if extinction == "constant" else 5
    with one_thread():
        value = (truth.along(view, origins, targets, arriving, exact, nodes) * weights_of(3)).sum()
        expected = torch.autograd.grad(value, list(exact.values()))
    found = gradients_of(scene(objects, 2), list(exact), weights_of(3), 128)
    for name, wanted in zip(exact, expected, strict=True):
        assert_mean(found[name], wanted, name, systematic=2e-2, precision=0.1)


# --------------------------------------------------------------------------------------------------------- plane layers
@pytest.mark.parametrize("name", STACKS)
def test_plane_layers(name):
    """Any number of scatterings, a floor: by all densities, albedos, emissions, and the rest.

    No layer is empty: the derivative by the density of an endless empty layer is infinite, as rays along it are.
    """
    sigma, albedo, emission, g, floor = STACKS[name]
    sigma = [max(0.1, s * (0.5 if name == "dense" else 1.0)) for s in sigma]
    view = scene(layers(sigma, albedo, emission, g, floor, 12), rr_depth=1000, variant="mono")
    names = {"sigma_t.data": sigma, "albedo.data": albedo, "emission.data": emission}
    exact = {f"box.interior_medium.{n}": torch.tensor(v, dtype=DOUBLE).requires_grad_() for n, v in names.items() if v}
    exact["floor.bsdf.reflectance.value"] = torch.tensor(floor, dtype=DOUBLE).requires_grad_()
    exact["sky.radiance.value"] = torch.tensor(1.0, dtype=DOUBLE).requires_grad_()
    exact["box.interior_medium.scale"] = scale = torch.tensor(1.0, dtype=DOUBLE).requires_grad_()
    asymmetry = torch.tensor(g, dtype=DOUBLE).requires_grad_()
    if g:
        exact["box.interior_medium.phase_function.g"] = asymmetry
    weights = torch.tensor([[1.0], [-0.7]], dtype=DOUBLE)
    with one_thread():
        found = vertical_radiance(
            exact["box.interior_medium.sigma_t.data"] * scale,
            exact["box.interior_medium.albedo.data"],
            exact.get("box.interior_medium.emission.data"),
            asymmetry,
            floor=exact["floor.bsdf.reflectance.value"],
            sky=exact["sky.radiance.value"],
        )
        value = (torch.stack(found) * weights[:, 0]).sum()
        compare(view, exact, value, weights, 32, systematic=5e-3, precision=0.2)


# --------------------------------------------------------------------------------------------------- finite differences
def blocks_of_a_cloud() -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Voxels (6, 6, 6, 1) of which some are empty, some thin and some dense, and which those are."""
    kind = torch.arange(216).reshape(6, 6, 6, 1).mul(7).remainder(11)
    masks = {"empty": kind < 4, "thin": (kind >= 4) & (kind < 8), "dense": kind >= 8}
    return torch.where(masks["thin"], 0.1, torch.where(masks["dense"], 4.0, 0.0)), masks


@pytest.mark.parametrize("regime", [0.2, 1.0, 5.0])
def test_blocks_of_a_cloud(regime):
    """Sums of the derivative over empty, thin and dense voxels against finite differences, in three optical regimes.

    The seeds of both are independent, so are those of the four or three images that make a difference; the test is
    Student's with 2 x 9 tests of 1e-3 together.
    """
    data, masks = blocks_of_a_cloud()
    name = "cloud.interior_medium.sigma_t.data"
    medium = {
        "type": "heterogeneous",
        "sigma_t": ms.grid(data.numpy(), ms.TURNED @ ms.UNIT_TO_CUBE),
        "scale": regime,
        "albedo": 0.9,
    }
    objects = {"camera": ms.view(fov=30.0), "cloud": ms.boundary(medium, ms.TURNED), "sky": sky()}
    objects["bulb"] = {"type": "point", "position": [1.5, 2.5, 2.0], "intensity": 20.0}
    view = scene(objects, 12, variant="mono", rr_depth=100)
    weight = torch.from_numpy(reference_scenes.weight(ms.SIZE, ms.SIZE, 1)).float()

    def value(x: torch.Tensor, seed: int, spp: int) -> float:
        with torch.no_grad():
            return float((tr.render(view, spp=spp, seed=seed, params={name: x}) * weight).mean())

    (leaf,) = view.train_only(name)
    ours = []
    for seed in range(12):
        image = tr.render(view, spp=1, spp_grad=32, seed=1000 + seed)
        ours.append(torch.autograd.grad((image * weight).mean(), leaf)[0])
    for what, mask in masks.items():
        # of fourth order; one-sided where the density must not become negative
        step = 0.4 / regime**0.5
        offsets, factors = (
            ((0, 1, 2, 3), (-11 / 6, 3, -1.5, 1 / 3))
            if what != "dense"
            else (
                (-2, -1, 1, 2),
                (1 / 12, -8 / 12, 8 / 12, -1 / 12),
            )
        )
        differences = [
            sum(f * value(data + mask * (step * k), seed, 48) for k, f in zip(offsets, factors, strict=True)) / step
            for seed in range(12)
        ]
        expected = torch.tensor(differences, dtype=DOUBLE)
        found = torch.stack([g[mask].sum() for g in ours]).double()
        error = math.sqrt(float(expected.var() + found.var()) / 12)
        difference = float(found.mean() - expected.mean())
        assert error < 0.1 * float(expected.mean().abs()) + 0.01, f"{what}: {error}"
        excess = max(0.0, abs(difference) - 0.01 * float(expected.mean().abs()))
        p = float(tr.testing.student_p_value(torch.tensor(excess / error), 11))
        assert p > tr.testing.sidak(1e-3, 9), (
            f"{what}: {found.mean():.5g}, differences {expected.mean():.5g} +- {error:.2g}"
        )


def differentiable(view: tr.Scene) -> list[str]:
    names = []
    for name, _ in view.named_parameters():
        try:
            view.train_only(name)
        except tr.NotDifferentiableError:
            continue
        names.append(name)
    view.train_only()
    return names


def values(view: tr.Scene) -> list[str]:
    """What moves nothing; for the rest see test_media_motion.py."""
    layout = view.layout()
    return [n for n in differentiable(view) if not moves_rays(layout.slots[layout.by_name[n]])]


@pytest.mark.parametrize("name", list(ms.SCENES))
def test_forward_and_reverse_mode_agree(name):
    view = tr.load_dict(ms.SCENES[name]().scene, dtype=DOUBLE)
    names = differentiable(view)
    assert sum(word in n for n in names for word in ("sigma_t", "albedo")) >= 2

    def f(*tensors):
        return tr.render(view, spp=2, seed=5, params=dict(zip(names, tensors, strict=True)))

    result = tr.testing.dot_product_test(f, [view.get_parameter(n).detach() for n in names], rtol=1e-10)
    assert result, result.message


SMOOTH = [
    (name, parameter)
    for name in ms.SCENES
    for parameter in values(tr.load_dict(ms.SCENES[name]().scene))
    if not parameter.endswith(("sigma_t.data", "sigma_t.value.value", "medium.scale", "haze.scale", "fog.scale"))
]


@pytest.mark.parametrize(("name", "parameter"), SMOOTH)
def test_finite_differences(name, parameter):
    """What does not say where collisions are: the same random numbers give the same paths."""
    view = tr.load_dict(ms.SCENES[name]().scene, dtype=DOUBLE)
    value = view.get_parameter(parameter).detach()
    weight = torch.from_numpy(reference_scenes.weight(ms.SIZE, ms.SIZE))
    generator = torch.Generator().manual_seed(11)

    def f(x, seed):
        # Derivatives have samples of their own: where one is asked for, those of the image do not matter.
        image = tr.render(view, spp=1 if x.requires_grad else 4, spp_grad=4, seed=seed, params={parameter: x})
        return (image * weight).mean()

    result = tr.testing.check_gradients(
        f,
        value,
        direction=torch.rand(value.shape, generator=generator, dtype=DOUBLE) + 0.5,
        step=1e-2 * max(1e-2, float(value.abs().max())),
        seeds=range(12),
        significance=0.01,
        tests=len(SMOOTH),
        rtol=1e-2,
    )
    assert result, result.message
