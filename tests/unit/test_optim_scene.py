"""Constraints and upsampling on the parameters of a real scene, and the public test tools on a real renderer."""

import pytest
import torch
from torch.nn.utils import parametrize

import torchrender as tr

pytestmark = pytest.mark.core

NAME = "wall.bsdf.reflectance.data"


def textured_wall(size=4):
    """A textured square that fills the view, lit by constant light: the pixels are the texture."""
    texels = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "fov": 90,
                "to_world": tr.Transform.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "wall": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}},
            },
            "light": {"type": "constant"},
        }
    )


def fit(scene, target, optimizer, iterations, first=0):
    """Gradient descent on the squared error of the image; returns the last loss."""
    for i in range(iterations):
        optimizer.zero_grad()
        loss = (tr.render(scene, spp=8, seed=first + i) - target).square().mean()
        loss.backward()
        optimizer.step()
    return loss.item()


@pytest.mark.parametrize("optimizer_class", [tr.optim.MaskedAdam, tr.optim.UniformAdam, torch.optim.Adam])
def test_texture_recovered_with_upsampling(optimizer_class):
    truth = textured_wall()
    target = tr.render(truth, spp=256, seed=1000)
    scene = textured_wall()
    with torch.no_grad():
        scene.get_parameter(NAME).fill_(0.5)
    scene[NAME.split(".")[0]].bsdf.reflectance.data = torch.full((2, 2, 3), 0.5)
    parameters = scene.train_only("*.reflectance.data")
    optimizer = optimizer_class(parameters, lr=0.03)
    fit(scene, target, optimizer, 30)
    new = tr.optim.upsample(scene, NAME, (4, 4), optimizer)
    assert scene.get_parameter(NAME) is new and new.requires_grad and new.shape == (4, 4, 3)
    fit(scene, target, optimizer, 80, first=100)
    error = (new.detach() - truth.get_parameter(NAME)).abs().max()
    assert error < 0.06


def test_constrained_texture_stays_in_range_and_learns():
    scene = textured_wall()
    truth = scene.get_parameter(NAME).detach().clone()
    target = tr.render(scene, spp=256, seed=1000)
    texture = scene.get_submodule(NAME.rpartition(".")[0])
    with torch.no_grad():
        texture.data.fill_(0.5)
    texture.data.requires_grad_()
    parametrize.register_parametrization(texture, "data", tr.constraints.UnitInterval())
    raw = texture.parametrizations.data.original
    optimizer = torch.optim.Adam([raw.requires_grad_()], lr=0.15)
    fit(scene, target, optimizer, 80)
    assert (texture.data.detach() - truth).abs().max() < 0.06
    finer = tr.optim.upsample(scene, NAME, (8, 8), optimizer)
    assert finer.shape == (8, 8, 3) and tr.render(scene, spp=8, seed=0).shape == (16, 16, 3)


def test_public_tools_on_a_renderer():
    """Finite differences, the dot-product test and the z-test, on a scene whose image is linear in the texture."""
    scene = textured_wall()
    texels = scene.get_parameter(NAME).detach().clone()
    weight = torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(1))

    def loss(data, seed):
        return (tr.render(scene, spp=16, seed=seed, params={NAME: data}) * weight).mean()

    direction = torch.rand(texels.shape, generator=torch.Generator().manual_seed(2))
    result = tr.testing.check_gradients(loss, texels, direction=direction, step=0.05, seeds=range(12))
    assert result, result.message
    result = tr.testing.dot_product_test(lambda data: tr.render(scene, spp=16, seed=3, params={NAME: data}), texels)
    assert result, result.message
    few = tr.testing.mean_and_variance(lambda seed: tr.render(scene, spp=16, seed=seed), range(40))
    many = tr.testing.mean_and_variance(lambda seed: tr.render(scene, spp=64, seed=seed), range(100, 140))
    options = {"variance": few[1], "reference_variance": many[1], "block": 4}
    result = tr.testing.z_test(few[0], many[0], **options)
    assert result, result.message
    assert not tr.testing.z_test(few[0] * 1.01, many[0], **options)
