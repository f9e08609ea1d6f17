"""`render(..., adaptive_grad=True)`: samples of the derivative in proportion to the incoming gradient."""

from __future__ import annotations

import pytest
import torch
from small_scene import COLOUR, TEXELS, ball_and_wall

import torchrender as tr
from torchrender.testing import z_test

HEIGHT, WIDTH = 20, 24
PIXELS = HEIGHT * WIDTH
BOX, TENT = {"type": "box"}, {"type": "tent", "radius": 1.0}


def make(rfilter: dict = BOX, **settings) -> tr.Scene:
    description = ball_and_wall(HEIGHT, WIDTH, **settings)
    description["sensor"]["film"]["rfilter"] = rfilter
    return tr.load_dict(description)


def uneven_adjoint(peak: float = 200.0) -> torch.Tensor:
    """Zero in a third of the image, random elsewhere, and one pixel, on the wall, far above."""
    adjoint = torch.randn((HEIGHT, WIDTH, 3), generator=torch.Generator().manual_seed(4))
    adjoint[:, :8] = 0
    adjoint[5, 16] *= peak
    return adjoint


def gradients(scene: tr.Scene, adjoint: torch.Tensor, spp_grad: int, **settings) -> torch.Tensor:
    """Of colour and texels, as one vector; closest-hit rays of the backward pass are in `scene.statistics`."""
    given = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in (COLOUR, TEXELS)}
    image = tr.render(scene, spp=1, spp_grad=spp_grad, params=given, **{"seed": 0, **settings})
    found = torch.autograd.grad((image * adjoint).sum(), list(given.values()))
    return torch.cat([g.flatten() for g in found]).double()


def assert_equal_means(runs: torch.Tensor, others: torch.Tensor, atol: float) -> None:
    """Of two sets of independent gradients, at a significance of 0.001 for all entries."""
    result = z_test(
        runs.mean(0),
        others.mean(0),
        variance=runs.var(0) / len(runs),
        reference_variance=others.var(0) / len(others),
        significance=0.001,
        atol=atol,
    )
    assert result, result.message


def count_samples(scene: tr.Scene, adjoint: torch.Tensor, spp_grad: int, **settings) -> int:
    """Samples of the backward pass: with paths of one segment as many as rays."""
    gradients(scene, adjoint, spp_grad, integrator=tr.PathTracer(max_depth=1), adaptive_grad=True, **settings)
    return int(scene.statistics["vjp"]["closest_rays"])


# 160 runs of 4 or 16 samples a pixel against 40 of 64 without allocation, at a significance of 0.001 for all entries.
# (With a filter that reaches further than a pixel both are quotients of sums, unbiased only in the limit of many
# samples, hence more of them.)
@pytest.mark.parametrize(("rfilter", "spp_grad"), [(BOX, 4), (TENT, 16)], ids=["box", "tent"])
def test_expectation_is_that_without_allocation(rfilter, spp_grad):
    scene, adjoint = make(rfilter), uneven_adjoint()
    runs = torch.stack([gradients(scene, adjoint, spp_grad, seed=i, adaptive_grad=True) for i in range(160)])
    plain = torch.stack([gradients(scene, adjoint, 64, seed=1000 + i) for i in range(40)])
    assert_equal_means(runs, plain, atol=1e-5)


def test_variance_is_smaller_at_as_many_samples():
    scene, adjoint = make(), uneven_adjoint()

    def variance(**settings) -> float:
        runs = torch.stack([gradients(scene, adjoint, 8, seed=i, **settings) for i in range(64)])
        return float(runs[:, :3].var(0).mean())

    # With 64 runs the ratio of two variances is above 2 with a probability below 0.01 where they are equal, and here
    # it is above 10.
    assert variance() > 3 * variance(adaptive_grad=True)


@pytest.mark.parametrize("spp_grad", [1, 2, 5, 16, 100])
def test_counts_add_up(spp_grad):
    scene = make()
    for adjoint in (uneven_adjoint(), torch.rand(HEIGHT, WIDTH, 3), torch.full((HEIGHT, WIDTH, 3), 2.0)):
        assert count_samples(scene, adjoint, spp_grad) == spp_grad * PIXELS
    single = torch.zeros(HEIGHT, WIDTH, 3)
    single[7, 9, 1] = -1e-30  # all of them in one pixel
    assert count_samples(scene, single, spp_grad) == spp_grad * PIXELS
    assert count_samples(scene, torch.zeros(HEIGHT, WIDTH, 3), spp_grad) == 0
    adjoint = uneven_adjoint()
    assert count_samples(scene, adjoint, spp_grad, passes=3) == 3 * spp_grad * PIXELS
    assert count_samples(scene, adjoint[2:13, 5:20], spp_grad, crop=(2, 5, 11, 15)) == spp_grad * 11 * 15
    pixels = torch.tensor([[3, 4], [5, 16], [19, 23], [3, 20], [5, 16]])  # four different ones
    assert count_samples(scene, adjoint[pixels[:, 0], pixels[:, 1]], spp_grad, pixels=pixels) == spp_grad * 4
    cameras = [0, 0]
    assert count_samples(scene, torch.stack([adjoint, adjoint]), spp_grad, sensor=cameras) == spp_grad * PIXELS


