"""What PyTorch computes, with the rays of the emulated device: numbers are the CPU's in one tree."""

from __future__ import annotations

import pytest
import small_scene
import torch
from emulated import check_close
from torch_bsdfs import Lambert, scene_with, wavefront

import torchrender as tr

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")


def check_same(device, scene: tr.Scene, parameters: list[torch.Tensor], **settings) -> None:
    """Image bit for bit, and gradients."""
    found = []
    for name in ("tree", "emulated"):
        device(name)
        image = tr.render(scene, spp=4, seed=2, **settings)
        image = image if isinstance(image, torch.Tensor) else image[-1]
        weights = torch.linspace(0.5, 1.5, image.numel()).reshape(image.shape)
        found.append((image, torch.autograd.grad((image * weights).sum(), parameters)))
    assert torch.equal(found[0][0], found[1][0])
    check_close(*({str(i): g for i, g in enumerate(gradients)} for _, gradients in (found[1], found[0])))


def test_features(device):
    given = {name: torch.rand(4, 5, 6, generator=torch.Generator().manual_seed(1)) for name in ("ball", "wall")}
    for texture in given.values():
        texture.requires_grad_(True)
    scene = tr.load_dict(small_scene.ball_and_wall())
    check_same(device, scene, [*given.values()], outputs=("rgb", "features"), features=given)


def test_the_wavefront_path_tracer(device):
    scene = tr.load_dict(small_scene.ball_and_wall())
    check_same(device, scene, scene.train_only("*.reflectance.value"), integrator=tr.WavefrontPathTracer(max_depth=4))


def test_bsdfs_in_pytorch(device):
    scene = scene_with(Lambert(), dtype=torch.float32)
    check_same(device, scene, [scene.get_parameter("ball.bsdf.albedo")], integrator=wavefront())
    with pytest.raises(ValueError, match=r"ball\.bsdf"):
        tr.render(scene, integrator=tr.PathTracer(), spp=1)
