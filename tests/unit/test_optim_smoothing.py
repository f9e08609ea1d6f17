"""Large steps on grids and meshes: against dense matrices, adjoints, both modes of differentiation, and refusals."""

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info

import torchrender as tr
from torchrender.optim import GridSmoothing, MeshSmoothing, UniformAdam


def path(n):
    """The Laplacian of n points in a row."""
    difference = torch.eye(n, dtype=torch.float64).diff(dim=0)
    return difference.T @ difference


def grid_matrix(size, lambda_):
    """I + lambda L of a grid, densely: a sum of Kronecker products."""
    total = torch.zeros(1, 1, dtype=torch.float64)
    for n in size:
        eye = torch.eye(n, dtype=torch.float64)
        total = torch.kron(total, eye) + torch.kron(torch.eye(len(total), dtype=torch.float64), path(n))
    return torch.eye(len(total), dtype=torch.float64) + lambda_ * total


@pytest.mark.parametrize("size", [(1,), (7,), (1, 1), (1, 5), (6, 1), (4, 6), (5, 8), (7, 5), (3, 4, 5)])
@pytest.mark.parametrize("channels", [(), (2,)])
def test_grid_against_a_dense_solve(size, channels):
    x = torch.rand(*size, *channels, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    smoothing = GridSmoothing(3.7, dims=len(size))
    matrix = grid_matrix(size, 3.7)
    flat = x.reshape(len(matrix), -1)
    torch.testing.assert_close(smoothing.to_differential(x), (matrix @ flat).reshape(x.shape), rtol=0, atol=1e-12)
    solved = torch.linalg.solve(matrix, flat).reshape(x.shape)
    torch.testing.assert_close(smoothing.from_differential(x), solved, rtol=0, atol=1e-13)
    single = smoothing.from_differential(x.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single, solved.float(), rtol=0, atol=3e-7)


def test_grid_of_full_size_and_back():
    """In single precision the way there and back loses what the condition, 1 + 8 lambda, allows."""
    x = torch.rand(512, 384, generator=torch.Generator().manual_seed(0))
    for lambda_, error in [(0.0, 1e-6), (10.0, 3e-6), (1000.0, 3e-5)]:
        smoothing = GridSmoothing(lambda_)
        torch.testing.assert_close(
            smoothing.from_differential(smoothing.to_differential(x)), x, rtol=0, atol=error, msg=str(lambda_)
        )
    # what is smoothed keeps its mean, a constant stays
    smooth = GridSmoothing(50.0).from_differential(x)
    assert smooth.mean().item() == pytest.approx(x.mean().item(), rel=1e-5) and smooth.std() < 0.05
    flat = torch.full((64, 48), 0.25)
    torch.testing.assert_close(GridSmoothing(50.0).from_differential(flat), flat, rtol=0, atol=1e-6)


def test_grid_does_not_depend_on_strides():
    x = torch.rand(6, 9, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    smoothing = GridSmoothing(2.0)
    turned = x.permute(2, 0, 1).contiguous().permute(1, 2, 0)
    assert torch.equal(smoothing.from_differential(turned), smoothing.from_differential(x))
    assert torch.equal(smoothing.from_differential(x)[..., 1], smoothing.from_differential(x[..., 1]))


def ball():
    """An icosahedron's sphere with a seam: two of its vertices are there twice."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=1)
    vertices = torch.from_numpy(mesh.vertices.copy())
    faces = torch.from_numpy(mesh.faces.copy())
    vertices = torch.cat([vertices, vertices[[3, 17]]])
    for old, new in [(3, len(vertices) - 2), (17, len(vertices) - 1)]:
        row, corner = torch.nonzero(faces == old)[0]
        faces[row, corner] = new
    return vertices, faces


def mesh_matrix(count, faces, lambda_):
    matrix = torch.eye(count, dtype=torch.float64)
    edges = {tuple(sorted((int(f[i]), int(f[i - 1])))) for f in faces for i in range(3)}
    for i, j in edges:
        matrix[i, i] += lambda_
        matrix[j, j] += lambda_
        matrix[i, j] -= lambda_
        matrix[j, i] -= lambda_
    return matrix


def test_mesh_against_a_dense_solve():
    vertices, faces = ball()
    apart = MeshSmoothing(len(vertices), faces, 4.0)
    matrix = mesh_matrix(len(vertices), faces, 4.0)
    assert apart.count == len(vertices)
    torch.testing.assert_close(apart.to_differential(vertices), matrix @ vertices, rtol=0, atol=1e-12)
    torch.testing.assert_close(apart.from_differential(vertices), torch.linalg.solve(matrix, vertices))
    flat = apart.from_differential(vertices[:, 0].float())
    torch.testing.assert_close(flat, torch.linalg.solve(matrix, vertices[:, 0]).float())

    # Vertices at one place are one: the same as the mesh without a seam, whose matrix is smaller.
    joined = MeshSmoothing(vertices, faces, 4.0)
    assert joined.count == len(vertices) - 2
    u = joined.to_differential(vertices)
    assert u.shape == (joined.count, 3)
    torch.testing.assert_close(joined.from_differential(u), vertices, rtol=0, atol=1e-12)
    of_arrays = MeshSmoothing(vertices.numpy(), faces.numpy().astype(np.uint32), 4.0)
    assert torch.equal(of_arrays.to_differential(vertices), u)
    moved = joined.from_differential(u + torch.rand(u.shape, dtype=torch.float64))
    assert torch.equal(moved[[-2, -1]], moved[[3, 17]]) and not torch.equal(moved, vertices)


def test_adjoints_and_both_modes():
    vertices, faces = ball()
    generator = torch.Generator().manual_seed(3)
    mesh = MeshSmoothing(vertices, faces, 2.0)
    grid = GridSmoothing(2.0)
    cases = [(grid, (3, 4)), (grid, (4, 3, 2)), (mesh, (mesh.count, 2))]
    for smoothing, shape in cases:
        u = torch.rand(shape, dtype=torch.float64, generator=generator, requires_grad=True)
        options = {"check_forward_ad": True, "check_batched_grad": False}
        assert torch.autograd.gradcheck(smoothing.from_differential, u, **options)
        assert torch.autograd.gradgradcheck(smoothing.from_differential, u)
        x = smoothing.from_differential(u).detach().requires_grad_()
        assert torch.autograd.gradcheck(smoothing.to_differential, x, **options)
    # self-adjoint: <a, S b> = <S a, b>, and what backward gives is S
    a, b = torch.rand(2, 33, 20, dtype=torch.float64, generator=generator)
    solve = grid.from_differential
    torch.testing.assert_close((a * solve(b)).sum(), (solve(a) * b).sum(), rtol=1e-12, atol=0)
    b.requires_grad_()
    (gradient,) = torch.autograd.grad((a * solve(b)).sum(), b)
    assert torch.equal(gradient, solve(a))


def test_large_steps_keep_a_surface_smooth():
    """One step along a gradient at a single entry moves what is around it, too."""
    heights = torch.zeros(32, 32)
    rough = {}
    for lambda_ in (0.0, 16.0):
        smoothing = GridSmoothing(lambda_)
        u = smoothing.to_differential(heights).requires_grad_()
        optimizer = UniformAdam([u], lr=1.0)
        (-smoothing.from_differential(u)[16, 16]).backward()
        optimizer.step()
        x = smoothing.from_differential(u).detach()
        assert x[16, 16] == x.max() > 0
        rough[lambda_] = (x[16, 17] / x[16, 16]).item()
    assert abs(rough[0.0]) < 1e-6 and 0.8 < rough[16.0] < 1


def test_threads_of_the_solver_are_not_in_the_way_of_others(monkeypatch):
    vertices, faces = torch.rand(4, 3), torch.tensor([[0, 1, 2], [1, 2, 3]])
    smoothing = MeshSmoothing(vertices, faces, lambda_=2.0)
    threads: list[int] = []

    class Watched:
        def solve(self, x: np.ndarray) -> np.ndarray:
            threads.extend(of["num_threads"] for of in threadpool_info() if of["user_api"] == "blas")
            return x

    monkeypatch.setattr(smoothing, "_factors", Watched())
    before = threadpool_info()
    smoothing.from_differential(vertices)
    assert threads and set(threads) == {1}
    assert threadpool_info() == before


def test_refusals():
    faces = torch.tensor([[0, 1, 2]])
    for bad in (-1.0, float("nan"), float("inf")):
        for make in (lambda v: GridSmoothing(v), lambda v: MeshSmoothing(3, faces, v)):
            with pytest.raises(ValueError, match=r"lambda_: expected a number >= 0"):
                make(bad)
    with pytest.raises(TypeError, match=r"lambda_: expected a number >= 0, got 'x' \(str\)"):
        GridSmoothing("x")
    with pytest.raises(ValueError, match="dims: expected an integer of at least 1, got 0"):
        GridSmoothing(1.0, dims=0)
    grid = tr.optim.GridSmoothing(1.0)
    for call in (grid.to_differential, grid.from_differential):
        with pytest.raises(TypeError, match=r"expected a tensor of float32 or float64, got a Tensor of .*int64"):
            call(torch.ones(3, 3, dtype=torch.long))
        with pytest.raises(ValueError, match=r"at least 2 axes, none empty, got shape \(3,\)"):
            call(torch.ones(3))
        with pytest.raises(ValueError, match=r"none empty, got shape \(0, 3\)"):
            call(torch.ones(0, 3))
    with pytest.raises(ValueError, match="faces: expected vertices from 0 to 1, got 0 to 2"):
        MeshSmoothing(2, faces)
    with pytest.raises(TypeError, match=r"faces: expected integers, got torch\.float32"):
        MeshSmoothing(3, faces.float())
    with pytest.raises(TypeError, match=r"faces: expected a tensor \(F, 3\)"):
        MeshSmoothing(3, faces[0])
    with pytest.raises(TypeError, match=r"vertices: expected a tensor \(V, 3\) or the number"):
        MeshSmoothing(torch.ones(3), faces)
    with pytest.raises(ValueError, match="vertices: expected at least 1, got 0"):
        MeshSmoothing(0, faces)
    mesh = MeshSmoothing(3, faces)
    with pytest.raises(ValueError, match=r"u: expected 3 rows, got shape \(4, 3\)"):
        mesh.from_differential(torch.ones(4, 3))
    with pytest.raises(TypeError, match="x: expected a floating-point tensor"):
        mesh.to_differential(faces)
    assert repr(grid) == "GridSmoothing(lambda_=1, dims=2)" and "3 vertices at 3 places" in repr(mesh)
