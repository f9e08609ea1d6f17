"""Light paths that carry nothing: they are traced where something may depend on them, and nowhere else."""

import pytest
import torch

import torchrender as tr
from scenes import make_caustics


def scene_of(filter_type: str, dtype=torch.float64) -> tr.Scene:
    """A plate under a light of coloured and black squares."""
    heights = 0.002 * torch.sin(torch.linspace(0, 9, 16))[:, None] * torch.cos(torch.linspace(0, 7, 16))
    scene = make_caustics.caustics(heights, resolution=16, spp=16)
    scene["lamp"]["emitter"]["radiance"]["filter_type"] = filter_type
    return tr.load_dict(scene, dtype=dtype)


def gradient(scene: tr.Scene, *trained: str) -> tuple[torch.Tensor, int]:
    """By the heights, and the number of rays that the derivative traced."""
    scene.zero_grad()
    scene.train_only(make_caustics.LENS, *trained)
    image = tr.render(scene, spp=16, seed=3)
    (image * torch.linspace(0, 1, 16, dtype=image.dtype)[:, None, None]).sum().backward()
    traced = scene.statistics["vjp"]["closest_rays"]
    return scene.get_parameter(make_caustics.LENS).grad.clone(), traced


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("filter_type", ["nearest", "bilinear"])
def test_black_light_changes_no_derivative_of_shapes(filter_type):
    scene = scene_of(filter_type)
    alone, rays = gradient(scene)
    beside, more = gradient(scene, "lamp.emitter.radiance.data")
    assert torch.allclose(alone, beside, rtol=1e-9, atol=1e-12 * float(beside.abs().max()))
    assert float(alone.abs().max()) > 0
    # a quarter of the texels is black, and gets a sixteenth of the paths: they are needed by the derivative of the
    # texels alone. Between 4096 paths the share of them is known to 0.004.
    assert (rays < 0.95 * more) == (filter_type == "nearest")


def test_black_texels_have_derivatives():
    scene = scene_of("nearest")
    (texels,) = scene.train_only("lamp.emitter.radiance.data")
    tr.render(scene, spp=64, seed=1).sum().backward()
    black = texels.detach().sum(-1) == 0
    assert black.float().mean() == 0.25 and float((texels.grad[black] > 0).double().mean()) > 0.5
