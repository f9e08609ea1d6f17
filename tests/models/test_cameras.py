"""Cameras from the matrices that people have, back to them, and rotations that an optimiser can move."""

from __future__ import annotations

import math

import pytest
import torch

import torchrender as tr

pytestmark = pytest.mark.once  # matrices in PyTorch

SO3, IDENTITY = tr.rotation.so3_exp, torch.eye(3, dtype=torch.float64)


def vectors(n: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def intrinsics(fx=50.0, fy=50.0, cx=14.0, cy=18.0) -> torch.Tensor:
    return torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)


def pose() -> tuple[torch.Tensor, torch.Tensor]:
    return SO3(torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)), torch.tensor([0.1, -0.2, 3], dtype=torch.float64)


# --------------------------------------------------------------------------------------------------------- rotations
def test_exponential_map_and_logarithm():
    v = vectors(50)
    angle = torch.linalg.vector_norm(v, dim=1, keepdim=True)
    v = v / angle * (angle % 3.1)
    R = SO3(v)
    torch.testing.assert_close(R @ R.mT, IDENTITY.expand(50, 3, 3), atol=1e-12, rtol=0)
    torch.testing.assert_close(tr.rotation.so3_log(R), v, atol=1e-10, rtol=0)
    quarter = SO3(torch.tensor([0.0, 0.0, math.pi / 2]))
    torch.testing.assert_close(quarter @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]))