def test_parts_agree_with_the_whole_in_expectation():
    # A gradient of two pixels, as a list, against the whole with zeros elsewhere: other counts, the same expectation.
    scene, adjoint = make(), torch.zeros(HEIGHT, WIDTH, 3)
    pixels = torch.tensor([[5, 16], [12, 20], [5, 16]])
    adjoint[5, 16], adjoint[12, 20] = 4.0, 1.0
    parts = torch.tensor([[3.0] * 3, [1.0] * 3, [1.0] * 3])  # a pixel that is asked for twice has two parts
    part = torch.stack([gradients(scene, parts, 40, pixels=pixels, seed=i, adaptive_grad=True) for i in range(60)])
    whole = torch.stack([gradients(scene, adjoint, 1, seed=500 + i, adaptive_grad=True) for i in range(60)])
    assert_equal_means(part, whole, atol=1e-6)


def test_equal_adjoints_give_the_plain_gradient():
    scene = make()
    adjoint = torch.ones(HEIGHT, WIDTH, 3)
    for spp_grad in (1, 7, 100):
        plain = gradients(scene, adjoint, spp_grad)
        assert torch.equal(gradients(scene, adjoint, spp_grad, adaptive_grad=True), plain)
        assert torch.equal(gradients(scene, -0.5 * adjoint, spp_grad, adaptive_grad=True), -0.5 * plain)


def test_threads_and_repetition():
    scene, adjoint = make(TENT), uneven_adjoint()
    kept = torch.get_num_threads()
    found = []
    try:
        for number in (1, 2, 5):
            torch.set_num_threads(number)
            found.append(gradients(scene, adjoint, 70, adaptive_grad=True))
            assert torch.equal(gradients(scene, adjoint, 70, adaptive_grad=True), found[-1])
    finally:
        torch.set_num_threads(kept)
    for other in found[1:]:  # the same samples, summed in another order
        torch.testing.assert_close(other, found[0], rtol=1e-5, atol=1e-6)


def test_extreme_adjoints():
    scene = make()
    tiny, huge = torch.full((HEIGHT, WIDTH, 3), 1e-38), torch.full((HEIGHT, WIDTH, 3), 1e38)
    tiny[3, 3], huge[3, 3] = 1e-45, 3e38
    for adjoint in (tiny, huge):
        assert count_samples(scene, adjoint, 4) == 4 * PIXELS
    broken = torch.ones(HEIGHT, WIDTH, 3)
    broken[5, 16, 0] = float("nan")
    with pytest.warns(RuntimeWarning, match="not finite"):
        adaptive = gradients(scene, broken, 4, adaptive_grad=True)
    with pytest.warns(RuntimeWarning, match="not finite"):
        plain = gradients(scene, broken, 4)
    assert torch.equal(adaptive, plain)  # as without it


def test_forward_mode_and_other_outputs_are_as_without():
    scene, tangent = make(), torch.ones(3)

    def image(x: torch.Tensor, **settings) -> torch.Tensor:
        return tr.render(scene, spp=2, seed=0, params={COLOUR: x}, **settings)

    at = torch.full((3,), 0.5)
    _, plain = torch.func.jvp(image, (at,), (tangent,))
    _, adaptive = torch.func.jvp(lambda x: image(x, adaptive_grad=True), (at,), (tangent,))
    assert torch.equal(plain, adaptive)
    albedo = [
        torch.autograd.grad(image(x, outputs=("albedo",), **settings).albedo.square().sum(), x)[0]
        for settings in ({}, {"adaptive_grad": True})
        for x in (at.clone().requires_grad_(),)
    ]
    assert torch.equal(*albedo)


def test_errors():
    scene = make()
    with pytest.raises(TypeError, match="adaptive_grad: expected True or False, got"):
        tr.render(scene, adaptive_grad=1)
    with pytest.raises(ValueError, match=r"adaptive_grad=True .* correlated=True"):
        tr.render(scene, adaptive_grad=True, correlated=True)
    with pytest.raises(TypeError, match="adaptive_grad"):
        tr.Renderer(scene, adaptive_grad="yes")
    with pytest.raises(TypeError, match="correlated: expected True or False, got 1"):
        tr.Renderer(scene, correlated=1)
    renderer = tr.Renderer(scene, adaptive_grad=True, spp=1)
    assert torch.equal(renderer(seed=1), tr.render(scene, spp=1, seed=1))
