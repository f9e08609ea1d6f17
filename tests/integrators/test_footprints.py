"""Outputs duv_dx and duv_dy: closed form, differences along the film, derivatives in both modes, the AOV integrator."""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr

NAMES = ("duv_dx", "duv_dy")
FILM = {"type": "hdrfilm", "width": 12, "height": 9}
LOOK = tr.Transform.look_at([0.3, 0.2, 4], [0, 0, 0], [0, 1, 0])
CAMERAS = {
    "pinhole": {"type": "perspective", "fov": 30},
    "distorted": {"type": "perspective", "fov": 40, "distortion": [-0.3, 0.12, 0.01, -0.02, 0.03, 0.02, -0.03, 0.01]},
    "thinlens": {"type": "thinlens", "fov": 30, "aperture_radius": 0.2, "focus_distance": 3.5},
    "orthographic": {"type": "orthographic"},
    "fisheye": {"type": "fisheye", "fov": 60, "distortion": [0.05, -0.02, 0.01, -0.003], "max_angle": 80},
    "panorama": {"type": "panorama"},
}
WALL = tr.Mesh(
    torch.tensor([[-3.0, -3, -1], [3, -3, -0.4], [3, 3, -1], [-3, 3, -1.6]]),
    [[0, 1, 2], [0, 2, 3]],
    vertex_texcoords=torch.tensor([[0.1, 0.2], [0.9, 0.1], [1.1, 0.8], [0.0, 0.7]]),
)
CURVED = {
    "sphere": {"type": "sphere", "center": [0.1, 0, 0], "radius": 0.8},
    "cylinder": {"type": "cylinder", "p0": [-0.9, 0.1, 0], "p1": [0.8, -0.2, 0.4], "radius": 0.5},
    "disk": {"type": "disk", "to_world": tr.Transform.rotate([1, 1, 0], 30)},
    "hills": {"type": "heightfield", "heights": torch.sin(torch.arange(20.0)).reshape(4, 5) * 0.2},
}
SHAPES = {**CURVED, "wall": WALL}


def scene_of(camera: str = "pinhole", **objects) -> tr.Scene:
    sensor = {**CAMERAS[camera], "to_world": LOOK, "film": FILM}
    return tr.load_dict({"type": "scene", "camera": sensor, **objects}, dtype=torch.float64)


def centres() -> torch.Tensor:
    row, column = torch.meshgrid(torch.arange(9.0), torch.arange(12.0), indexing="ij")
    return torch.stack([column.reshape(-1), row.reshape(-1)], 1).double() + 0.5


def hits(scene: tr.Scene, positions: torch.Tensor) -> tr.queries.Hits:
    lens = (torch.full_like(positions, 0.5),) if scene.camera.type == "thinlens" else ()
    return tr.ray_intersect(scene, *scene.camera.rays(positions, *lens))


@pytest.mark.parametrize(("camera", "shape"), [*((c, "wall") for c in CAMERAS), *(("pinhole", s) for s in CURVED)])
def test_differences_along_the_film(camera, shape):
    scene = scene_of(camera, object=SHAPES[shape])
    found = tr.render(scene, outputs=NAMES, spp=1)
    at = centres()
    middle, step = hits(scene, at), 1e-5
    compared = 0
    for name, shift in zip(NAMES, torch.eye(2, dtype=torch.float64) * step, strict=True):
        sides = [hits(scene, at + sign * shift) for sign in (1, -1)]
        same = sides[0].valid & sides[1].valid & middle.valid & (sides[0].prim_id == sides[1].prim_id)
        expected = (sides[0].uv - sides[1].uv) / (2 * step)
        same &= expected.abs().amax(1) < 1e3  # the seam of a sphere
        result = getattr(found, name).reshape(-1, 2)
        torch.testing.assert_close(result[same], expected[same], rtol=1e-5, atol=1e-7)
        assert bool((result[~middle.valid] == 0).all())
        compared += int(same.sum())
    assert compared > (10 if camera == "panorama" else 40)


def test_closed_form():
    """A square of side 2 at distance 3, which fills half of the film's width: 6 pixels of 12, u to the left."""
    camera = {"type": "perspective", "fov": math.degrees(2 * math.atan(2 / 3)), "film": FILM}
    square = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, 3]) @ tr.Transform.rotate([0, 1, 0], 180)}
    scene = tr.load_dict({"type": "scene", "camera": camera, "square": square})
    found = tr.render(scene, outputs=NAMES, spp=1)
    expected = torch.zeros(9, 12, 2)
    expected[2:7, 3:9, 0] = 1 / 6
    torch.testing.assert_close(found.duv_dx[[2, 4, 6]], expected[[2, 4, 6]], atol=1e-6, rtol=0)
    torch.testing.assert_close(found.duv_dy[[2, 4, 6]], -expected.flip(-1)[[2, 4, 6]], atol=1e-6, rtol=0)


