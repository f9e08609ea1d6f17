"""Light paths through media that bend them: power, derivatives, and the path tracer's picture of the same scene."""

from __future__ import annotations

import pytest
import torch
from bent_scenes import BOX, DOUBLE, centers, random_index, square_box
from gradientindex_scenes import T, derivatives, seen, thrown

import torchrender as tr
from scenes.make_grin import beam_and_screen

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")


def test_power_arrives_whole():
    """A beam of 0.8 x 0.8 through a matched boundary, on a screen of area 4."""
    image = tr.render(thrown(random_index(8, 0.01)), spp=16, seed=0)
    assert float(image.mean()) * 4 == pytest.approx(0.64, rel=2e-3)  # the filter's weights add up to one on average


def test_rays_along_an_axis_but_for_rounding_arrive():
    """A constant index leaves directions with components of 1e-17."""
    image = tr.render(thrown(torch.full((8, 8, 8), 1.5)), spp=16, seed=0)
    assert float(image.mean()) * 4 == pytest.approx(0.64, rel=3e-3)


def test_power_through_glass_is_what_fresnel_leaves():
    """A constant index, straight on: (1 - R)^2 at once, and what is reflected between the faces after."""
    scene = thrown(1.5, "dielectric")
    image = tr.render(scene, integrator=tr.ParticleTracer(40, 99), spp=256, sampler="stratified", seed=0)
    r = (0.5 / 2.5) ** 2
    assert float(image.mean()) * 4 == pytest.approx(0.64 * (1 - r) / (1 + r), rel=2e-3)


@pytest.mark.parametrize("name", ["index", "to_world", "sigma_t.value.value", "index_base"])
def test_derivatives_are_those_of_the_picture(name):
    scene = thrown(random_index(8, 0.01), sigma_t=0.2)
    reverse, forward, difference = derivatives(scene, f"lens.interior_medium.{name}", spp=8)
    assert abs(reverse) > 1e-3
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert difference == pytest.approx(reverse, rel=2e-4)  # the film's filter has a finite support


def test_a_lens_throws_what_the_path_tracer_sees():
    """A wide lamp behind a ball whose index grows inwards; a floor before it, seen by a camera.

    By both integrators, in eight seeds each: z of every pixel of 4 x 4 below 4.5, 7e-6 for each.
    """
    z, y, x = torch.meshgrid(*[(torch.arange(16.0) + 0.5) / 8 - 1] * 3, indexing="ij")
    index = 1.0 + 0.3 * torch.clamp(1 - (x * x + y * y + z * z), min=0)
    back = {
        "lamp": {
            "type": "rectangle",
            "to_world": T.translate([0, 0, -2.5]) @ T.scale(0.8),
            "emitter": {"type": "area", "radiance": 5.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T.translate([0, 0, 1.6]) @ T.rotate([0, 1, 0], 180),
            "bsdf": {"type": "diffuse", "reflectance": 0.8},
        },
    }
    scene = seen(index.double(), back=back, size=4)
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    place = T.look_at([0, 0, 0.0], [0, 0, 1.6], [0, 1, 0]) @ T.translate([0, 0, 1.05])
    camera = tr.load_dict({"type": "perspective", "fov": 100, "to_world": place, "film": film})
    images = {}
    for integrator, spp in ((tr.PathTracer(4, 99), 4096), (tr.ParticleTracer(5, 99), 16384)):
        runs = [tr.render(scene, sensor=camera, integrator=integrator, spp=spp, seed=s)[..., 0] for s in range(8)]
        images[type(integrator).__name__] = torch.stack(runs)
    a, b = images.values()
    assert float(a.mean()) > 0.01
    z_score = (a.mean(0) - b.mean(0)) / ((a.var(0) + b.var(0)) / 8).sqrt()
    assert float(z_score.abs().max()) < 4.5, z_score


def test_a_luneburg_lens_brings_a_beam_to_a_point():
    """n^2 = 2 - r^2: parallel light meets on the far side. All of it within one texel of a meter behind the ball."""
    x, y, z = centers(48, 1.1)
    index = torch.clamp(2 - (x * x + y * y + z * z), min=0.2).sqrt()
    interior = {"type": "gradientindex", "index": index, "to_world": square_box(1.1)}
    ball = {"type": "sphere", "interior": interior, "bsdf": {"type": "null"}}
    screen = T.translate([0, 0, 1.001]) @ T.rotate([0, 1, 0], 180) @ T.scale(0.15)
    film = {"width": 15, "height": 15, "rfilter": {"type": "box"}}
    scene = tr.load_dict({**beam_and_screen(0.5, -2, screen, film), "ball": ball}, dtype=DOUBLE)
    image = tr.render(scene, spp=64, seed=0)[..., 0]
    assert float(image[7, 7] / image.sum()) > 0.999
    assert float(image.sum()) * (0.3 / 15) ** 2 == pytest.approx(1.0, rel=1e-6)


def test_small_differences_of_a_gas_keep_their_precision():
    """Air of 1.00027 with differences of 1e-5, in single precision: a straight ramp deflects by slope times length."""
    slope = 1e-5
    values = torch.linspace(-0.5, 0.5, 20).expand(4, 4, 20).contiguous()
    interior = {"type": "gradientindex", "index": values, "index_base": 1.00027, "index_scale": slope, "to_world": BOX}
    described = {"type": "scene", "box": {"type": "cube", "interior": interior, "bsdf": {"type": "null"}}}
    scene = tr.load_dict(described, dtype=torch.float32)
    origins, directions = torch.tensor([[0.0, 0.0, -3.0]]), torch.tensor([[0.0, 0.0, 1.0]])
    rays = tr.gradientindex.trace(scene, "box", origins, directions)
    expected = slope / 19 * 10 * 2 / 1.00027  # 1 / 19 a voxel of 0.1, along 2
    assert float(rays.direction[0, 0]) == pytest.approx(expected, rel=5e-3)
