"""Caustics by both routes: a height field, and a mesh that PyTorch displaces, its vertex normals included."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

import torchrender as tr

SCENES = Path(__file__).resolve().parents[2] / "scenes"
pytestmark = [
    pytest.mark.once,  # the same integrator as in test_caustics
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
]


@pytest.fixture
def make_caustics(monkeypatch):
    monkeypatch.syspath_prepend(str(SCENES))
    import make_caustics

    yield make_caustics
    sys.modules.pop("make_caustics")


def heights_of(size: int) -> torch.Tensor:
    """Waves that move light by a few pixels of 32."""
    x = (2 * torch.arange(size) + 1) / size - 1
    return 2e-3 * torch.sin(5 * x[None] + 2 * x[:, None]) * torch.cos(4 * x[:, None] - x[None])


def test_a_displaced_mesh_gives_the_same_image_and_gradient(make_caustics):
    """With the same random numbers light takes the same ways, up to what is between a surface and its triangles."""
    heights = heights_of(32).requires_grad_()
    matrix = torch.tensor(make_caustics.FACING_DOWN, dtype=torch.float32)
    vertices, faces, normals, _ = tr.heightfield.mesh(heights, to_world=matrix, resolution=(256, 256))
    glass = {"type": "ref", "id": "glass"}
    mesh = tr.Mesh(vertices.detach(), faces, vertex_normals=normals.detach(), bsdf=glass)
    routes = [
        (heights.detach(), {make_caustics.LENS: heights}),
        (mesh, {"lens.vertex_positions": vertices, "lens.vertex_normals": normals}),
    ]
    weight = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0))
    images, gradients = [], []
    for lens, params in routes:
        scene = tr.load_dict(make_caustics.caustics(lens, resolution=32))
        image = tr.render(scene, spp=64, seed=3, params=params, correlated=True)
        images.append(image.detach())
        gradients += torch.autograd.grad((image * weight).mean(), heights, retain_graph=True)
    assert images[0].max() > 0.1
    assert (images[0] - images[1]).abs().max() < 0.01 * images[0].max()
    assert (gradients[0] - gradients[1]).norm() < 0.02 * gradients[0].norm()
    assert gradients[0].norm() > 0.1 * gradients[0].numel() ** 0.5 * gradients[0].abs().mean()


def test_a_moved_mesh_is_refitted_and_a_height_field_rebuilds_nothing(make_caustics):
    heights = heights_of(16)
    matrix = torch.tensor(make_caustics.FACING_DOWN, dtype=torch.float32)
    vertices, faces, normals, _ = tr.heightfield.mesh(heights, to_world=matrix, resolution=(128, 128))
    mesh = tr.Mesh(vertices, faces, vertex_normals=normals, bsdf={"type": "ref", "id": "glass"})
    for lens in (mesh, heights):
        scene = tr.load_dict(make_caustics.caustics(lens, resolution=8))
        seen, grown = [], {}
        for scale in (1, 2, 3, 4):  # when vertices move for the first time, their tree is made one that can be refitted
            with torch.no_grad():
                if lens is mesh:
                    moved, _, turned, _ = tr.heightfield.mesh(scale * heights, to_world=matrix, resolution=(128, 128))
                    scene.lens.vertex_positions.copy_(moved)
                    scene.lens.vertex_normals.copy_(turned)
                else:
                    scene.lens.heights.copy_(scale * heights)
            before = dict(scene.updates)
            seen.append(tr.render(scene, spp=4, seed=0))
            grown = {name: count - before[name] for name, count in scene.updates.items() if before}
        assert all(not torch.equal(seen[i], seen[i - 1]) for i in range(4))
        assert grown["mesh_rebuilds"] == 0 and grown["height_fields"] == (lens is heights)
        assert grown["mesh_refits"] == grown["meshes"] == (lens is mesh)
        assert lens is mesh or grown["tree_builds"] == 0
