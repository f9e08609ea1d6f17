"""Ray queries: values, derivatives of every order and mode, and what they accept."""

from __future__ import annotations

import math

import pytest
import reference_scenes
import torch

import torchrender as tr
from torchrender.surface import curved_coordinates

translate, rotate, scale = reference_scenes.translate, reference_scenes.rotate, reference_scenes.scale
MIRROR = scale(-1, 1, 1)


def all_shapes() -> dict:
    """Every shape, turned, mirrored and flipped: meshes with and without normals and texture coordinates."""
    vertices, normals, _, faces, _ = reference_scenes.twisted_mesh(4, 6)
    texcoords = vertices[:, :2] * 0.3 + 0.4
    return {
        "type": "scene",
        "ball": {"type": "sphere", "center": [-2.0, 0.2, 0.3], "radius": 0.7, "to_world": rotate("y", 30)},
        "hollow": {"type": "sphere", "to_world": translate(-2, 2, 0) @ MIRROR @ scale(0.6), "flip_normals": True},
        "inside_out": {"type": "sphere", "to_world": translate(0, 2, 0) @ MIRROR @ scale(0.6)},
        "plate": {"type": "disk", "to_world": translate(2, 2, 0) @ rotate("x", 25) @ scale(0.8, 0.5, 1)},
        "turned": {"type": "disk", "to_world": translate(2, -2, 0) @ MIRROR @ scale(0.8), "flip_normals": True},
        "card": {"type": "rectangle", "to_world": translate(2, 0, 0) @ rotate("y", 20) @ scale(0.7, 0.9, 1)},
        "mirrored": {"type": "rectangle", "to_world": translate(-2, -2, 0) @ MIRROR @ rotate("y", 20) @ scale(0.7)},
        "tube": tr.Mesh(vertices, faces, vertex_normals=normals, vertex_texcoords=texcoords, to_world=rotate("x", 30)),
        "flat": tr.Mesh(vertices, faces, flip_normals=True, to_world=translate(0, -2, 0) @ scale(0.7)),
        "hills": {
            "type": "heightfield",
            "heights": torch.sin(torch.arange(20.0)).reshape(4, 5) * 0.3,
            "to_world": translate(1.2, 1.0, 0.8) @ MIRROR @ rotate("x", 25) @ scale(0.6),
        },
        "distances": {
            "type": "sdfgrid",
            "grid": torch.sin(torch.arange(60.0)).reshape(3, 4, 5) * 0.2 + torch.linspace(-0.5, 0.6, 4)[:, None],
            "to_world": translate(-0.4, 1.3, 1.0) @ MIRROR @ rotate("x", 60) @ scale(1.3, 0.9, 1.3),
        },
    }


def scene_of(dtype: torch.dtype = torch.float64, **objects: object) -> tr.Scene:
    return tr.load_dict({**all_shapes(), **objects}, dtype=dtype)


