"""Checkpoints with textures, grids and meshes of another size."""

import pytest
import torch
from first_scene import make

import torchrender as tr


def textured(size):
    texels = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(size))
    plane = torch.stack(torch.meshgrid(*[torch.linspace(-1, 1, size)] * 2, indexing="ij"), -1).reshape(-1, 2)
    faces = torch.tensor([[i, i + 1, i + size] for i in range(size * (size - 1)) if (i + 1) % size])
    vertices = torch.cat([plane, torch.zeros(len(plane), 1)], 1)
    return make(
        ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texels}},
        sky={"type": "envmap", "data": texels},
        field={"type": "heightfield", "heights": texels[..., 0] * 0.1},
        sheet=tr.Mesh(vertices=vertices, faces=faces, vertex_texcoords=plane, attributes={"vertex_color": vertices}),
    )


def test_checkpoints_of_other_sizes_load():
    coarse, fine = textured(4), textured(7)
    parameters = coarse.train_only("ball.bsdf.reflectance.data", "field.heights", "sheet.vertex_positions")
    tr.render(coarse, spp=1)
    coarse.load_state_dict(fine.state_dict())
    for parameter, name in zip(parameters, ("ball.bsdf.reflectance.data", "field.heights"), strict=False):
        assert coarse.get_parameter(name) is parameter
    for name, tensor in fine.state_dict().items():
        assert torch.equal(coarse.state_dict()[name], tensor), name
    expected = tr.render(fine, spp=2, seed=0)
    image = tr.render(coarse, spp=2, seed=0)
    assert torch.equal(image, expected)
    image.sum().backward()
    assert coarse.get_parameter("ball.bsdf.reflectance.data").grad.shape == (7, 7, 3)


def test_checkpoints_that_do_not_fit_change_nothing():
    scene, fine = textured(4), textured(7).state_dict()
    before = {n: t.clone() for n, t in scene.state_dict().items()}
    for broken in (
        {**before, "sheet.vertex_positions": fine["sheet.vertex_positions"]},  # without the faces
        {**before, "sheet.faces": fine["sheet.faces"]},
        {**before, "ball.bsdf.reflectance.data": torch.zeros(3, 3)},
        {**before, "ball.bsdf.reflectance.data": torch.zeros(3, 3, 2)},
        {**before, "ball.center": torch.zeros(2)},
    ):
        with pytest.raises(RuntimeError, match="size mismatch"):
            scene.load_state_dict(broken)
        for name, tensor in scene.state_dict().items():
            assert torch.equal(tensor, before[name]), name
    tr.render(scene, spp=1)
