"""The surface of height fields in PyTorch: values, slopes, meshes."""

import pytest
import torch

import torchrender as tr

pytestmark = pytest.mark.once  # formulas in PyTorch

DOUBLE = torch.float64


@pytest.mark.parametrize("interpolation", ["bspline", "bilinear"])
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (5, 1), (7, 9)])
def test_slopes_are_the_derivatives_of_heights(interpolation, shape):
    generator = torch.Generator().manual_seed(1)
    heights = torch.randn(*shape, generator=generator, dtype=DOUBLE)
    uv = torch.rand(50, 2, generator=generator, dtype=DOUBLE, requires_grad=True)
    z, z_u, z_v = tr.heightfield.evaluate(heights, uv, interpolation)
    (slope,) = torch.autograd.grad(z.sum(), uv)
    assert torch.allclose(slope, torch.stack([z_u, z_v], 1), atol=1e-12)


def test_a_spline_keeps_planes_and_a_bilinear_surface_its_heights():
    v, u = torch.meshgrid(*((torch.arange(n, dtype=DOUBLE) + 0.5) / n for n in (6, 8)), indexing="ij")
    plane = 0.3 + 0.7 * u - 0.2 * v
    uv = torch.rand(40, 2, generator=torch.Generator().manual_seed(2), dtype=DOUBLE) * 0.5 + 0.25
    z, z_u, z_v = tr.heightfield.evaluate(plane, uv)
    assert torch.allclose(z, 0.3 + 0.7 * uv[:, 0] - 0.2 * uv[:, 1])
    assert torch.allclose(z_u, torch.full_like(z, 0.7)) and torch.allclose(z_v, torch.full_like(z, -0.2))
    heights = torch.randn(6, 8, generator=torch.Generator().manual_seed(3), dtype=DOUBLE)
    assert torch.allclose(tr.heightfield.evaluate(heights, torch.stack([u, v], -1), "bilinear")[0], heights)


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_a_mesh_lies_on_the_surface_and_turns_with_its_normals(scale):
    heights = torch.randn(4, 5, generator=torch.Generator().manual_seed(4), dtype=DOUBLE, requires_grad=True)
    matrix = tr.Transform.translate([1, 2, 3]).rotate([1, 1, 0], 30).scale([2, scale, 0.5])
    vertices, faces, normals, texcoords = tr.heightfield.mesh(heights, matrix, (40, 60))
    assert vertices.shape == (41 * 61, 3) and faces.shape == (2 * 40 * 60, 3) and faces.dtype == torch.int32
    z = tr.heightfield.evaluate(heights, texcoords)[0]
    inverse = torch.linalg.inv(matrix.matrix)
    local = vertices @ inverse[:3, :3].T + inverse[:3, 3]
    assert torch.allclose(local, torch.cat([2 * texcoords - 1, z[:, None]], 1))
    a, b, c = vertices.detach()[faces.long()].unbind(1)
    flat = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    assert float((flat * normals.detach()[faces.long()[:, 0]]).sum(1).min()) > 0.8
    mesh = tr.Mesh(vertices=vertices, faces=faces, vertex_normals=normals, vertex_texcoords=texcoords)
    assert torch.equal(mesh.vertex_texcoords.detach(), texcoords.detach())
    (gradient,) = torch.autograd.grad(vertices.sum(), heights)
    assert bool((gradient != 0).all())


def test_arguments_are_named():
    heights = torch.zeros(2, 2)
    with pytest.raises(ValueError, match=r"uv: expected .* \(\.\.\., 2\), got .*3"):
        tr.heightfield.evaluate(heights, torch.zeros(4, 3))
    with pytest.raises(TypeError, match="heights: expected a floating-point tensor"):
        tr.heightfield.evaluate(torch.zeros(2, 2, dtype=torch.int32), torch.zeros(1, 2))
    with pytest.raises(ValueError, match="heights: expected a tensor of shape"):
        tr.heightfield.mesh(torch.zeros(0, 2))
    with pytest.raises(ValueError, match="resolution: expected two positive integers"):
        tr.heightfield.mesh(heights, resolution=(0, 3))
    with pytest.raises(ValueError, match="interpolation: expected one of bspline, bilinear"):
        tr.heightfield.grid(heights, (2, 2), "cubic")
