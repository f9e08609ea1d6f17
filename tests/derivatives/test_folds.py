"""Outlines of a fine mesh that turn back and forth: of edges closer to each other than rays can tell one counts."""

import math

import pytest
import torch

import torchrender as tr

WIDTH = 16  # of the film, in pixels, 8 of which are a unit


def folded_sheet(columns: int, bend: float) -> tr.Mesh:
    """A black sheet that comes down before another one, both out of the picture above.

    They meet in a strip that is seen from its edge. Its two rows of vertices lie on one curve, those of each between
    those of the other, so that the lower end of what is seen is now the one and then the other.
    """
    step = 3.0 / columns
    first = torch.arange(columns + 1) * step - 1.5
    rows = []
    for x, low, z in [(first + step / 2, False, 0.02), (first + step / 2, True, 0.02), (first, True, 0.0)]:
        rows.append(torch.stack([x, -0.3 - bend * x.square() if low else torch.full_like(x, 1.5), x * 0 + z], 1))
    rows.append(torch.stack([first, torch.full_like(first, 1.5), torch.full_like(first, -0.02)], 1))
    n, faces = columns + 1, []
    for row in range(3):
        for i in range(columns):
            a, c = row * n + i, (row + 1) * n + i
            faces += [(a, c, c + 1), (a, c + 1, a + 1)]
    return tr.Mesh(torch.cat(rows), torch.tensor(faces), bsdf={"type": "diffuse", "reflectance": 0.0})


def uncovered(scene: tr.Scene, bend: float) -> float:
    """The derivative of the sum over the picture where a folded sheet is raised."""
    scene["sheet"] = folded_sheet(60, bend)
    start = scene["sheet"].vertex_positions.detach().clone()
    raised = torch.zeros((), requires_grad=True)
    params = {"sheet.vertex_positions": start + raised * torch.tensor([0.0, 1.0, 0.0])}
    image = tr.render(scene, spp=1, spp_grad=16, seed=1, spp_visibility=64, params=params)
    (found,) = torch.autograd.grad(image[..., 0].sum(), raised)
    return float(found)


def picture(camera: dict, **objects: dict) -> tr.Scene:
    film = {"type": "hdrfilm", "width": WIDTH, "height": WIDTH, "rfilter": {"type": "box"}}
    path = {"type": "path", "max_depth": 2}
    return tr.load_dict({"type": "scene", "camera": {**camera, "film": film}, "integrator": path, **objects})


# By how much the lower ends stand out: 1e-3 to 1e-5 of a pixel; the last is at the precision of rays.
BENDS = [(0.2, 0.01), (0.02, 0.01), (0.002, 0.05)]


@pytest.mark.parametrize("camera", ["orthographic", "perspective"])
@pytest.mark.parametrize(("bend", "tolerance"), BENDS)
def test_a_sky_that_is_uncovered(camera, bend, tolerance):
    seen = {"type": camera, "to_world": tr.Transform.look_at([0, 0, 10], [0, 0, 0], [0, 1, 0])}
    if camera == "perspective":
        seen["fov"] = 2 * math.degrees(math.atan(0.1))
    scene = picture(seen, sky={"type": "constant", "radiance": 1.0})
    assert uncovered(scene, bend) == pytest.approx(8 * WIDTH, rel=tolerance)


@pytest.mark.parametrize(("bend", "tolerance"), BENDS)
def test_sunlight_that_is_let_through(bend, tolerance):
    seen = {"type": "orthographic", "to_world": tr.Transform.look_at([0, 0, -1], [0, 0, -2], [0, 1, 0])}
    sun = {"type": "directional", "direction": [0, 0, -1], "irradiance": 2 * math.pi}
    grey = {"type": "diffuse", "reflectance": 0.5}
    ground = {"type": "rectangle", "to_world": tr.Transform.translate([0, 0, -3]), "bsdf": grey}
    assert uncovered(picture(seen, sun=sun, ground=ground), bend) == pytest.approx(8 * WIDTH, rel=tolerance)
