"""Known numbers: conventions of environment maps, cameras and filters, and images with a closed form.

The conventions are Mitsuba 3's (values from its tests); the rest is radiometry.
"""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr


def scene_of(film: dict | None = None, **objects) -> tr.Scene:
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, **(film or {})}
    camera = objects.pop("camera", {"type": "perspective"})
    return tr.load_dict({"type": "scene", "camera": {**camera, "film": film}, **objects}, dtype=torch.float64)


def direction(u: float, v: float) -> torch.Tensor:
    """The direction of environment coordinates (u, v)."""
    phi, theta = 2 * math.pi * u, math.pi * v
    return torch.tensor([math.sin(phi) * math.sin(theta), math.cos(theta), -math.cos(phi) * math.sin(theta)]).double()


@pytest.mark.parametrize(("u", "v"), [(0.1, 0.2), (0.37, 0.5), (0.9, 0.81), (0.5, 0.999)])
def test_environment_coordinates(u, v):
    rows, columns = 9, 16
    down = torch.arange(rows).double()[:, None, None].expand(rows, columns, 3)
    right = torch.arange(columns).double()[None, :, None].expand(rows, columns, 3)
    for data, expected in ((down, v * (rows - 1)), (right, u * columns - 0.5)):
        scene = scene_of(sky={"type": "envmap", "data": data.clone()})
        radiance = tr.testing.emitter_density(scene, torch.zeros(3), direction(u, v)).radiance
        torch.testing.assert_close(radiance[0], torch.full((3,), expected).double(), rtol=1e-6, atol=1e-6)


def test_a_constant_environment_is_sampled_uniformly():
    scene = scene_of(sky={"type": "constant"})
    assert tr.testing.emitter_density(scene, torch.zeros(3), direction(0.3, 0.4)).pdf.item() == pytest.approx(
        1 / (4 * math.pi)
    )


def test_default_field_of_view_is_that_of_a_50_mm_lens():
    assert float(scene_of().get_parameter("camera.x_fov")) == pytest.approx(34.0221, abs=1e-4)


def test_irradiance_of_a_point_light():
    """A diffuse floor under a point light: rho / pi * I cos(theta) / d^2 at each point."""
    camera = {"type": "perspective", "fov": 1e-3, "to_world": tr.Transform.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])}
    position = torch.tensor([1.0, 2.0, 2.0]).double()
    scene = scene_of(
        camera=camera,
        floor={"type": "rectangle", "to_world": tr.Transform.scale(9), "bsdf": {"type": "diffuse", "reflectance": 0.5}},
        lamp={"type": "point", "position": position, "intensity": 7.0},
    )
    expected = 0.5 / math.pi * 7.0 * (2 / 3) / 9
    torch.testing.assert_close(
        tr.render(scene, spp=1, seed=0), torch.full((8, 8, 3), expected).double(), rtol=1e-4, atol=0
    )


def test_checkerboard_of_half_and_one():
    """Two squares of each colour: the mean under a constant sky is their mean."""
    board = {"type": "checkerboard", "color0": 0.5, "color1": 1.0}
    camera = {"type": "perspective", "fov": 90, "to_world": tr.Transform.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0])}
    scene = scene_of(
        camera=camera,
        integrator={"type": "path", "max_depth": 2},
        floor={"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": board}},
        sky={"type": "constant", "radiance": 1.0},
    )
    image = tr.render(scene, spp=4096, seed=1)  # 65536 samples a quarter: five standard deviations are 1 %
    # row 0 of the image is at v = 1 and u grows to the right
    quarters = image.reshape(2, 4, 2, 4, 3).mean((1, 3, 4))
    torch.testing.assert_close(quarters, torch.tensor([[1.0, 0.5], [0.5, 1.0]]).double(), rtol=1e-2, atol=0)


# A film that sees one bright pixel-sized light would need the filter itself; instead, the response to a step edge.
@pytest.mark.parametrize(
    ("rfilter", "integral"),
    [
        ({"type": "box"}, lambda x: min(max(x + 0.5, 0.0), 1.0)),
        (
            {"type": "tent", "radius": 1.0},
            lambda x: 0.5 + x - math.copysign(x * x / 2, x) if abs(x) < 1 else float(x > 0),
        ),
        ({"type": "gaussian", "stddev": 0.5}, lambda x: _gaussian_integral(x)),
    ],
    ids=["box", "tent", "gaussian"],
)
def test_reconstruction_filters(rfilter, integral):
    """An emitter fills the right half of the view: pixels across the edge measure the integral of the filter."""
    camera = {"type": "perspective", "fov": 90, "to_world": tr.Transform.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0])}
    scene = scene_of(
        {"width": 10, "height": 10, "rfilter": rfilter},
        camera=camera,
        half={
            "type": "rectangle",
            "to_world": tr.Transform.translate([5, 0, 0]) @ tr.Transform.scale([5, 5, 1]),
            "emitter": {"type": "area", "radiance": 1.0},
        },
    )
    image = tr.render(scene, spp=4096, seed=1)[3:7].mean((0, 2))
    expected = torch.tensor([integral(x + 0.5 - 5) for x in range(10)]).double()
    # weighted means of more than 16384 samples a pixel; the border pixels lack part of their filter
    torch.testing.assert_close(image[2:8], expected[2:8], rtol=0, atol=0.01)


def _tent_integral(x: float) -> float:
    x = min(max(x, -1.0), 1.0)
    return 0.5 + x - math.copysign(x * x / 2, x)


def _gaussian_integral(x: float) -> float:
    """Integral from -infinity to x of exp(-2 t^2) - exp(-8) on |t| < 2, normalised."""
    x = min(max(x, -2.0), 2.0)

    def primitive(t: float) -> float:
        return math.sqrt(math.pi / 8) * math.erf(math.sqrt(2) * t) - math.exp(-8) * t

    return (primitive(x) - primitive(-2)) / (primitive(2) - primitive(-2))
