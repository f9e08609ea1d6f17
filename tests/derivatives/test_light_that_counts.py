"""Derivatives of BSDFs alone leave out the light of vertices before the first BSDF that is differentiated.

Where lights are differentiated, too, nothing is left out: gradients of BSDFs are the same to rounding, since others
stand beside each other in packets.
"""

from __future__ import annotations

import pytest
import reference_scenes
import torch
from small_things import THING, small_things

import torchrender as tr

LIGHTS = ("radiance", "intensity", "irradiance", "sky", "lamp", "emitter", "sun")
SIZE = 16


def gradient(scene: tr.Scene, name: str, **settings) -> torch.Tensor:
    image = tr.render(scene, spp=4, seed=3, **settings)
    adjoint = torch.randn(image.shape, generator=torch.Generator().manual_seed(2)).to(image.dtype)
    return torch.autograd.grad(image, scene.get_parameter(name), adjoint)[0]


def room() -> tr.Scene:
    """The Cornell box, whose boxes have a reflectance of their own."""
    return tr.load_file("scenes/cornell_box.xml", resolution=32, variant="mono", dtype=torch.float64)


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize("settings", [{}, {"correlated": True}, {"sampler": "independent"}], ids=str)
@pytest.mark.parametrize("name", sorted(reference_scenes.SCENES))
def test_gradients_of_bsdfs_alone_are_those_beside_lights(name, settings):
    scene = tr.load_dict(reference_scenes.in_few_pixels(name, SIZE), dtype=torch.float64)
    scene.train_only("*")
    trained = [n for n, p in scene.named_parameters() if p.requires_grad]
    lights = [n for n in trained if any(word in n for word in LIGHTS)]
    values = [n for n in trained if n not in lights and "bsdf" in n]
    assert values
    for value in values:
        scene.train_only(value, *lights)
        beside = gradient(scene, value, **settings)
        scene.train_only(value)
        alone = gradient(scene, value, **settings)
        torch.testing.assert_close(alone, beside, rtol=1e-11, atol=1e-11 * float(beside.abs().max()))


def test_few_rays_are_traced_for_a_small_thing():
    """All four vertices that scatter send a ray to the lamp, those before the box's do not."""
    scene = room()
    rays = {}
    for what in ("box.reflectance.value", "*.reflectance.value"):
        scene.train_only(what)
        tr.render(scene, spp=16, seed=0).sum().backward()
        rays[what] = scene.statistics["vjp"]
    few, many = rays.values()
    assert few["shadow_rays"] < 0.6 * many["shadow_rays"]
    assert few["closest_rays"] < many["closest_rays"]


@pytest.mark.parametrize("depth", [2, 3, 5])
@pytest.mark.parametrize("wrapped", [False, True])
def test_rays_to_the_last_vertex_that_scatters_pass_small_things_by(wrapped, depth):
    """Where no vertex before has a derivative they are not traced; gradients are those beside the sky's."""
    scene = tr.load_dict(small_things(wrapped), dtype=torch.float64)
    found, rays = [], []
    for names in ([THING], [THING, "sky.radiance.value"]):
        scene.train_only(*names)
        found.append(gradient(scene, THING, integrator=tr.PathTracer(max_depth=depth, rr_depth=100)))
        rays.append(scene.statistics["vjp"]["closest_rays"])
    torch.testing.assert_close(*found, rtol=1e-11, atol=0)
    assert float(found[0].abs().max()) > 0
    assert rays[0] < {2: 0.95, 3: 0.75, 5: 1}[depth] * rays[1]


def test_boxes_are_those_of_now():
    """The ball comes before the wall, where rays meet it that pass its old place by."""
    scene = tr.load_dict(small_things(False), dtype=torch.float64)
    integrator = tr.PathTracer(max_depth=3, rr_depth=100)
    scene.train_only(THING)
    gradient(scene, THING, integrator=integrator)
    with torch.no_grad():
        scene.get_parameter("ball.to_world").copy_(
            torch.tensor([[0.4, 0, 0, 0], [0, 0.4, 0, 0.4], [0, 0, 0.4, 0.8], [0, 0, 0, 1]])
        )
    found = gradient(scene, THING, integrator=integrator)
    scene.train_only(THING, "sky.radiance.value")
    torch.testing.assert_close(found, gradient(scene, THING, integrator=integrator), rtol=1e-11, atol=0)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_the_derivative_of_a_thing_alone(mode):
    """By the reflectance of the box: the same beside the lamp's radiance."""
    scene = room()
    found = []
    for patterns in (["box.reflectance.value"], ["box.reflectance.value", "*radiance*"]):
        scene.train_only(*patterns)
        box = scene.get_parameter("box.reflectance.value")
        if mode == "reverse":
            found.append(torch.autograd.grad(tr.render(scene, spp=16, seed=0).sum(), box)[0])
        else:
            tangents = {n: torch.zeros_like(p) for n, p in scene.named_parameters() if p.requires_grad}
            tangents["box.reflectance.value"] += 1
            values = {n: scene.get_parameter(n).detach() for n in tangents}
            _, change = torch.func.jvp(lambda v: tr.render(scene, spp=16, seed=0, params=v), (values,), (tangents,))
            found.append(change)
    torch.testing.assert_close(*found, rtol=1e-11, atol=1e-14)
    assert float(found[0].abs().sum()) > 0