def grid(n: int = 23, dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays along -z, slightly fanned out, over all shapes and past them."""
    line = torch.linspace(-3.0, 3.0, n, dtype=dtype) + 0.013
    x, y = torch.meshgrid(line, line, indexing="ij")
    origins = torch.stack([x.flatten(), y.flatten(), torch.full((n * n,), 5.0, dtype=dtype)], 1)
    towards = origins.new_tensor([0.0, 0.0, -0.8]).expand_as(origins) + 0.003 * origins
    return origins, towards - origins.new_tensor([0.0, 0.0, 0.015])


def geometry(scene: tr.Scene) -> dict[str, torch.Tensor]:
    names = ("heights", "vertex_positions", "vertex_normals", "vertex_texcoords", "to_world", "center", "radius")
    return {n: p.detach() for n, p in scene.named_parameters() if n.endswith(names)}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_attached_geometry_equals_the_core(dtype):
    scene = scene_of(dtype)
    origins, directions = grid(dtype=dtype)
    hits = tr.ray_intersect(scene, origins, directions)
    assert sorted(set(hits.shape_id[hits.valid].tolist())) == list(range(11))
    assert 0.2 < hits.valid.double().mean() < 0.9
    surfaces = tr.surface.Surfaces.of(scene, scene.layout(), tr.scene.gather.gather(scene, scene.layout(), None))
    rows = hits.valid.nonzero()[:, 0]
    points = surfaces.meet(hits.shape_id[rows], hits.prim_id[rows], origins[rows], directions[rows], hits.t[rows])
    tolerance = 1e-12 if dtype == torch.float64 else 2e-4
    for name in tr.queries.CONTINUOUS:
        torch.testing.assert_close(
            getattr(points, name),
            getattr(hits, name)[rows],
            rtol=tolerance,
            atol=tolerance,
            msg=lambda m, n=name: n + m,
        )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_do_not_depend_on_gradients(dtype):
    scene = scene_of(dtype)
    origins, directions = grid(dtype=dtype)
    plain = tr.ray_intersect(scene, origins, directions)
    attached = tr.ray_intersect(scene, origins.requires_grad_(), directions)
    assert attached.t.requires_grad and not attached.valid.requires_grad and not attached.shape_id.requires_grad
    for name in tr.queries.Hits._fields:
        assert torch.equal(getattr(plain, name), getattr(attached, name)), name
    with torch.no_grad():
        assert not tr.ray_intersect(scene, origins, directions).t.requires_grad


def hit_rays(scene: tr.Scene, n: int = 23) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays that hit, and still hit the same when moved a little."""
    origins, directions = grid(n)
    hits = tr.ray_intersect(scene, origins, directions)
    stable = hits.valid
    for step in (1e-3, -1e-3):
        for k in range(3):
            shift = torch.zeros(3, dtype=torch.float64)
            shift[k] = step
            moved = tr.ray_intersect(scene, origins + shift, directions)
            stable = stable & (moved.shape_id == hits.shape_id) & (moved.prim_id == hits.prim_id)
            moved = tr.ray_intersect(scene, origins, directions + shift)
            stable = stable & (moved.shape_id == hits.shape_id) & (moved.prim_id == hits.prim_id)
            stable = stable & ((moved.uv - hits.uv).abs().amax(1) < 0.3)  # no seam in between
    assert sorted(set(hits.shape_id[stable].tolist())) == list(range(11))
    return origins[stable], directions[stable]


def outputs(scene: tr.Scene, origins: torch.Tensor, directions: torch.Tensor, params=None) -> torch.Tensor:
    """All continuous outputs in one vector."""
    return torch.cat([x.flatten() for x in tr.ray_intersect(scene, origins, directions, params=params)[:6]])


def test_gradients_in_rays():
    scene = scene_of()
    origins, directions = hit_rays(scene, 11)
    origins.requires_grad_(), directions.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda o, d: outputs(scene, o, d), (origins, directions), fast_mode=True, check_forward_ad=True
    )


@pytest.mark.parametrize("name", list(geometry(scene_of())))
def test_gradients_in_geometry(name):
    scene = scene_of()
    origins, directions = hit_rays(scene, 17)
    value = geometry(scene)[name].requires_grad_()
    if name.endswith("to_world"):
        # the last row of an affine matrix stays as it is
        value = value.detach()[:3].requires_grad_()
        last = value.new_tensor([[0.0, 0.0, 0.0, 1.0]])

        def f(x):
            return outputs(scene, origins, directions, {name: torch.cat([x, last])})
    else:

        def f(x):  # gradcheck edits x behind the version counter's back: a new tensor is seen as one
            return outputs(scene, origins, directions, {name: x.clone()})

    assert torch.autograd.gradcheck(f, (value,), fast_mode=True, check_forward_ad=True)
    (grad,) = torch.autograd.grad(f(value).sum(), value)
    assert grad.abs().max() > 1e-3


