"""The path tracer in PyTorch: films, samplers, chunks and what it refuses. Its images and derivatives of all models are
held against the native ones in test_oracle.py, with BSDFs in plain PyTorch; here with native ones, too."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
import torch
from in_torch import SPP as ORACLE_SPP
from in_torch import InTorch, assert_equal, differentiable, render
from oracle.bsdf import in_pytorch
from oracle.scenes import SCENES
from small_scene import COLOUR, TEXELS, ball_and_wall
from torch.autograd import forward_ad

import torchrender as tr

pytestmark = pytest.mark.once  # an integrator in PyTorch

SPP = 4


MODELS = {
    "ggx": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "material": "Cu"},
    "beckmann": {"type": "roughconductor", "alpha": 0.2, "eta": 0.3, "k": 3.0},
    "coat": {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": 0.7, "specular_reflectance": 0.8},
    "narrow": {"type": "roughconductor", "alpha": 1e-5, "eta": 0.3, "k": 3.0},
    "matched": {"type": "roughdielectric", "eta": 1.0, "alpha": 0.3},
}


@pytest.fixture(params=["native", "plain"])
def bsdfs(request):
    """By which BSDFs the path tracer is evaluated: as it is, and by those of oracle/bsdf."""
    with in_pytorch() if request.param == "plain" else nullcontext():
        yield


@pytest.mark.usefixtures("bsdfs")
@pytest.mark.parametrize("name", MODELS)
def test_native_bsdf(name):
    """Facets of all kinds on a ball, and what counts as something else."""
    ball = {"type": "sphere", "radius": 0.8, "bsdf": MODELS[name]}
    objects = ball_and_wall(spp=SPP, ball=ball, integrator={"type": "path", "max_depth": 5})
    scene = tr.load_dict(objects, dtype=torch.float64)
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items() if "ball.bsdf" in n or n == COLOUR}
    images = [render(scene, values, integrator=i) for i in (tr.WavefrontPathTracer(5), scene.integrator)]
    assert_equal(*images, "image")
    weight = torch.linspace(-1, 1, images[0].numel(), dtype=torch.float64).reshape(images[0].shape)
    found, expected = (torch.autograd.grad((i * weight).sum(), list(values.values())) for i in images)
    for parameter, a, b in zip(values, found, expected, strict=True):
        assert_equal(a, b, parameter)
        assert bool(b.any()), parameter


@pytest.mark.parametrize("variant", ["rgb", "mono"])
@pytest.mark.parametrize("name", ["glass", "glossy", "layers", "brushed"])
def test_native_bsdfs_in_scenes(name, variant):
    """Image and both modes of the derivative are those of the native path tracer; everything may move."""
    scene = tr.load_dict(SCENES[name](), dtype=torch.float64, variant=variant)
    integrators = (InTorch(scene.integrator), scene.integrator)
    images = [tr.render(scene, integrator=i, spp=ORACLE_SPP, seed=5) for i in integrators]
    assert_equal(*images, "image")
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    weight = torch.linspace(-1, 1, images[0].numel(), dtype=torch.float64).reshape(images[0].shape)
    found, expected = (
        torch.autograd.grad((render(scene, values, integrator=i) * weight).mean(), list(values.values()))
        for i in integrators
    )
    for parameter, a, b in zip(values, found, expected, strict=True):
        assert_equal(a, b, parameter)
    generator = torch.Generator().manual_seed(9)
    with forward_ad.dual_level():
        duals = {}
        for parameter, v in values.items():
            tangent = torch.randn(v.shape, generator=generator, dtype=v.dtype)
            duals[parameter] = forward_ad.make_dual(v.detach(), tangent)
        pushed = [forward_ad.unpack_dual(render(scene, duals, integrator=i)).tangent for i in integrators]
    assert_equal(*pushed, "tangent of the image")


# ------------------------------------------------------------------------------------------- films, samplers, chunks
def small(**more) -> tr.Scene:
    return tr.load_dict(ball_and_wall(**more), dtype=torch.float64)


WAVEFRONT = tr.WavefrontPathTracer(max_depth=3, chunk=50)


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian"])
@pytest.mark.parametrize("part", [{}, {"crop": (1, 2, 3, 4)}, {"pixels": torch.tensor([[5, 7], [0, 3], [5, 7]])}])
def test_parts_of_the_film(rfilter, part):
    objects = ball_and_wall()
    objects["sensor"]["film"]["rfilter"] = {"type": rfilter}
    objects["sensor"]["film"]["sample_border"] = rfilter == "tent"
    scene = tr.load_dict(objects, dtype=torch.float64)
    scene.train_only(COLOUR)
    native, found = (tr.render(scene, integrator=i, seed=3, **part) for i in (scene.integrator, WAVEFRONT))
    assert_equal(found, native, "image")
    weight = torch.linspace(-1, 2, native.numel(), dtype=torch.float64).reshape(native.shape)
    gradients = [torch.autograd.grad((i * weight).sum(), scene.get_parameter(COLOUR))[0] for i in (native, found)]
    assert_equal(gradients[1], gradients[0], "gradient")


@pytest.mark.parametrize("sampler", tr.SAMPLERS)
def test_samplers_passes_and_views(sampler):
    scene = small()
    scene["second"] = tr.PerspectiveCamera.look_at([1, 1, 3], [0, 0, 0], fov=40, size=(6, 8))
    settings = {"sampler": sampler, "passes": 2, "spp": 5, "spp_grad": 3, "seed": 8, "seed_grad": 9, "sensor": [1, 0]}
    scene.train_only(TEXELS)
    images = [tr.render(scene, integrator=i, layout="bchw", **settings) for i in (scene.integrator, WAVEFRONT)]
    assert images[1].shape == (2, 3, 6, 8)
    assert_equal(images[1], images[0], "images")
    gradients = [torch.autograd.grad(i.square().sum(), scene.get_parameter(TEXELS))[0] for i in images]
    assert_equal(gradients[1], gradients[0], "gradient")


def test_a_camera_outside_of_the_scene_and_first_hits():
    scene = small()
    camera = tr.PerspectiveCamera.look_at([1, 1, 3], [0, 0, 0], fov=40, size=(6, 8)).double()
    names = ("depth", "rgb", "albedo", "shape_id")
    native, found = (
        tr.render(scene, sensor=camera, outputs=names, integrator=i, seed=1) for i in (scene.integrator, WAVEFRONT)
    )
    for name in names:
        a, b = getattr(found, name), getattr(native, name)
        assert torch.equal(a, b) or name == "rgb"
    assert_equal(found.rgb, native.rgb, "image")
    stacked = tr.render(scene, integrator=tr.AOV("dd:depth", WAVEFRONT), seed=1)
    assert_equal(stacked[..., :3], tr.render(scene, integrator=WAVEFRONT, seed=1), "image")
    assert stacked.shape == (6, 8, 4)


@pytest.mark.parametrize("chunk", [5, 24, 1 << 16])
def test_chunks_are_not_seen(chunk):
    """6 x 8 pixels of 2 samples: chunks that divide pixels, parts of rows, everything at once."""
    scene = small()
    scene.train_only(COLOUR, TEXELS)
    expected = tr.render(scene, integrator=tr.WavefrontPathTracer(3), seed=2)
    expected.square().sum().backward()
    gradients = [scene.get_parameter(n).grad.clone() for n in (COLOUR, TEXELS)]
    scene.zero_grad()
    found = tr.render(scene, integrator=tr.WavefrontPathTracer(3, chunk=chunk), seed=2)
    found.square().sum().backward()
    assert_equal(found, expected, "image")
    for name, gradient in zip((COLOUR, TEXELS), gradients, strict=True):
        assert_equal(scene.get_parameter(name).grad, gradient, name)


def test_single_precision_is_that_of_the_core():
    scene = tr.load_dict(ball_and_wall(height=12, width=16, spp=16))
    native, found = (tr.render(scene, integrator=i, seed=2) for i in (scene.integrator, WAVEFRONT))
    assert found.dtype == torch.float32
    # A path whose ray just passes an edge may go elsewhere for a rounding error.
    assert float(((found - native).abs() > 1e-4).double().mean()) < 0.01
    torch.testing.assert_close(found.mean(), native.mean(), rtol=1e-3, atol=0)


def test_the_default_device_does_not_matter():
    scene = small()
    scene.train_only(COLOUR)

    def gradient() -> torch.Tensor:
        image = tr.render(scene, integrator=WAVEFRONT, seed=2)
        return torch.autograd.grad(image, scene.get_parameter(COLOUR), torch.ones_like(image, device="cpu"))[0]

    expected = gradient()
    with torch.device("meta"):
        found = gradient()
    assert torch.equal(found, expected)


@pytest.mark.filterwarnings("ignore:the scene has a directionalarea")
def test_what_only_light_tracing_finds():
    """Beams take their share of the samples and are black; an irradiance meter beside the camera is a surface."""
    beam = {"type": "rectangle", "to_world": tr.Transform.translate([0.0, 0.0, 3.0]), "flip_normals": True}
    meter = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 4, "height": 4}}
    scene = small(
        lamp={**beam, "emitter": {"type": "directionalarea", "radiance": 5.0}},
        bulb={"type": "point", "position": [1.0, 2.0, 2.0], "intensity": 3.0},
        screen={"type": "rectangle", "to_world": tr.Transform.translate([0.0, 0.0, -1.0]), "sensor": meter},
    )
    native, found = (tr.render(scene, integrator=i, seed=3) for i in (scene.integrator, WAVEFRONT))
    assert_equal(found, native, "image")


@pytest.mark.usefixtures("bsdfs")
@pytest.mark.parametrize("name", ["glossy", "layers", "normals", "brushed", "rough"])
def test_single_precision_of_all_models(name):
    """Nothing is lost or not a number in single precision, and derivatives neither."""
    scene = tr.load_dict(SCENES[name]())
    integrators = (scene.integrator, InTorch(scene.integrator))
    native, found = (tr.render(scene, integrator=i, seed=2, spp=16, nan="raise") for i in integrators)
    assert float(((found - native).abs() > 1e-3).double().mean()) < 0.02
    values = {n: v.requires_grad_() for n, v in differentiable(scene).items()}
    image = render(scene, values, integrator=integrators[1], nan="raise")
    assert all(bool(torch.isfinite(g).all()) for g in torch.autograd.grad(image.mean(), list(values.values())))


# ---------------------------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ({"ball": {"type": "sphere", "interior": {"type": "homogeneous"}}}, "does not trace through media"),
    ],
)
def test_what_is_not_supported_is_named(objects, message):
    scene = tr.load_dict(ball_and_wall(**objects))
    with pytest.raises(ValueError, match=message):
        tr.render(scene, integrator=WAVEFRONT)


def test_arguments_that_it_does_not_take():
    scene = small()
    with pytest.raises(ValueError, match="no 'variance'; PathTracer has it"):
        tr.render(scene, integrator=WAVEFRONT, outputs=("rgb", "variance"))
    with pytest.raises(ValueError, match="adaptive_grad: WavefrontPathTracer has no such choice"):
        tr.render(scene, integrator=WAVEFRONT, adaptive_grad=True)
    powers = tr.WavefrontPathTracer()
    powers.emitter_sampling = "power"
    with pytest.raises(ValueError, match="emitter_sampling: expected 'weight', got 'power'; PathTracer has 'power'"):
        tr.render(scene, integrator=powers)
    with pytest.raises(ValueError, match="WavefrontPathTracer: chunk: expected at least 1, got 0"):
        tr.WavefrontPathTracer(chunk=0)
    with pytest.raises(TypeError, match="chunk: expected an integer, got 'many'"):
        tr.WavefrontPathTracer(chunk="many")
    scene["integrator"] = tr.WavefrontPathTracer(max_depth=2, chunk=9)
    assert "WavefrontPathTracer(max_depth=2, rr_depth=5, hide_emitters=False, chunk=9)" in repr(scene)
    with pytest.raises(ValueError, match="save: integrator: a WavefrontPathTracer has no form in a scene file"):
        scene.save("never.xml")


def test_second_derivatives_are_refused():
    scene = small()
    (parameter,) = scene.train_only(COLOUR)
    image = tr.render(scene, integrator=WAVEFRONT, seed=0)
    (gradient,) = torch.autograd.grad(image.square().sum(), parameter, create_graph=True)
    with pytest.raises(tr.NotDifferentiableError, match="first derivatives only"):
        gradient.sum().backward()


def test_an_edit_between_image_and_derivative_is_an_error():
    scene = small()
    (parameter,) = scene.train_only(COLOUR)
    image = tr.render(scene, integrator=WAVEFRONT, seed=0)
    with torch.no_grad():
        parameter.mul_(0.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_torch_func():
    """`torch.func` sees a function of tensors: its derivatives are those of autograd."""
    scene = small()
    texels = scene.get_parameter(TEXELS).detach()

    def loss(texels: torch.Tensor) -> torch.Tensor:
        return tr.render(scene, integrator=WAVEFRONT, seed=0, params={TEXELS: texels}).square().sum()

    leaf = texels.clone().requires_grad_()
    (expected,) = torch.autograd.grad(loss(leaf), leaf)
    assert_equal(torch.func.grad(loss)(texels), expected, "gradient")
    tangent = torch.ones_like(texels)
    _, along = torch.func.jvp(loss, (texels,), (tangent,))
    assert_equal(along, expected.sum(), "derivative along a direction")