def test_rotations_at_their_special_points():
    zero = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.equal(SO3(zero), IDENTITY)
    # At zero the derivative is the cross product, and the logarithm undoes it.
    jacobian = torch.autograd.functional.jacobian(lambda v: SO3(v) @ IDENTITY[0], zero)
    torch.testing.assert_close(jacobian, torch.tensor([[0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64))
    back = torch.autograd.functional.jacobian(lambda v: tr.rotation.so3_log(SO3(v)), zero)
    torch.testing.assert_close(back, IDENTITY)
    for axis in ([1.0, 0, 0], [0, 1.0, 0], [0.6, 0, 0.8]):  # half turns: the axis up to its sign
        v = math.pi * torch.tensor(axis, dtype=torch.float64)
        torch.testing.assert_close(SO3(tr.rotation.so3_log(SO3(v))), SO3(v), atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("dtype", "below", "tolerance"),
    [
        (torch.float64, 1e-9, 1e-9),
        (torch.float64, 1e-7, 1e-9),
        (torch.float32, 1e-4, 1e-3),
        (torch.float32, 1e-3, 1e-3),
    ],
)
def test_logarithm_just_below_half_turns(dtype, below, tolerance):
    axes = vectors(20, seed=2)
    axes = torch.cat([axes / torch.linalg.vector_norm(axes, dim=1, keepdim=True), IDENTITY, -IDENTITY]).to(dtype)
    for axis in axes:
        v = axis * (math.pi - below)
        back, jacobian = torch.func.vjp(lambda v: tr.rotation.so3_log(SO3(v)), v)
        torch.testing.assert_close(back, v, atol=50 * torch.finfo(dtype).eps, rtol=0)
        rows = torch.stack([jacobian(row)[0] for row in torch.eye(3, dtype=dtype)])
        torch.testing.assert_close(rows, torch.eye(3, dtype=dtype), atol=tolerance, rtol=0)


def test_six_numbers():
    columns = torch.randn(20, 6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    R = tr.rotation.from_6d(columns)
    torch.testing.assert_close(R.mT @ R, IDENTITY.expand(20, 3, 3), atol=1e-12, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(20, dtype=torch.float64))
    torch.testing.assert_close(tr.rotation.from_6d(tr.rotation.to_6d(R)), R)
    for function, wrong in (
        (SO3, torch.zeros(2)),
        (tr.rotation.from_6d, torch.zeros(3)),
        (tr.rotation.to_6d, torch.zeros(3)),
    ):
        with pytest.raises(ValueError, match=r"expected shape \(\.\.\., "):
            function(wrong)
    with pytest.raises(TypeError, match="floating-point tensor"):
        SO3([0.0, 0.0, 0.0])


@pytest.mark.parametrize("function", [SO3, lambda v: tr.rotation.so3_log(SO3(v))])
def test_derivatives_of_rotations(function):
    assert torch.autograd.gradcheck(function, (vectors(3, seed=4).requires_grad_(),))


# ------------------------------------------------------------------------------------------------ matrices and back
def test_opencv_and_back():
    R, t = pose()
    K = intrinsics()
    camera = tr.PerspectiveCamera.from_opencv(K, R, t, (40, 30))
    torch.testing.assert_close(camera.K, K)
    expected = torch.cat([R, t[:, None]], dim=1)
    torch.testing.assert_close(camera.world_to_camera[:3], expected)
    assert camera.world_to_camera[3].tolist() == [0, 0, 0, 1]
    again = tr.PerspectiveCamera.from_opencv(
        camera.K, camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3], (40, 30)
    )
    for name in ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y"):
        torch.testing.assert_close(getattr(again, name), getattr(camera, name))


def test_opengl_looks_the_other_way():
    R, t = pose()
    world_to_camera = torch.eye(4, dtype=torch.float64)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = R, t
    # OpenGL's camera is OpenCV's with y and z turned around.
    camera_to_world = torch.linalg.inv(world_to_camera) @ torch.diag(torch.tensor([1.0, -1, -1, 1]).double())
    camera = tr.PerspectiveCamera.from_opengl(camera_to_world, 40.0, (40, 30))
    torch.testing.assert_close(camera.world_to_camera.double(), world_to_camera, atol=1e-6, rtol=0)
    fx = 15 / math.tan(math.radians(20))
    torch.testing.assert_close(camera.K, intrinsics(fx, fx, 15, 20).to(camera.K), atol=1e-4, rtol=0)


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
def test_field_of_view_along_every_axis(axis):
    camera = tr.PerspectiveCamera.look_at([0, 0, 4], [0, 0, 0], fov=50, fov_axis=axis, size=(30, 40))
    pixels = {"x": 40, "y": 30, "diagonal": 50, "smaller": 30, "larger": 40}[axis]
    assert float(camera.K[0, 0]) == pytest.approx(pixels / 2 / math.tan(math.radians(25)), rel=1e-6)


def test_projections_land_on_their_pixels():
    """A small ball where K [R | t] says; pixel centres at +0.5."""
    R, t = pose()
    K = intrinsics()
    camera = tr.PerspectiveCamera.from_opencv(K, R, t, (40, 30), filter="box")
    for row, column in ((7, 22), (30, 4)):
        direction = torch.linalg.solve(K, torch.tensor([column + 0.5, row + 0.5, 1.0], dtype=torch.float64))
        centre = R.mT @ (3 * direction - t)
        scene = tr.load_dict(
            {
                "type": "scene",
                "sky": {"type": "constant"},
                "ball": {"type": "sphere", "center": centre, "radius": 0.02, "bsdf": {"type": "diffuse"}},
            }
        )
        alpha = tr.render(scene, sensor=camera, outputs=("alpha",), spp=64, seed=0).alpha
        assert int(alpha.argmax()) == row * 30 + column and float(alpha.max()) > 0.2


def test_gradients_reach_every_matrix():
    R, t = pose()
    given = [x.clone().requires_grad_() for x in (intrinsics(), R, t)]
    camera = tr.PerspectiveCamera.from_opencv(*given, (40, 30))
    names = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "pixel_aspect")
    fields = [getattr(camera, name) for name in names]
    loss = sum((f * torch.arange(1.0, f.numel() + 1).reshape(f.shape)).sum() for f in fields)
    gradients = torch.autograd.grad(loss, given, retain_graph=True)
    assert all(bool((g != 0).any()) for g in gradients)
    # And through the properties: what comes out is what went in.
    K, R2 = camera.K, camera.world_to_camera[:3, :3]
    (g,) = torch.autograd.grad(K[0, 2] + R2[1, 1], given[0])
    assert g[0, 2] == pytest.approx(1) and float(g.abs().sum()) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("K", "message"),
    [
        (intrinsics(fx=-1.0, fy=-1.0), "K: needs fx > 0"),
        (intrinsics() + torch.tensor([[0, 5.0, 0], [0, 0, 0], [0, 0, 0]]), "no skew"),
        (torch.eye(2), "3x3 matrix"),
    ],
)
def test_intrinsics_that_do_not_fit(K, message):
    with pytest.raises(ValueError, match=message):
        tr.PerspectiveCamera.from_opencv(K, torch.eye(3), torch.zeros(3), (4, 4))


