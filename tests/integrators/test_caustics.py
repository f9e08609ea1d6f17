"""The scene of the caustics: energy, and the derivative of a loss by its heights."""

from __future__ import annotations

import numpy as np
import torch

import torchrender as tr
from scenes import make_caustics as caustics

HEIGHTS = caustics.LENS


def smooth(size: int, seed: int, amplitude: float) -> torch.Tensor:
    """Random heights (size, size) whose waves are several texels long."""
    coarse = torch.randn(1, 1, 8, 8, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return amplitude * torch.nn.functional.interpolate(coarse, size=(size, size), mode="bicubic")[0, 0]


def test_derivative_of_the_loss_against_finite_differences():
    # Without reflection there is no choice on the way, so that with common random numbers the loss is a smooth function
    # of the heights. Both sides are averages over the same 12 seeds; the difference of the two is held to three of its
    # standard errors (probability 1 % with 11 degrees of freedom) and to 1 %.
    scene = tr.load_dict(caustics.caustics(smooth(48, 1, 0.004), resolution=24), dtype=torch.float64)
    heights = scene.get_parameter(HEIGHTS).detach().clone()
    direction = smooth(48, 2, 1.0)
    target = tr.render(scene, params={HEIGHTS: smooth(48, 3, 0.004)}, spp=32, seed=99)
    target = target / target.mean()

    def loss(image: torch.Tensor) -> torch.Tensor:
        return ((image / image.mean().detach() - target) ** 2).mean()

    step, derivatives, differences = 1e-6, [], []
    for seed in range(12):
        x = heights.clone().requires_grad_()
        image = tr.render(scene, params={HEIGHTS: x}, spp=8, seed=seed, correlated=True)
        (slope,) = torch.autograd.grad(loss(image), x)
        derivatives.append(float((slope * direction).sum()))
        scale = image.mean().detach()  # which the loss takes as given
        ends = []
        for sign in (1, -1):
            moved = tr.render(scene, params={HEIGHTS: heights + sign * step * direction}, spp=8, seed=seed)
            ends.append(float(((moved / scale - target) ** 2).mean()))
        differences.append((ends[0] - ends[1]) / (2 * step))
    found, expected = np.array(derivatives), np.array(differences)
    error = (found - expected).mean()
    assert abs(error) <= 0.01 * abs(expected.mean()), (found.mean(), expected.mean())
    assert abs(error) <= 3 * (found - expected).std(ddof=1) / np.sqrt(len(found)) + 1e-4 * abs(expected.mean())


def test_energy_on_the_screen_is_what_the_light_sends_through():
    # A meter on the screen; two surfaces that light crosses at right angles let through (1 - R)^2 and reflect no
    # energy to it, R = ((n - 1) / (n + 1))^2. Which way a path takes is drawn: with 6400 of them the standard error is
    # 0.36 %, and 1 % is 2.8 of it (probability 0.5 %).
    description = caustics.caustics(np.zeros((2, 3)), colour=False)
    del description["sensor"]
    description["screen"]["meter"] = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 40, "height": 40}}
    scene = tr.load_dict(description)
    image = tr.render(scene, spp=4, seed=1)
    power = float(image[..., 0].mean()) * 100  # the screen is 10 x 10
    emitted = 0.8 * 4
    assert abs(power / (emitted * (1 - 0.04) ** 2) - 1) < 0.01
    wavy = tr.render(scene, params={HEIGHTS: smooth(64, 4, 0.004)[:2, :3].float()}, spp=4, seed=1)
    assert torch.isfinite(wavy).all()
