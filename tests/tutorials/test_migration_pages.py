"""What the pages for people from other renderers say about conventions, against the formulas of those renderers."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import torch

import torchrender as tr

PAGE = Path(__file__).resolve().parents[2] / "docs" / "from_redner_and_pytorch3d.md"


@pytest.fixture(scope="module")
def page():
    """The names that the functions of the page define."""
    names = {"tr": tr, "torch": torch}
    for block in re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL):
        for function in re.findall(r"^def .*?(?=^\S|\Z)", block, re.MULTILINE | re.DOTALL):
            exec(function, names)
    return names


@pytest.mark.parametrize("size", [(48, 64), (64, 48), (32, 32)])
def test_camera_sees_points_where_pytorch3d_projects_them(page, size):
    generator = torch.Generator().manual_seed(1)
    rotation = tr.rotation.so3_exp(torch.randn(3, generator=generator))
    translation, fov = torch.tensor([0.1, -0.2, 3.0]), 55.0
    points = 0.5 * torch.randn(8, 3, generator=generator)
    # pytorch3d.org/docs/cameras: row vectors; NDC of the shorter side is [-1, 1], +1 at the left and at the top
    view = points @ rotation + translation
    ndc = view[:, :2] / (math.tan(math.radians(fov) / 2) * view[:, 2:])
    pixels = torch.tensor([size[1], size[0]]) / 2 - ndc * min(size) / 2

    camera = page["to_camera"](rotation, translation, fov, size)
    rays = camera.rays(pixels.to(camera.to_world.dtype))
    centre = -rotation @ translation
    wanted = torch.nn.functional.normalize(points - centre, dim=1)
    torch.testing.assert_close(rays.directions.float(), wanted, rtol=0, atol=2e-6)


def test_texture_map_is_the_right_way_up(page):
    """TexturesUV: v = 1 is the first row of the map. The quad has v = 1 at its upper edge."""
    verts = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]])
    uvs = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    red, blue = torch.tensor([0.8, 0.1, 0.1]), torch.tensor([0.1, 0.1, 0.8])
    texture = torch.stack([red, blue])[:, None].expand(2, 3, 3)
    scene = tr.load_dict(
        {
            "type": "scene",
            "camera": page["to_camera"](torch.eye(3), torch.tensor([0.0, 0.0, 2.5]), 30.0, (8, 8)),
            "mesh": page["to_mesh"](verts, quad, uvs, quad, texture),
            "light": {"type": "point", "position": [0, 0, -3], "intensity": 10.0},
        }
    )
    with torch.no_grad():
        image = tr.render(scene, spp=4, seed=0)
    assert (image[0, :, 0] > 3 * image[0, :, 2]).all() and (image[-1, :, 2] > 3 * image[-1, :, 0]).all()


def test_vertices_on_seams_are_split_and_keep_their_gradients(page):
    """Two triangles share an edge and have texture coordinates of their own: six corners of four vertices."""
    verts = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], requires_grad=True)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    uvs = torch.rand(6, 2, generator=torch.Generator().manual_seed(2))
    mesh = page["to_mesh"](verts, faces, uvs, torch.arange(6).reshape(2, 3), torch.full((2, 2, 3), 0.5))
    assert mesh.vertex_positions.shape == (6, 3) and mesh.vertex_texcoords.shape == (6, 2)
    corners = mesh.vertex_positions[mesh.faces.long()]
    torch.testing.assert_close(corners.detach(), verts.detach()[faces], rtol=0, atol=0)
    torch.testing.assert_close(mesh.vertex_texcoords[mesh.faces.long()].reshape(6, 2).detach(), uvs, rtol=0, atol=0)
    corners.sum().backward()
    assert verts.grad.tolist() == [[2.0] * 3, [1.0] * 3, [2.0] * 3, [1.0] * 3]  # how many corners each vertex is


def test_camera_matrix_of_redner():
    """redner's columns are right, up and forward; ours are left, up and forward."""
    origin, target, up = torch.tensor([1.0, 2, 3]), torch.tensor([0.0, 0.5, 0]), torch.tensor([0.0, 1, 0])
    forward = torch.nn.functional.normalize(target - origin, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=0)
    theirs = torch.eye(4)
    theirs[:3] = torch.stack([right, torch.linalg.cross(right, forward), forward, origin], dim=1)
    ours = tr.Transform.look_at(origin, target, up).matrix.float()
    torch.testing.assert_close(theirs @ torch.diag(torch.tensor([-1.0, 1, 1, 1])), ours, rtol=0, atol=1e-6)