def test_oblong_pixels():
    K = intrinsics(fy=25.0)
    camera = tr.PerspectiveCamera.from_opencv(K, torch.eye(3), torch.zeros(3), (40, 30), filter="box")
    torch.testing.assert_close(camera.K, K)
    direction = torch.linalg.solve(K, torch.tensor([22.5, 7.5, 1.0], dtype=torch.float64))
    ball = {"type": "sphere", "center": 3 * direction, "radius": 0.02, "bsdf": {"type": "diffuse"}}
    scene = tr.load_dict({"type": "scene", "sky": {"type": "constant"}, "ball": ball})
    alpha = tr.render(scene, sensor=camera, outputs=("alpha",), spp=64, seed=0).alpha
    assert int(alpha.argmax()) == 7 * 30 + 22


def test_precision_is_that_of_what_is_given():
    plain = tr.PerspectiveCamera.from_opencv([[50, 0, 16], [0, 50, 16], [0, 0, 1]], torch.eye(3), [0, 0, 4], (32, 32))
    looking = tr.PerspectiveCamera.look_at([0, 0, 4], torch.zeros(3), fov=torch.tensor(40.0))
    given = tr.PerspectiveCamera(fov=40)
    wide = tr.PerspectiveCamera.from_opencv(intrinsics(), torch.eye(3), torch.zeros(3), (32, 32))
    for camera, dtype in (
        (plain, torch.float32),
        (looking, torch.float32),
        (given, torch.float32),
        (wide, torch.double),
    ):
        assert {p.dtype for p in camera.parameters()} == {dtype}


def test_derivatives_of_an_image_in_pose_and_intrinsics():
    """An environment that fills the view has no edges: the derivative is complete, and the samples are the same."""
    texels = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    scene = tr.load_dict({"type": "scene", "sky": {"type": "envmap", "data": texels}}, dtype=torch.float64)
    R = pose()[0]

    def f(turn, focal, centre):
        K = torch.stack([focal[0], 0 * focal[0], centre[0], 0 * focal[0], focal[1], centre[1]]).reshape(2, 3)
        K = torch.cat([K, IDENTITY[2:]])
        camera = tr.PerspectiveCamera.from_opencv(K, SO3(turn) @ R, torch.zeros(3), (3, 4), filter="box")
        return tr.render(scene, sensor=camera, spp=1, seed=0, correlated=True)

    inputs = [torch.tensor(x, dtype=torch.float64) for x in ([0.1, -0.2, 0.05], [4.0, 3.0], [2.1, 1.4])]
    assert torch.autograd.gradcheck(f, [x.requires_grad_() for x in inputs], check_forward_ad=True)


def test_autocast_leaves_cameras_as_they_are():
    camera = tr.PerspectiveCamera.from_opencv(intrinsics().float(), *(x.float() for x in pose()), (36, 28))
    expected = [camera.world_to_camera, camera.K, *camera.rays()]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        inside = [camera.world_to_camera, camera.K, *camera.rays()]
    for a, b in zip(inside, expected, strict=True):
        assert a.dtype == torch.float32 and torch.equal(a, b)
