"""What must not change a result: precision, packets, threads, instruction sets. And furnaces, whose result is known.

The random numbers are the same in both precisions, so paths are the same up to rounding; a few decide otherwise at an
edge or in a roulette, hence the quantiles.
"""

from __future__ import annotations

import pytest
import reference_scenes
import torch
from instruction_sets import assert_equal_means

import torchrender as tr

SCENES = sorted(reference_scenes.SCENES)


def image_and_gradient(scene: tr.Scene) -> tuple[torch.Tensor, torch.Tensor]:
    words, fixed = ("reflectance", "radiance", "data", "intensity"), ("to_uv", "to_world", "scale", "sampling_rate")
    names = [n for n, _ in scene.named_parameters() if any(w in n for w in words) and not n.endswith(fixed)]
    parameters = scene.train_only(*names)
    image = tr.render(scene, spp=4, seed=3)
    gradients = torch.autograd.grad(image.square().mean(), parameters, allow_unused=False)
    return image.detach().double(), torch.cat([g.double().flatten() for g in gradients])


def most_agree(a: torch.Tensor, b: torch.Tensor, share: float, rtol: float) -> bool:
    scale = b.abs().mean().clamp(min=1e-12)
    return bool(((a - b).abs() <= rtol * (b.abs() + scale)).double().mean() >= share)


@pytest.mark.parametrize("name", SCENES)
def test_single_and_double_precision(name):
    single = image_and_gradient(tr.load_dict(reference_scenes.SCENES[name]().scene))
    double = image_and_gradient(tr.load_dict(reference_scenes.SCENES[name]().scene, dtype=torch.float64))
    assert most_agree(single[0], double[0], 0.97, 1e-3)
    # Gradients are sums over paths: a path that goes another way changes them by about its share.
    torch.testing.assert_close(single[1].sum(), double[1].sum(), rtol=0.02, atol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_packets_and_numbers(name, monkeypatch):
    scene = tr.load_dict(reference_scenes.SCENES[name]().scene)
    packets = image_and_gradient(scene)
    monkeypatch.setattr(tr.backends, "PACKETS", False)
    numbers = image_and_gradient(scene)
    assert most_agree(packets[0], numbers[0], 0.97, 1e-3)
    torch.testing.assert_close(packets[1].sum(), numbers[1].sum(), rtol=0.02, atol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_threads(name):
    """Images are equal bit for bit at any number of threads, gradients run to run at one number."""
    scene = tr.load_dict(reference_scenes.SCENES[name]().scene)
    kept = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 2, 8):
            torch.set_num_threads(threads)
            results.append(image_and_gradient(scene))
    finally:
        torch.set_num_threads(kept)
    one, two, again, eight = results
    assert torch.equal(one[0], two[0]) and torch.equal(one[0], eight[0])
    assert torch.equal(two[1], again[1])
    torch.testing.assert_close(one[1], two[1], rtol=1e-3, atol=1e-3 * float(one[1].abs().max()))


def test_instruction_sets():
    """Each compiled instruction set that this processor has gives the same images up to rounding along paths."""
    assert_equal_means("reference_scenes", spp=4, rtol=2e-3)


# ------------------------------------------------------------------------------------------------------------ furnaces
def furnace(bsdf: dict, integrator: dict, **settings) -> tr.Scene:
    """Inside a sphere that emits 1 and reflects: after n vertices the radiance is 1 + rho + ... + rho^(n-1)."""
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "camera": {"type": "perspective", "fov": 60, "film": film},
            "wall": {
                "type": "sphere",
                "radius": 3.0,
                "flip_normals": True,
                "bsdf": bsdf,
                "emitter": {"type": "area", "radiance": 1.0},
            },
        },
        **settings,
    )


@pytest.mark.parametrize("variant", ["mono", "rgb"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("integrator", "vertices"), [("direct", 2), (1, 1), (2, 2), (4, 4), (-1, None)])
def test_closed_furnace(variant, dtype, integrator, vertices):
    kind = {"type": "direct"} if integrator == "direct" else {"type": "path", "max_depth": integrator, "rr_depth": 3}
    scene = furnace({"type": "diffuse", "reflectance": 0.6}, kind, variant=variant, dtype=dtype)
    (rho,) = scene.train_only("wall.bsdf.reflectance.value")
    image = tr.render(scene, spp=256, seed=2)
    expected = 1 / 0.4 if vertices is None else sum(0.6**k for k in range(vertices))
    derivative = 1 / 0.4**2 if vertices is None else sum(k * 0.6 ** (k - 1) for k in range(1, vertices))
    # 36864 paths: five standard deviations of what is measured are below 2 % (values) and 4 % (derivatives)
    assert abs(float(image.detach().mean()) / expected - 1) < 0.02
    if vertices != 1:
        image.mean().backward()
        assert abs(float(rho.grad.sum()) / derivative - 1) < 0.04


def test_white_furnace_of_smooth_models():
    """Nothing is lost: a white, glass or perfectly reflecting ball under a uniform sky cannot be seen."""
    for bsdf in (
        {"type": "diffuse", "reflectance": 1.0},
        {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 1.0}},
        {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
        {"type": "conductor", "eta": 0.0, "k": 1.0},
        {"type": "null"},
    ):
        film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
        scene = tr.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": 64, "rr_depth": 64},
                "camera": {"type": "perspective", "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0]), "film": film},
                "ball": {"type": "sphere", "bsdf": bsdf},
                "sky": {"type": "constant", "radiance": 1.0},
            }
        )
        image = tr.render(scene, spp=256, seed=1)
        assert abs(float(image.mean()) - 1) < 0.01, bsdf  # 65536 paths, each with a value of about 1


def test_gradients_at_zero_albedo():
    """Of 1 + rho + rho^2 at rho = 0: one, although no path with that throughput goes on."""
    scene = furnace({"type": "diffuse", "reflectance": 0.0}, {"type": "path", "max_depth": 4}, dtype=torch.float64)
    (rho,) = scene.train_only("wall.bsdf.reflectance.value")
    tr.render(scene, spp=64, seed=1).mean().backward()
    assert abs(float(rho.grad.sum()) - 1) < 0.02  # 9216 paths, standard deviation below 0.004
