"""Pictures of many channels: against the native outputs of the same samples, and in their derivatives."""

from __future__ import annotations

import pytest
import torch
from motion_scenes import above, ball, bitmap, floor, lamp, mesh_ball, scene

import torchrender as tr
from torchrender.seeds import GRADIENT_STREAM, mix

SOFT = {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": "gaussian"}}


def view(**more) -> dict:
    return {**above(), "fov": 40, "film": SOFT, **more}


def made(camera: dict | None = None, **objects) -> tr.Scene:
    described = scene(2, camera or view(), floor=floor(), lamp=lamp("rectangle"), **objects)
    return tr.load_dict(described, dtype=torch.float64)


def show(loaded: tr.Scene, features: dict, **more) -> torch.Tensor:
    return tr.render(loaded, outputs=("features",), features=features, **{"seed": 0, **more}).features


@pytest.mark.parametrize("camera", ["pinhole", "thinlens"])
@pytest.mark.parametrize("sampler", ["independent", "sobol"])
def test_a_texture_of_colours_is_the_albedo(camera, sampler):
    lens = {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.0} if camera == "thinlens" else {}
    loaded = made(view(sampler={"type": sampler}, **lens))
    texels = loaded.get_parameter("floor.bsdf.reflectance.data").detach()
    expected = tr.render(loaded, spp=4, seed=3, outputs=("albedo", "alpha"))
    seen = tr.render(loaded, spp=4, seed=3, outputs=("albedo",), params={"floor.bsdf.reflectance.data": texels * 0})
    found = show(loaded, {"floor": texels}, spp=4, seed=3)
    torch.testing.assert_close(found, expected.albedo - seen.albedo, rtol=0, atol=1e-9)


def test_rows_of_vertices_are_an_attribute():
    colours = torch.rand(162, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    loaded = made(ball=mesh_ball({"type": "diffuse"}, {"vertex_mark": colours}))
    expected = tr.render(loaded, spp=4, seed=1, outputs=("vertex_mark",)).vertex_mark
    found = show(loaded, {"ball": torch.cat([colours, colours], dim=1)}, spp=4, seed=1)
    torch.testing.assert_close(found[..., :3], expected, rtol=0, atol=1e-9)
    assert torch.equal(found[..., :3], found[..., 3:])


def test_chunks_do_not_matter(monkeypatch):
    loaded = made()
    texels = torch.rand(4, 5, 7, dtype=torch.float64, requires_grad=True)
    whole = show(loaded, {"floor": texels}, spp=3)
    monkeypatch.setattr("torchrender.features.CHUNK", 11)
    parts = show(loaded, {"floor": texels}, spp=3)
    torch.testing.assert_close(parts, whole, rtol=0, atol=1e-12)
    weight = torch.rand_like(whole)
    a, b = (torch.autograd.grad((image * weight).sum(), texels)[0] for image in (whole, parts))
    torch.testing.assert_close(a, b, rtol=0, atol=1e-12)


def test_derivatives():
    """Linear in the features; by what moves, against finite differences of the same samples."""
    loaded = made()
    texels = bitmap(6, 6)["data"][..., :2]
    image = show(loaded, {"floor": texels}, spp=4, seed=mix(0, GRADIENT_STREAM))  # the samples of the derivative
    change = torch.rand(texels.shape, generator=torch.Generator().manual_seed(1), dtype=texels.dtype)
    _, tangent = torch.func.jvp(lambda x: show(loaded, {"floor": x}, spp=4), (texels,), (change,))
    torch.testing.assert_close(
        show(loaded, {"floor": texels + change}, spp=4, correlated=True, seed=mix(0, GRADIENT_STREAM)) - image, tangent
    )

    name = "floor.to_world"
    matrix = loaded.get_parameter(name).detach()
    shift = torch.zeros(4, 4, dtype=torch.float64)
    shift[:3, 3] = torch.tensor([0.3, 0.2, 0.1])
    weight = torch.rand(image.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)

    def f(m: torch.Tensor) -> torch.Tensor:
        return (show(loaded, {"floor": texels}, spp=64, correlated=True, params={name: m}) * weight).mean()

    moved = matrix.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(f(moved), moved)
    step = 1e-4
    difference = float(f(matrix + step * shift) - f(matrix - step * shift)) / (2 * step)
    assert float((gradient * shift).sum()) == pytest.approx(difference, rel=2e-2)


def test_misses_are_zero():
    loaded = tr.load_dict(scene(2, view(fov=80), ball=ball({"type": "diffuse"})))
    found = show(loaded, {"ball": torch.ones(2, 2, 5)}, spp=2, seed=4)
    hit = tr.render(loaded, spp=2, seed=4, outputs=("alpha",)).alpha > 0
    assert found.shape == (10, 12, 5) and bool(hit.any()) and not bool(hit.all())
    torch.testing.assert_close(found, hit[..., None].float().expand_as(found))


def test_parts_passes_and_several_cameras():
    """What `render` does with its own outputs: of colours in a texture those are the albedo."""
    loaded = made()
    texels = loaded.get_parameter("floor.bsdf.reflectance.data").detach()
    black = {"floor.bsdf.reflectance.data": texels * 0}
    for more in ({"passes": 3}, {"crop": (2, 1, 5, 6)}, {"pixels": torch.tensor([[3, 4], [9, 0], [3, 4]])}):
        settings = {"spp": 3, "seed": 3, "outputs": ("albedo",), **more}
        expected = tr.render(loaded, **settings).albedo - tr.render(loaded, params=black, **settings).albedo
        found = show(loaded, {"floor": texels}, spp=3, seed=3, **more)
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
    both = show(loaded, {"floor": texels}, spp=2, sensor=[0, loaded.sensors[0]], layout="bchw")
    assert both.shape == (2, 3, 10, 12) and torch.equal(both[0], both[1])


def test_image_and_derivative_have_samples_of_their_own():
    """The gradient of a square is unbiased: 2 (J' x of one picture) (x of another), and correlated, of the same."""
    loaded = made()
    texels = torch.rand(3, 3, 2, dtype=torch.float64, requires_grad=True)
    second = mix(5, GRADIENT_STREAM)
    for more, of in (({}, second), ({"correlated": True}, 5)):
        image = show(loaded, {"floor": texels}, spp=2, seed=5, **more)
        assert torch.equal(image.detach(), show(loaded, {"floor": texels.detach()}, spp=2, seed=5))
        (gradient,) = torch.autograd.grad(image.square().sum(), texels)
        other = show(loaded, {"floor": texels}, spp=2, seed=of, correlated=True)
        (expected,) = torch.autograd.grad((2 * image.detach() * other).sum(), texels)
        torch.testing.assert_close(gradient, expected)


def test_moved_cameras_and_hidden_lights():
    loaded = made()
    texels = torch.rand(3, 3, 2, dtype=torch.float64)
    matrix = loaded.sensors[0].to_world.detach() @ tr.Transform.translate([0.2, 0.1, 0]).matrix
    moved = show(loaded, {"floor": texels}, params={"camera.to_world": matrix})
    loaded.get_parameter("camera.to_world").data.copy_(matrix)
    assert torch.equal(moved, show(loaded, {"floor": texels}))
    lit = tr.load_dict(scene(2, view(), lamp={**lamp("rectangle"), "to_world": floor()["to_world"]}))
    seen = show(lit, {"lamp": torch.ones(1, 1, 4)})
    hidden = show(lit, {"lamp": torch.ones(1, 1, 4)}, integrator=tr.PathTracer(hide_emitters=True))
    assert bool(seen.any()) and not bool(hidden.any())


def test_gradients_of_what_is_not_seen_are_zero():
    """And of no pixels: every leaf that requires a gradient gets one, as from radiance."""
    loaded = made(ball=mesh_ball({"type": "diffuse"}))
    texels, rows = torch.ones(2, 2, 3, requires_grad=True), torch.ones(162, 3, requires_grad=True)
    matrix = loaded.get_parameter("floor.to_world").detach().clone().requires_grad_()
    none = torch.zeros(0, 2, dtype=torch.int64)
    beside = loaded.sensors[0].to_world.detach() @ tr.Transform.rotate([0, 1, 0], 180).matrix
    for more, params in (({"pixels": none}, {}), ({}, {"camera.to_world": beside})):
        found = show(loaded, {"floor": texels, "ball": rows}, params={"floor.to_world": matrix, **params}, **more)
        assert not bool(found.any())
        gradients = torch.autograd.grad(found.sum(), (texels, rows, matrix))
        assert [g.shape for g in gradients] == [(2, 2, 3), (162, 3), (4, 4)]
        assert not any(bool(g.any()) for g in gradients)


def test_batches_are_refused_in_words():
    loaded = made()
    x = torch.rand(2, 2, 2, 1, dtype=torch.float64)
    with pytest.raises(tr.NotDifferentiableError, match="loop over the inputs"):
        torch.func.vmap(lambda t: show(loaded, {"floor": t}))(x)


def test_forward_jacobian_without_a_seed():
    """`jacfwd` works by vmap, in which torch refuses to draw; other outputs raise a clear error."""
    loaded = made()
    texels = torch.rand(2, 2, 1, dtype=torch.float64)
    jacobian = torch.func.jacfwd(lambda t: show(loaded, {"floor": t}, seed=None))(texels)
    assert jacobian.shape == (10, 12, 1, 2, 2, 1) and bool(jacobian.any())
    name = "floor.bsdf.reflectance.data"
    with pytest.raises(tr.NotDifferentiableError, match="in place of jacfwd a loop over jvp"):
        torch.func.jacfwd(lambda t: tr.render(loaded, spp=1, params={name: t}))(loaded.get_parameter(name).detach())


def test_second_derivatives_by_features():
    """An image is linear in its features: the Hessian of a square is 2 J' J."""
    loaded = made()
    texels = torch.rand(2, 2, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def image(t: torch.Tensor) -> torch.Tensor:
        return show(loaded, {"floor": t}, spp=2, correlated=True).flatten()

    hessian = torch.func.jacfwd(torch.func.grad(lambda t: image(t).square().sum()))(texels).reshape(4, 4)
    rows = [torch.func.jvp(image, (texels,), (t.reshape(2, 2, 1),))[1] for t in torch.eye(4, dtype=torch.float64)]
    jacobian = torch.stack(rows)
    assert bool(jacobian.any())
    torch.testing.assert_close(hessian, 2 * jacobian @ jacobian.T, rtol=1e-10, atol=1e-10)


def test_the_default_device_does_not_matter():
    loaded = made()
    texels = torch.rand(2, 2, 3, dtype=torch.float64, requires_grad=True)
    matrix = loaded.get_parameter("floor.to_world").detach().clone().requires_grad_()
    settings = {"outputs": ("features", "duv_dx"), "features": {"floor": texels}, "params": {"floor.to_world": matrix}}
    found = []
    for device in ("cpu", "meta"):
        with torch.device(device):
            seen = tr.render(loaded, spp=2, seed=0, **settings)
            found.append(torch.autograd.grad(seen.features.sum() + seen.duv_dx.square().sum(), (texels, matrix)))
    assert bool(found[0][0].any()) and bool(found[0][1].any())
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


def test_edits_before_backward_are_refused():
    """What is looked up again in reverse mode has to be what was looked up."""
    for name in ("ball.vertex_positions", "floor.to_world", "features"):
        loaded = made(ball=mesh_ball({"type": "diffuse"}))
        texels = torch.rand(3, 3, 2, dtype=torch.float64, requires_grad=True)
        image = show(loaded, {"floor": texels}, spp=2)
        with torch.no_grad():
            (texels if name == "features" else loaded.get_parameter(name)).mul_(1.0)
        with pytest.raises(RuntimeError, match=f"{name}.* modified by an inplace operation"):
            image.sum().backward()
    show(loaded, {"floor": texels}, spp=2).sum().backward()
    assert bool(texels.grad.any())


def test_errors_name_the_shape():
    loaded = made(ball=mesh_ball({"type": "diffuse"}))
    for features, message in [
        ({}, "expected tensors by the names"),
        ({"flor": torch.ones(2, 2, 3)}, "no shape 'flor'; did you mean 'floor'"),
        ({"floor": torch.ones(4, 3)}, r"floor: expected a texture \(H, W, N\)"),
        ({"ball": torch.ones(5, 3)}, "ball: expected 162 rows"),
        ({"floor": torch.ones(3)}, "floor: expected a texture"),
        ({"floor": None}, "floor: expected numbers, got None"),
        ({"floor": {"type": "bitmap"}}, "floor: expected numbers"),
        ({"floor": [[1.0, 2.0], [3.0]]}, "floor: expected numbers"),
        ({"floor": torch.ones(2, 2, 3).to_sparse()}, "floor: expected a dense tensor"),
        ({"floor": torch.ones(2, 2, 3, device="meta")}, "floor: lies on meta"),
        ({3: torch.ones(2, 2, 3)}, r"no shape 3 \(int\)"),
        ({"floor": torch.ones(2, 2, 3), "lamp": torch.ones(2, 2, 4)}, "lamp: expected 3 channels"),
    ]:
        with pytest.raises((TypeError, ValueError), match=message):
            show(loaded, features)
    with pytest.raises(ValueError, match=r"features=\{...\} is missing"):
        tr.render(loaded, outputs=("features",))
    with pytest.raises(ValueError, match=r"outputs=\(..., 'features'\) is missing"):
        tr.render(loaded, features={"floor": torch.ones(2, 2, 3)})