def test_parts_of_the_image_and_lists_of_cameras():
    scene = scene_of(object=SHAPES["sphere"], wall=WALL)
    whole = tr.render(scene, outputs=NAMES, spp=1)
    part = tr.render(scene, outputs=("duv_dy", "rgb", "depth"), spp=1, crop=(2, 3, 4, 5))
    assert torch.equal(part.duv_dy, whole.duv_dy[2:6, 3:8]) and part.rgb.shape == (4, 5, 3)
    pixels = torch.tensor([[8, 11], [4, 5], [4, 5], [0, 0]])
    assert torch.equal(tr.render(scene, outputs=("duv_dx",), pixels=pixels).duv_dx, whole.duv_dx[pixels.unbind(1)])
    views = tr.render(scene, outputs=("duv_dx",), sensor=[0, scene.camera], layout="bchw")
    assert torch.equal(views.duv_dx, whole.duv_dx.permute(2, 0, 1).expand(2, 2, 9, 12))


def test_hidden_emitters_are_looked_through():
    light = {"type": "area", "radiance": 1.0}
    wall = scene_of(wall=WALL)
    lit = scene_of(ball={**SHAPES["sphere"], "emitter": light}, wall=WALL)
    hidden = tr.render(lit, outputs=NAMES, integrator=tr.PathTracer(hide_emitters=True), spp=1)
    for name in NAMES:
        expected = getattr(tr.render(wall, outputs=NAMES, spp=1), name)
        torch.testing.assert_close(getattr(hidden, name), expected, rtol=1e-9, atol=1e-12)
    assert not torch.allclose(tr.render(lit, outputs=NAMES, spp=1).duv_dx, hidden.duv_dx)


CASES = [
    ("pinhole", "sphere", "object.radius"),
    ("pinhole", "cylinder", "object.p1"),
    ("pinhole", "disk", "object.to_world"),
    ("pinhole", "hills", "object.heights"),
    ("pinhole", "wall", "object.vertex_positions"),
    ("pinhole", "wall", "object.vertex_texcoords"),
    ("pinhole", "sphere", "camera.to_world"),
    ("distorted", "wall", "camera.distortion"),
    ("distorted", "wall", "camera.x_fov"),
    ("fisheye", "wall", "camera.distortion"),
    ("thinlens", "wall", "camera.principal_point_offset_x"),
]


@pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
@pytest.mark.parametrize(("camera", "shape", "name"), CASES)
def test_derivatives_of_footprints(camera, shape, name):
    """Reverse and forward mode against central differences, of pixels whose hits do not change."""
    scene = scene_of(camera, object=SHAPES[shape])
    pixels = torch.tensor([[4, 6], [5, 4], [3, 6]])
    generator = torch.Generator().manual_seed(2)
    weights = torch.randn(2, 3, 2, generator=generator, dtype=torch.float64)
    value = scene.get_parameter(name).detach().clone()
    direction = torch.randn(value.shape, generator=generator, dtype=torch.float64)
    if name.endswith("to_world"):
        direction[3] = 0

    def total(v: torch.Tensor) -> torch.Tensor:
        found = tr.render(scene, outputs=NAMES, pixels=pixels, spp=1, params={name: v})
        return (torch.stack(found) * weights).sum()

    leaf = value.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(total(leaf), leaf)
    reverse = float((gradient * direction).sum())
    _, forward = torch.func.jvp(total, (value,), (direction,))
    step = 1e-5
    with torch.no_grad():
        difference = float((total(value + step * direction) - total(value - step * direction)) / (2 * step))
    assert reverse == pytest.approx(difference, rel=1e-5, abs=1e-8) and abs(reverse) > 1e-6
    assert float(forward) == pytest.approx(reverse, rel=1e-9)


def test_aov_integrator():
    scene = scene_of(object=SHAPES["sphere"], constant={"type": "constant"})
    expected = tr.render(scene, outputs=NAMES, spp=1)
    integrator = tr.AOV("dx:duv_dx,dd:depth,dy:duv_dy", tr.PathTracer())
    image = tr.render(scene, integrator=integrator, spp=4, seed=1)
    assert integrator.channel_names() == ["R", "G", "B", "dx.U", "dx.V", "dd.T", "dy.U", "dy.V"]
    assert torch.equal(image[..., 3:5], expected.duv_dx) and torch.equal(image[..., 6:], expected.duv_dy)
