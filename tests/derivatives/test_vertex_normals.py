"""Normals that follow from positions: values, derivatives of both modes and orders, degenerate meshes, threads."""

import math

import pytest
import torch

from torchrender.scene.normals import by_torch, vertex_normals


def sheet(n: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A bent, irregular sheet of n x n vertices."""
    generator = torch.Generator().manual_seed(seed)
    x, y = (a.flatten() for a in torch.meshgrid(torch.linspace(-1, 1, n), torch.linspace(-1, 1, n), indexing="ij"))
    moved = 0.4 / n * torch.rand(n * n, 3, generator=generator)
    k = torch.arange(n * n).reshape(n, n)
    corners = [k[:-1, :-1], k[1:, :-1], k[:-1, 1:], k[1:, 1:]]
    a, b, c, d = (part.flatten() for part in corners)
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([d, c, b], 1)]).int()
    return (torch.stack([x, y, 0.3 * torch.sin(3 * x) * y], 1) + moved).double(), faces


def test_a_corner_of_a_cube_looks_along_its_diagonal():
    positions = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    faces = torch.tensor([[0, 2, 1], [0, 3, 2], [0, 1, 3]])
    normal = vertex_normals(positions, faces)[0]
    torch.testing.assert_close(normal, torch.full((3,), -math.sqrt(1 / 3), dtype=torch.float64))


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-6), (torch.float64, 1e-14)])
def test_the_core_and_pytorch_agree(dtype, tolerance):
    positions, faces = sheet(40)  # more faces than a packet, and not a multiple of it
    weights = torch.rand(positions.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = positions.to(dtype).requires_grad_()
    exact = positions.clone().requires_grad_()
    normals, expected = vertex_normals(found, faces), by_torch(exact, faces)
    torch.testing.assert_close(normals.double(), expected, rtol=0, atol=tolerance)
    torch.testing.assert_close(normals.norm(dim=1), torch.ones(len(normals), dtype=dtype))
    (g,) = torch.autograd.grad(normals, found, weights.to(dtype))
    (h,) = torch.autograd.grad(expected, exact, weights)
    torch.testing.assert_close(g.double(), h, rtol=0, atol=tolerance * 30 * float(h.abs().max()))
    one = torch.func.jvp(lambda p: vertex_normals(p, faces), (positions.to(dtype),), (weights.to(dtype),))[1]
    two = torch.func.jvp(lambda p: by_torch(p, faces), (positions,), (weights,))[1]
    torch.testing.assert_close(one.double(), two, rtol=0, atol=tolerance * 30 * float(two.detach().abs().max()))


def test_derivatives_are_those_of_differences_in_both_modes_and_twice():
    positions, faces = sheet(4)
    positions.requires_grad_()

    def normals(p: torch.Tensor) -> torch.Tensor:
        return vertex_normals(p, faces)

    assert torch.autograd.gradcheck(normals, positions, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(normals, positions, check_fwd_over_rev=True)
    rows = positions.detach()
    hessian = torch.func.hessian(lambda p: normals(p)[:, 2].square().sum())(rows)
    expected = torch.func.hessian(lambda p: by_torch(p, faces)[:, 2].square().sum())(rows)
    torch.testing.assert_close(hessian, expected)


def test_a_batch_of_meshes():
    positions, faces = sheet(5)
    both = torch.stack([positions, positions * torch.tensor([1.0, 2.0, -1.0])])
    found = torch.vmap(lambda p: vertex_normals(p, faces))(both)
    for one, p in zip(found, both, strict=True):
        assert torch.equal(one, vertex_normals(p, faces))


def test_faces_without_an_area_and_vertices_without_a_face():
    positions = torch.tensor(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [5, 5, 5], [0, 0, 0]], dtype=torch.float64, requires_grad=True
    )
    whole = torch.tensor([[0, 1, 2]])
    degenerate = torch.tensor([[0, 1, 2], [0, 1, 3], [0, 5, 2], [1, 1, 2], [3, 3, 3]])
    normals = vertex_normals(positions, degenerate)
    up, fallback = torch.tensor([0.0, 0.0, 1.0]).double(), torch.tensor([1.0, 0.0, 0.0]).double()
    for vertex, expected in enumerate([up, up, up, fallback, fallback, fallback]):
        torch.testing.assert_close(normals[vertex], expected)
    weights = torch.arange(18.0, dtype=torch.float64).reshape(6, 3)
    (found,) = torch.autograd.grad(normals, positions, weights)
    (expected,) = torch.autograd.grad(vertex_normals(positions, whole), positions, weights)
    torch.testing.assert_close(found, expected)
    (expected,) = torch.autograd.grad(by_torch(positions, degenerate), positions, weights)
    torch.testing.assert_close(found, expected)


def test_the_same_bits_for_any_number_of_threads():
    positions, faces = sheet(150)  # two blocks of faces
    positions = positions.float().requires_grad_()
    weights = torch.rand(positions.shape, generator=torch.Generator().manual_seed(2))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            normals = vertex_normals(positions, faces)
            (gradient,) = torch.autograd.grad(normals, positions, weights)
            tangent = torch.func.jvp(lambda p: vertex_normals(p, faces), (positions.detach(),), (weights,))[1]
            found.append((normals.detach(), gradient, tangent))
    finally:
        torch.set_num_threads(before)
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            assert torch.equal(one, other)


def test_indices_that_are_out_of_range():
    positions, faces = sheet(3)
    faces[4, 1] = 9
    with pytest.raises(ValueError, match="faces: expected indices below 9, got 9"):
        vertex_normals(positions, faces)
