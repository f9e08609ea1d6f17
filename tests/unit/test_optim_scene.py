"""Constraints, upsampling and least squares on a real scene, and the public test tools on a real renderer."""

import pytest
import torch
from torch.nn.utils import parametrize

import torchrender as tr

pytestmark = pytest.mark.core

NAME = "wall.bsdf.reflectance.data"


def textured_wall(size=4):
    """A wall of random texels."""
    return wall_of(torch.rand(size, size, 3, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2)


def wall_of(texels, resolution=16, **more):
    """A textured square that fills the view, lit by constant light: the pixels are the texture."""
    return tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "fov": 90,
                "to_world": tr.Transform.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"}},
            },
            "wall": {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}},
            },
            "light": {"type": "constant"},
            **more,
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


def test_the_walls_of_a_bright_room():
    """Light by way of many reflections: shorter steps find the albedo, where whole ones go to and fro."""
    scene = tr.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 30, "rr_depth": 100},
            "sensor": {
                "type": "perspective",
                "fov": 60,
                "to_world": tr.Transform.look_at([0.5, 0.3, -0.8], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "walls": {"type": "cube", "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.85}}},
            "lamp": {"type": "point", "position": [0.2, 0.4, 0.1], "intensity": 1.0},
        }
    )
    (albedo,) = scene.train_only("walls.*.reflectance.value")
    with torch.no_grad():
        target = tr.render(scene, spp=256, seed=1 << 30)

    def last_errors(lr):
        with torch.no_grad():
            albedo.fill_(0.5)
        optimizer, errors = tr.optim.LeastSquares([albedo], lr=lr, high=0.99), []
        for it in range(30):
            optimizer.zero_grad()
            optimizer.step(tr.render(scene, spp=16, seed=it), target)
            errors.append(float((albedo.detach() - 0.85).abs().max()))
        return max(errors[-8:])

    assert last_errors(0.3) < 0.02 < last_errors(1.0)


def test_a_texture_is_found_in_few_steps_without_a_rate():
    """Adam, whose rate is the best of four, needs more than three times as many."""
    coarse = torch.rand(1, 3, 4, 4, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2
    texels = torch.nn.functional.interpolate(coarse, size=(16, 16), mode="bilinear")[0].movedim(0, 2)

    lights = {
        "integrator": {"type": "path", "max_depth": 3},
        "lamp": {"type": "point", "position": [0.3, 0.2, 2.0], "intensity": 10.0},
        "light": {"type": "constant", "radiance": 0.5},
    }

    def wall(data):
        scene = wall_of(data, 48, **lights)
        (found,) = scene.train_only(NAME)
        return scene, found

    with torch.no_grad():
        target = tr.render(wall(texels)[0], spp=64, seed=1 << 30)

    def steps_until(limit, make, count):
        scene, found = wall(torch.full((16, 16, 3), 0.5))
        step = make(scene, found)
        for it in range(count):
            step(it)
            if (found - texels).square().mean().sqrt() < limit:
                return it + 1
        return count + 1

    def light(scene, found):
        optimizer = tr.optim.LeastSquares([found], high=1.0)

        def step(it):
            optimizer.zero_grad()
            optimizer.step(tr.render(scene, spp=4, seed=it), target)

        return step

    def adam(rate):
        def make(scene, found):
            optimizer = torch.optim.Adam([found], lr=rate)

            def step(it):
                optimizer.zero_grad()
                (tr.render(scene, spp=4, seed=it) - target).square().mean().backward()
                optimizer.step()
                with torch.no_grad():
                    found.clamp_(0, 1)

            return step

        return make

    assert steps_until(0.03, light, 40) <= 5
    assert min(steps_until(0.03, adam(rate), 15) for rate in (0.02, 0.05, 0.1, 0.2)) > 15
