"""`correlated=True`: the backward pass takes the hits of the image's rays, with the gradients of tracing them again."""

from __future__ import annotations

import gc
import warnings

import pytest
import reference_scenes
import torch
from small_scene import COLOUR, TEXELS, ball_and_wall

import torchrender as tr
from torchrender import autograd, backends

SIZE = 16


def make(name: str, **settings) -> tr.Scene:
    """A reference scene with few pixels, of which everything that can be is to be differentiated."""
    scene = tr.load_dict(reference_scenes.in_few_pixels(name, SIZE), **settings)
    scene.train_only("*")
    return scene


def in_use() -> int:
    gc.collect()
    return backends.core().hit_bytes_in_use()


def adjoint_of(image: torch.Tensor) -> torch.Tensor:
    """Random, and zero in a corner."""
    adjoint = torch.randn(image.shape, generator=torch.Generator().manual_seed(2)).to(image.dtype)
    adjoint[:3] = 0
    return adjoint


def gradients(scene: tr.Scene, **settings):
    """The image, gradients by name, and the rays that the backward pass traced."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)
        image = tr.render(scene, **{"spp": 4, "seed": 3, "correlated": True, **settings})
    names, leaves = zip(*((n, p) for n, p in scene.named_parameters() if p.requires_grad), strict=True)
    found = torch.autograd.grad(image, leaves, adjoint_of(image), allow_unused=True)
    stats = scene.statistics["vjp"]
    return image.detach(), dict(zip(names, found, strict=True)), stats["closest_rays"] + stats["shadow_rays"]


def assert_same(scene: tr.Scene, monkeypatch: pytest.MonkeyPatch, share: float = 0.0, **settings) -> None:
    """With and without kept hits, bit for bit; at most `share` of the rays are traced for the derivative."""
    image, kept, few = gradients(scene, **settings)
    with monkeypatch.context() as patch:
        patch.setattr(autograd, "STORED_HITS_LIMIT", 0)
        same, traced, many = gradients(scene, **settings)
    assert torch.equal(image, same)
    assert many > 0 and few <= share * many, (few, many)
    for name, expected in traced.items():
        assert expected is not None and torch.equal(kept[name], expected), name


# Where a colour is black or nearly so its derivative follows paths that the image has given up. Those are traced.
BLACK = ("area", "mesh", "rough_beckmann", "rough_ggx", "glossy", "principled", "cylinders")


@pytest.mark.parametrize("name", sorted(reference_scenes.SCENES))
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_gradients_are_those_of_tracing_again(name, dtype, monkeypatch):
    assert_same(make(name, dtype=dtype), monkeypatch, share=0.1 if name in BLACK else 0)


@pytest.mark.parametrize(
    "settings",
    [
        {"passes": 3},
        {"spp": 70, "crop": (2, 5, 7, 9)},
        {"pixels": torch.tensor([[1, 2], [9, 15], [3, 3], [9, 15]]), "spp": 300},
        {"integrator": tr.PathTracer(max_depth=-1, rr_depth=2)},
        {"integrator": tr.PathTracer(max_depth=-1, rr_depth=3, hide_emitters=True)},
        {"integrator": tr.PathTracer(max_depth=1)},
        {"integrator": tr.PathTracer(max_depth=0)},
        {"integrator": tr.DirectIllumination(emitter_samples=1, bsdf_samples=3, hide_emitters=True)},
        {"integrator": tr.DirectIllumination(emitter_samples=3, bsdf_samples=0)},
    ],
    ids=lambda s: ",".join(f"{k}={'..' if k == 'pixels' else v}" for k, v in s.items()),
)
def test_settings(settings, monkeypatch):
    if settings.get("integrator") is not None and settings["integrator"].config()["max_depth"] == 0:
        image, found, rays = gradients(make("area"), **settings)
        assert rays == 0 and not any(g.any() for g in found.values()) and not image.any()
        return
    assert_same(make("area"), monkeypatch, share=0.1, **settings)


def test_threads_in_between():
    scene = make("shapes")
    kept = torch.get_num_threads()
    try:
        for first, second in ((1, 3), (3, 1)):
            torch.set_num_threads(first)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", tr.MissingTermWarning)
                image = tr.render(scene, spp=70, seed=3, correlated=True)
            torch.set_num_threads(second)
            leaves = [p for p in scene.parameters() if p.requires_grad]
            found = torch.autograd.grad(image, leaves, adjoint_of(image))
            assert scene.statistics["vjp"]["closest_rays"] == 0
            expected = gradients(scene, spp=70)[1]
            assert all(torch.equal(a, b) for a, b in zip(found, expected.values(), strict=True))
    finally:
        torch.set_num_threads(kept)


def leaf(scene: tr.Scene) -> torch.Tensor:
    return scene.get_parameter(COLOUR).detach().clone().requires_grad_()


def test_life():
    scene, before = tr.load_dict(ball_and_wall()), in_use()
    colour = leaf(scene)
    image = tr.render(scene, seed=1, correlated=True, params={COLOUR: colour})
    kept = in_use() - before
    # two samples of 6 x 8 pixels, at most three hits of 20 bytes each
    assert 6 * 8 * 2 * 20 <= kept <= 6 * 8 * 2 * (3 * 20 + 4) + 1000
    (first,) = torch.autograd.grad(image.sum(), colour, retain_graph=True)
    assert in_use() - before == kept
    (second,) = torch.autograd.grad(image.sum(), colour)
    assert torch.equal(first, second) and scene.statistics["vjp"]["closest_rays"] == 0
    assert in_use() == before  # though the image is still there
    with pytest.raises(RuntimeError, match="second time"):
        image.sum().backward()
    image = tr.render(scene, seed=1, correlated=True, params={COLOUR: colour})
    assert in_use() > before
    del image
    assert in_use() == before


def test_kept_only_for_a_gradient():
    scene, before = tr.load_dict(ball_and_wall()), in_use()
    colour = leaf(scene)
    alive = [
        tr.render(scene, seed=1, correlated=True),
        tr.render(scene, seed=1, params={COLOUR: colour}),
        tr.render(scene, seed=1, correlated=True, spp_grad=3, params={COLOUR: colour}),
    ]
    with torch.no_grad():
        alive.append(tr.render(scene, seed=1, correlated=True, params={COLOUR: colour}))
    assert in_use() == before
    alive[2].sum().backward()
    assert scene.statistics["vjp"]["closest_rays"] > 0


def test_limit(monkeypatch):
    scene = make("area")
    settings = {"spp": 64, "passes": 2}
    _, expected, _ = gradients(scene, **settings)
    before = in_use()
    monkeypatch.setattr(autograd, "STORED_HITS_LIMIT", before + 2_000_000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)
        image = tr.render(scene, seed=3, correlated=True, **settings)
    assert 500_000 < in_use() - before <= 2_000_000
    other = tr.render(scene, seed=3, correlated=True, spp=64)  # the limit holds for both together
    assert in_use() - before <= 2_000_000
    leaves = [p for p in scene.parameters() if p.requires_grad]
    found = torch.autograd.grad(image, leaves, adjoint_of(image))
    assert all(torch.equal(a, b) for a, b in zip(found, expected.values(), strict=True))
    rays, image_rays = (scene.statistics[k]["closest_rays"] for k in ("vjp", "render"))
    assert 0 < rays < 2 * image_rays  # a part was kept
    del image, other
    assert in_use() == before


def test_with_other_ways_of_differentiating():
    scene = tr.load_dict(ball_and_wall())

    def loss(x: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, seed=1, correlated=True, params={COLOUR: x}).square().sum()

    colour = leaf(scene)
    loss(colour).backward()
    before = in_use()
    assert torch.equal(torch.func.grad(loss)(colour.detach()), colour.grad)
    assert scene.statistics["vjp"]["closest_rays"] == 0
    value, tangent = torch.func.jvp(loss, (colour.detach(),), (torch.ones(3),))
    torch.testing.assert_close(tangent, colour.grad.sum(), rtol=1e-4, atol=1e-5)
    again = torch.utils.checkpoint.checkpoint(loss, colour, use_reentrant=False)
    assert torch.equal(again, value)
    assert torch.equal(torch.autograd.grad(again, colour)[0], colour.grad)
    with torch.autograd.graph.save_on_cpu():  # what is saved are copies, and the hits are gone
        image = loss(colour)
    assert torch.equal(torch.autograd.grad(image, colour)[0], colour.grad)
    del again, image
    assert in_use() == before


def test_other_outputs():
    scene, before = tr.load_dict(ball_and_wall()), in_use()
    given = {n: scene.get_parameter(n).detach().clone().requires_grad_() for n in (COLOUR, TEXELS)}
    found = []
    for correlated in (True, False):
        out = tr.render(
            scene, seed=1, correlated=correlated, params=given, outputs=("rgb", "alpha", "albedo", "variance")
        )
        found.append(out)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
    torch.autograd.grad(found[0].albedo.sum(), list(given.values()), retain_graph=True)
    assert in_use() > before
    torch.autograd.grad(found[0].rgb.sum() + found[0].albedo.sum(), list(given.values()))
    assert scene.statistics["vjp"]["closest_rays"] == 0
    assert in_use() == before


def test_moved_in_between():
    # Another rendering moves the wall; the backward pass of the first one is about the wall where it was.
    scene = tr.load_dict(ball_and_wall())
    colour, moved = leaf(scene), scene.get_parameter("wall.to_world").detach().clone()
    moved[2, 3] -= 1
    first = tr.render(scene, seed=1, correlated=True, params={COLOUR: colour})
    tr.render(scene, seed=1, params={"wall.to_world": moved})
    (found,) = torch.autograd.grad(first.sum(), colour)
    again = tr.render(scene, seed=1, correlated=True, params={COLOUR: colour})
    assert torch.equal(found, torch.autograd.grad(again.sum(), colour)[0])