def test_second_derivatives():
    scene = scene_of()
    origins, directions = hit_rays(scene, 9)
    origins.requires_grad_(), directions.requires_grad_()
    center = scene.get_parameter("ball.center").detach().requires_grad_()
    assert torch.autograd.gradgradcheck(
        lambda o, d, c: outputs(scene, o, d, {"ball.center": c}), (origins, directions, center), fast_mode=True
    )


def test_torch_func():
    scene = scene_of()
    origins, directions = hit_rays(scene, 9)
    tangent = torch.randn(origins.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    _, forward = torch.func.jvp(lambda d: tr.ray_intersect(scene, origins, d).t, (directions,), (tangent,))
    gradient = torch.func.grad(lambda d: tr.ray_intersect(scene, origins, d).t.sum())(directions)
    torch.testing.assert_close(forward.sum(), (gradient * tangent).sum())
    assert forward.abs().max() > 0.01


def test_closed_form():
    """A plane seen along z: dt = dz of the plane, and rays that miss have no derivative."""
    scene = tr.load_dict({"type": "scene", "wall": {"type": "rectangle", "to_world": translate(0, 0, -2)}})
    origins = torch.tensor([[0.2, 0.1, 1.0], [5.0, 0.0, 1.0]], requires_grad=True)
    directions = torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, -1.0]])
    matrix = scene.get_parameter("wall.to_world").requires_grad_()
    hits = tr.ray_intersect(scene, origins, directions)
    assert hits.valid.tolist() == [True, False]
    assert hits.t.tolist() == [pytest.approx(3.0), math.inf]
    hits.t[hits.valid].sum().backward()
    assert origins.grad.tolist() == [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    assert matrix.grad[2, 3].item() == pytest.approx(-1.0)
    assert matrix.grad[:2].abs().max() == 0
    # Even where the infinite distance itself is used, nothing becomes NaN.
    again = tr.ray_intersect(scene, origins, directions)
    grads = torch.autograd.grad(again.t.sum() + again.position.sum() + again.uv.sum(), [origins, matrix])
    assert all(torch.isfinite(g).all() for g in grads) and grads[0][1].abs().max() == 0


def test_normals_follow_positions():
    """The normals of a mesh that came without any are functions of its positions, by name and as a leaf alike."""
    vertices, _, _, faces, _ = reference_scenes.twisted_mesh(4, 6)
    mesh = tr.Mesh(vertices, faces)
    mesh.compute_normals()
    scene = tr.load_dict({"type": "scene", "tube": mesh}, dtype=torch.float64)
    origins, directions = grid(9)
    name = "tube.vertex_positions"
    rows = tr.ray_intersect(scene, origins, directions).valid
    assert rows.sum() > 3
    origins, directions = origins[rows], directions[rows]

    def f(x):
        return tr.ray_intersect(scene, origins, directions, params={name: x.clone()}).shading_normal

    value = scene.get_parameter(name).detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(f, (value,), fast_mode=True)
    (by_name,) = torch.autograd.grad(f(value)[:, 0].sum(), value)
    leaf = scene.get_parameter(name).requires_grad_()
    (by_leaf,) = torch.autograd.grad(tr.ray_intersect(scene, origins, directions).shading_normal[:, 0].sum(), leaf)
    torch.testing.assert_close(by_leaf, by_name)


def test_poles_and_centres_have_finite_gradients():
    scene = tr.load_dict(
        {"type": "scene", "ball": {"type": "sphere"}, "plate": {"type": "disk", "to_world": translate(3, 0, 0)}},
        dtype=torch.float64,
    )
    origins = torch.tensor([[0.0, 0, 5], [0, 0, -5], [3, 0, 5]], dtype=torch.float64, requires_grad=True)
    hits = tr.ray_intersect(scene, origins, torch.tensor([[0.0, 0, -1], [0, 0, 1], [0, 0, -1]]))
    assert hits.valid.all() and hits.uv.tolist() == [[0, 0], [0, 1], [0, 0]]
    (grad,) = torch.autograd.grad(hits.uv.sum() + hits.position.sum(), origins)
    assert torch.isfinite(grad).all()
    local = torch.tensor([[0.6, 0.0, 0.8], [0.0, -0.5, 0.0]], dtype=torch.float64)
    uv = curved_coordinates(local, torch.tensor([True, False]))
    assert uv[0].tolist() == pytest.approx([0.0, math.acos(0.8) / math.pi])
    assert uv[1].tolist() == pytest.approx([0.5, 0.75])


def test_what_is_accepted():
    scene = scene_of(torch.float32)
    origins, directions = grid(7)
    expected = tr.ray_intersect(scene, origins.float(), directions.float())
    # other dtypes: converted, and the gradient comes back in its own
    given = origins.clone().requires_grad_()
    hits = tr.ray_intersect(scene, given, directions)
    assert hits.t.dtype == torch.float32 and torch.equal(hits.t, expected.t)
    (grad,) = torch.autograd.grad(hits.t[hits.valid].sum(), given)
    assert grad.dtype == torch.float64 and grad.abs().max() > 0
    # lists, transposed and expanded tensors
    assert torch.equal(tr.ray_intersect(scene, origins.tolist(), directions.tolist()).t, expected.t)
    assert torch.equal(tr.ray_intersect(scene, origins.T.contiguous().T, directions).t, expected.t)
    one = directions.mean(0).requires_grad_()
    hits = tr.ray_intersect(scene, origins, one.expand_as(origins))
    (grad,) = torch.autograd.grad(hits.t[hits.valid].sum(), one)
    assert grad.shape == (3,) and grad.abs().max() > 0


def test_autocast_changes_nothing():
    scene = scene_of(torch.float32)
    origins, directions = grid(7, torch.float32)
    camera = tr.PerspectiveCamera.look_at((0.5, 1.0, 6.0), (0.0, 0.0, 0.0), size=(4, 4))
    parameters = [scene.get_parameter(n).requires_grad_() for n in ("ball.center", "card.to_world")]

    def results():
        hits = tr.ray_intersect(scene, origins, directions)
        return [hits.t, *torch.autograd.grad(hits.position[hits.valid].sum(), parameters), camera.rays().directions]

    expected = results()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = results()
    for a, b in zip(found, expected, strict=True):
        assert torch.equal(a, b)


def test_empty_batches():
    scene = scene_of()
    origins = torch.zeros(0, 3, requires_grad=True)
    hits = tr.ray_intersect(scene, origins, torch.zeros(0, 3))
    assert hits.position.shape == (0, 3) and hits.uv.shape == (0, 2) and hits.valid.shape == (0,)
    (grad,) = torch.autograd.grad(hits.t.sum(), origins)
    assert grad.shape == (0, 3)
    assert tr.ray_occluded(scene, origins, torch.zeros(0, 3)).shape == (0,)


def test_longest_distances():
    scene = scene_of()
    origins, directions = grid(15)
    free = tr.ray_intersect(scene, origins, directions)
    limit = torch.where(torch.arange(len(origins)) % 2 == 0, free.t * 0.99, free.t * 1.01)
    limit = torch.where(free.valid, limit, 100.0)
    near = tr.ray_intersect(scene, origins, directions, limit)
    expected = free.valid & (torch.arange(len(origins)) % 2 == 1)
    assert torch.equal(near.valid, expected)
    assert torch.equal(tr.ray_occluded(scene, origins, directions, limit), expected)
    assert torch.equal(tr.ray_occluded(scene, origins, directions), free.valid)


def test_occlusion_has_no_derivative():
    scene = scene_of()
    origins, directions = grid(5)
    hidden = tr.ray_occluded(scene, origins.requires_grad_(), directions)
    assert hidden.dtype == torch.bool and not hidden.requires_grad
    moved = geometry(scene)["ball.center"] + 100.0
    found = tr.ray_occluded(scene, [[-2.0, 0.2, 5.0]], [[0.0, 0.0, -1.0]], params={"ball.center": moved})
    assert found.tolist() == [False]
    with pytest.raises(ValueError, match=r"ray_occluded: params: .*'ball.centre'.*ball.center"):
        tr.ray_occluded(scene, origins, directions, params={"ball.centre": moved})


def test_camera_rays():
    """The rays of a camera hit what the camera sees, and carry the gradient of its pose."""
    camera = tr.PerspectiveCamera.look_at((0.5, 1.0, 6.0), (0.0, 0.0, 0.0), fov=50.0, size=(6, 8), filter="box")
    scene = scene_of(camera=camera, light={"type": "constant"})
    camera = scene.sensors[0]
    rays = camera.rays()
    assert rays.origins.shape == rays.directions.shape == (48, 3) and rays.tmax.shape == (48,)
    torch.testing.assert_close(rays.directions.norm(dim=1), torch.ones(48, dtype=torch.float64))
    middle = camera.rays([[4.0, 3.0]])
    torch.testing.assert_close(middle.directions[0], camera.to_world.detach()[:3, 2])
    right = camera.rays([[5.0, 3.0]]).directions[0] - middle.directions[0]
    assert float(right @ camera.to_world.detach()[:3, 0]) < 0  # the camera's +x is to the left
    down = camera.rays([[4.0, 4.0]]).directions[0] - middle.directions[0]
    assert float(down @ camera.to_world.detach()[:3, 1]) < 0
    alpha = tr.render(scene, spp=64, seed=1, outputs=("alpha",)).alpha
    seen = tr.ray_intersect(scene, *rays).valid.reshape(6, 8)
    assert torch.equal(seen[alpha == 1], torch.ones_like(seen[alpha == 1]))
    assert not seen[alpha == 0].any() and 0 < int(seen.sum()) < 48
    with pytest.raises(ValueError, match=r"rays: positions: expected shape \(N, 2\)"):
        camera.rays(torch.zeros(3))


def test_a_head_light():
    """An integrator in three lines: the light at the camera, whose gradient in the radius is known in the middle."""
    camera = tr.PerspectiveCamera.look_at((0, 0, 4), (0, 0, 0), fov=20.0, size=(3, 3))
    scene = tr.load_dict({"type": "scene", "camera": camera, "ball": {"type": "sphere"}}, dtype=torch.float64)
    (radius,) = scene.train_only("ball.radius")
    rays = scene.sensors[0].rays()
    hits = tr.ray_intersect(scene, *rays)
    image = -(hits.shading_normal * rays.directions).sum(1)
    # sin(angle of incidence) = distance of the ray from the centre over the radius
    axis = rays.directions @ rays.directions.new_tensor([0.0, 0.0, -1.0])
    sine = 4 * torch.sqrt(1 - axis**2)
    torch.testing.assert_close(image, torch.sqrt(1 - (sine / radius) ** 2))
    (grad,) = torch.autograd.grad(image.sum(), radius)
    torch.testing.assert_close(grad, (sine**2 / torch.sqrt(1 - sine**2)).sum().detach())


def test_compiled_equals_eager():
    scene = scene_of(torch.float32)
    origins, directions = grid(7, torch.float32)

    def f(origins):
        hits = tr.ray_intersect(scene, origins * 1.0, directions)
        return torch.where(hits.valid, hits.t * 2, 0.0).sum()

    expected = torch.autograd.grad(f(origins.requires_grad_()), origins)[0]
    compiled = torch.compile(f, backend="eager")
    assert torch.equal(torch.autograd.grad(compiled(origins), origins)[0], expected)


def test_camera_rays_are_differentiable():
    camera = tr.PerspectiveCamera.look_at((0.5, 1.0, 6.0), (0.0, 0.0, 0.0), fov=50.0, size=(6, 8)).double()
    positions = torch.rand(5, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64) * 6
    names = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y", "pixel_aspect")
    values = [getattr(camera, n).detach().clone().requires_grad_() for n in names]

    def f(positions, *values):
        for name, value in zip(names, values, strict=True):
            camera._parameters[name] = value
        return camera.rays(positions)[:2]

    assert torch.autograd.gradcheck(f, (positions.requires_grad_(), *values), check_forward_ad=True)
